"""The axis machine: what a PLC asks of a drive or encoder, what that one is told, and what the PLC is shown. Pure.

    PLC words --adapter--> Demand --AxisMachine--> DriveCommand
    PLC words <--adapter-- Report <--AxisMachine-- DriveFeedback

No sockets, buses, clocks, threads or logging (a test imports it without them): values and a time in, values out. Adapters know
the words of a telegram by their names and no drive, executors a drive and no telegram; the interlock stands between both.
"""
