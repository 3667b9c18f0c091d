"""Executors with positions: positioner, homing, modes.

Here a motion starts: CW.4 rises once for each edge of the PLC, and an answer of the drive counts only for the command that it
belongs to (``handshake``). "Reached" needs SW.10, the window and standstill. Every wait has a limit and a
reason. Motion without an order of the PLC gets Halt and warning 130.

Tests that find a mistake: ``tests/gateway/axis/test_tasks.py``, ``test_positioner_handshake.py``,
``test_positioning_handshake.py``, ``test_positions_end.py``, ``tests/long/test_walk_handshakes.py`` (late, stuck and early
answers), ``python -m tests.long.soak --calm`` (a healthy machine has no fault).
"""
