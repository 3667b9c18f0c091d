"""Values and example of the configuration that others use without loading it."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Final

STATUS_PORT: Final = 34965
"""TCP on loopback: the answer to `pdgw status`."""
USUAL_CYCLE_MS: Final = 4
"""Default of the PLC's cycle."""
WATCHDOG_FACTOR: Final = 3
"""Cycles without a frame until the PLC is lost, unless the user chooses otherwise."""
WATCHDOG_FACTOR_MAX: Final = 255
LONGEST_AGE_MS: Final = 1900
"""Greatest age limit of a frame of the PLC: within this time its cycle counter cannot wrap, also if its clock is 1 % too fast."""
SIMULATED_ENCODER_TELEGRAM: Final = 83
SIMULATED_KEYS: Final = {
    "lu_per_revolution": 10_000,
    "max_velocity": 30_000,
    "max_acceleration": 1000,
    "max_deceleration": 1000,
    "position_window": 20,
    "jog_velocities": (-3000, 3000),
    "lu_per_unit": 1000,
    "velocity_per": "minute",
    "jog_distances": (2500, 5000),
    "software_limits": (-1_000_000, 1_000_000),
    "homing_method": 35,
}
"""[axis.positioner] of the simulated drives of ``pdgw run --simulate``."""
SIMULATED_BLOCKS: Final[tuple[dict[str, int | str], ...]] = (
    {"number": 1, "position": 20_000, "velocity": 6000, "next": "flying"},
    {"number": 2, "position": 50_000, "velocity": 12_000, "next": "external"},
    {"number": 3, "task": "wait", "value": 300, "next": "continue-with-stop"},
    {"number": 4, "position": 60_000, "velocity": 3000, "next": "external"},
    {"number": 5, "position": 0, "velocity": 15_000},
)
"""A chain: one setpoint on the fly, a pause when the PLC says so, a slow way, and back when the PLC says so again."""


class Trigger(StrEnum):
    """Events after which a part of the flight recorder is kept."""

    FAULT = "fault"
    """A new fault of a drive object."""
    STOP = "stop"
    """An axis leaves operation without an OFF of the PLC, or the gateway ends without its stop sequence."""


def example() -> str:
    """A commented configuration that is itself valid: ``example.toml`` beside this module."""
    return Path(__file__).with_name("example.toml").read_text(encoding="utf-8")
