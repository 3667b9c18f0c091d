"""The axis machine: setpoints to commands of the drive, feedback to actual values; pure.

    PLC words --adapter--> Demand --AxisMachine--> DriveCommand
    PLC words <--adapter-- Report <--AxisMachine-- DriveFeedback

No sockets, buses, clocks, threads or logging (a test imports it without them): values and a time in, values out. Adapters
know the words of a telegram by their names and no drive, executors a drive and no telegram; the interlock is between both.

Here is the one safety rule: the rows of ``power_table`` decide whether a drive may have power, ``interlock`` applies them.
Change a row, not a caller. A new state variable makes the walk longer, and a new condition needs a test that fails without
it.

Tests that find a mistake: ``tests/gateway/axis/test_power_table.py`` (each row), ``test_interlock.py``, ``python -m
tests.long.walk --short`` (every state), ``tests/long/rules.py`` (the same rules without the table), ``tests/decoder/replay``
(the decisions of kept recordings).
"""
