"""The client of one CANopen node: start-up, configuration, PDO plan, SDO access and supervision.

A node is used only when identity, PDOs and heartbeat are as configured. Otherwise it is refused with the reason. After each
boot-up it is configured again. Nothing here knows a drive. A wait has a limit, and what may be repeated is sent again.

Tests that find a mistake: ``tests/ds301``, ``tests/dsp402/test_drive_start.py``, ``tests/gateway/test_bring_up.py``.
"""
