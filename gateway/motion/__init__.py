"""Positioner (states as data, traversing blocks, length units), DSC and message words; pure.

Values and monotonic nanoseconds in, values out; nothing here knows a telegram's word or a drive's Controlword. The tables in
``states`` decide what an edge of the PLC starts, ends or loses; ``positioner`` applies them. Change a row first.

Tests that find a mistake: ``tests/gateway/motion``, ``tests/gateway/axis/test_positioner*.py``, the walk with telegrams 7,
110 and 111.
"""
