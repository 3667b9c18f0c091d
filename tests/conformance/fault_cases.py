"""What a gateway must do with each habit of a device in one situation: the cases of ``peers/habits.toml``.

Source: docs/translation.md "Losses", docs/devices.md. docs/tables.md is generated from these cases.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any

from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.peers.habits import HABITS, Habit

LOSSES = frozenset({FaultNumber.NODE_LOST, FaultNumber.NODE_RESTARTED, FaultNumber.STOP_IGNORED})
"""Fault numbers after which the device is lost. A drive that does not stop gets NMT Stop and is silent then."""
CONFIGURES = "NMT enter pre operational"
"""The gateway's first command of a configuration."""


class Device(enum.Enum):
    """The device with the habit; the value is the text of an id."""

    DRIVE = "drive"
    ENCODER = "encoder"
    SENSOR = "encoder as G1 of a drive"


class Reaction(enum.Enum):
    """The required reaction; the value is the text of the document. The first four are of drives, the others of encoders."""

    STOPS = "power off at standstill, no restart"
    STANDSTILL = "standstill, reason reported"
    CONTINUES = "stays in operation, OFF works"
    REFUSES = "never enabled"

    MEASURES = "position stays good"
    WARNS = "position stays good, warning while the cause is present"
    FAULT = "position stays good, fault until acknowledged"
    SENSOR_ERROR = "position invalid (G1_ZSW.15), fault until acknowledged"
    LOSES = "IOPS BAD, returns by itself, fault until acknowledged"
    NEVER_GOOD = "IOPS BAD until the fault is removed, then online by itself, fault until acknowledged"
    G1_ERROR = "the drive stays in operation, G1 shows the error until acknowledged"
    G1_MISSING = "the drive stays in operation, G1 shows the error until the encoder is online"


class Activity(enum.Enum):
    """Activity of the device when the habit starts."""

    START = "power-on"
    OFF = "off"
    SPEED = "turning"
    HOMING = "homing"
    OFF1 = "turning, then OFF1"
    STOPPING = "turning, then OFF3"
    COMMISSIONING = "commissioning diagnostics"


@dataclass(frozen=True)
class Case:
    """One habit in one situation, and the required reaction."""

    fault: str
    reaction: Reaction
    numbers: tuple[int, ...] = ()
    """One of these fault numbers must be reported (P947, warnings P953). If empty, none may be reported."""
    activity: Activity = Activity.SPEED
    values: dict[str, int] = field(default_factory=dict)
    telegram: int = 1
    sdo_timeout_ms: int = 500
    device: Device = Device.DRIVE
    beside: dict[str, dict[str, int]] = field(default_factory=dict)
    """Further habits of the device from power-on, with their parameters."""
    sent: tuple[str, ...] = ()
    """Commands that the gateway must send since the fault, in this order."""
    stopped: str = ""
    """How the drive must stop."""
    within_ms: int = 20_000
    """Longest time from the start of the habit until the fault is reported."""
    says: str = ""
    """Part of the text of the fault."""

    def __str__(self) -> str:
        """The id of its test, for example ``lost-pdos every=1, telegram 1, turning``."""
        chosen = "".join(f" {key}={value}" for key, value in self.values.items())
        beside = "".join(f" beside {name}" for name in self.beside)
        return f"{self.fault}{chosen}{beside}, telegram {self.telegram}, {self.activity.value}"


_DEVICES = {"drive": Device.DRIVE, "encoder": Device.ENCODER, "sensor": Device.SENSOR}


def _case(habit: Habit, keys: dict[str, Any]) -> Case:
    """The table has the reaction under the name of the device."""
    device = next(iter(keys.keys() & _DEVICES))
    return Case(
        habit.name,
        Reaction[keys.pop(device).upper()],
        tuple(keys.pop("faults", ())),
        Activity(keys.pop("when", Activity.SPEED)),
        device=_DEVICES[device],
        sent=tuple(keys.pop("sent", ())),
        **keys,
    )


CASES = tuple(_case(habit, dict(row)) for habit in HABITS.values() for row in habit.cases)
DRIVE_CASES = tuple(case for case in CASES if case.device is Device.DRIVE)
ENCODER_CASES = tuple(case for case in CASES if case.device is not Device.DRIVE)
