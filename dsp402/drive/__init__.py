"""The client of a CiA 402 drive: start-up, guarding, process images and touch probe.

``guarding`` makes the drive stop by itself when the gateway is lost; without its confirmation the drive is refused. ``rpdos``
sends the data before the Controlword, and a stop before all others. Checks compare units, mode and PDOs with the drive while
it runs.

Tests that find a mistake: ``tests/dsp402/test_guarding.py``, ``test_drive*.py``, ``test_*_check.py``,
``tests/gateway/test_wrong_units.py``, ``tests/gateway/test_bring_up.py``.
"""
