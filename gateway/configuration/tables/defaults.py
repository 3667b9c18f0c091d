"""Default values of the configuration that others use without loading it."""

from typing import Final

STATUS_PORT: Final = 34965
"""TCP on loopback: the answer to `pdgw status`."""
USUAL_CYCLE_MS: Final = 4
"""The PLC's cycle where nothing tells another one."""
WATCHDOG_FACTOR: Final = 3
"""Cycles without a frame until the PLC is lost, unless the user chooses otherwise."""
WATCHDOG_FACTOR_MAX: Final = 255
