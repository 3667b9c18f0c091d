"""The axis machine: setpoints to commands of the drive, feedback to actual values; pure.

    PLC words --adapter--> Demand --AxisMachine--> DriveCommand
    PLC words <--adapter-- Report <--AxisMachine-- DriveFeedback

No sockets, buses, clocks, threads or logging (a test imports it without them): values and a time in, values out. Adapters know
the words of a telegram by their names and no drive, executors a drive and no telegram; the interlock is between both.
"""
