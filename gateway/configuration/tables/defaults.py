"""Values of the configuration that others use without loading it."""

from enum import StrEnum
from typing import Final

STATUS_PORT: Final = 34965
"""TCP on loopback: the answer to `pdgw status`."""
USUAL_CYCLE_MS: Final = 4
"""Default of the PLC's cycle."""
WATCHDOG_FACTOR: Final = 3
"""Cycles without a frame until the PLC is lost, unless the user chooses otherwise."""
WATCHDOG_FACTOR_MAX: Final = 255
SIMULATED_ENCODER_TELEGRAM: Final = 83


class Trigger(StrEnum):
    """Events after which a part of the flight recorder is kept."""

    FAULT = "fault"
    """A new fault of a drive object."""
    STOP = "stop"
    """An axis leaves operation without an OFF of the PLC, or the gateway ends without its stop sequence."""
