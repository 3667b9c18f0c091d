"""Supervision of an axis: sign of life, stops, enables, velocity and events of the drive.

Each module watches one thing and can only stop the axis: Quick Stop, then NMT stop, then the heartbeat ends. A check looks at
all that it needs in every pass, counts only values that are newer than its evidence, and must not stop a healthy machine.

Tests that find a mistake: ``tests/gateway/axis/supervision``, ``tests/gateway/test_velocity_lock.py``,
``tests/conformance/test_drive_faults.py``, the calm soak (false stops) and the disturbed soak (missed stops).
"""
