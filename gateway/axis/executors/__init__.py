"""Executors: a ``Demand`` to objects of a drive, its feedback to a ``Report``; no telegram.

An executor sets modes and setpoints of its own function. It never switches power: it reads the result of the interlock, and
gives setpoint 0 or the actual position until the drive shows operation.

Tests that find a mistake: the test of each function in ``tests/gateway/axis`` (``test_velocity.py``, ``test_torque.py``,
``test_dsc.py``), ``test_stateful.py`` (random commands), the walk, and the drives of ``tests/conformance``.
"""
