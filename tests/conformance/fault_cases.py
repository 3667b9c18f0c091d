"""Each fault of a simulated device in one situation, and the required reaction of the gateway.

Source: docs/translation.md "Losses", docs/devices.md. docs/simulation.md is generated from these cases.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

from pdgw.dsp406.objects import RESOLUTION
from pdgw.gateway.reasons import FaultNumber

LOSSES = frozenset({FaultNumber.NODE_LOST, FaultNumber.NODE_RESTARTED, FaultNumber.STOP_IGNORED})
"""Fault numbers after which the device is lost. A drive that does not stop gets NMT Stop and is silent then."""
CONFIGURES = "NMT enter pre operational"
"""The gateway's first command of a configuration."""


class Device(enum.Enum):
    """The device with the fault; the value is the text of an id."""

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
    """Activity of the device when the fault starts."""

    START = "from power-on"
    SPEED = "turning"
    HOMING = "homing"
    STOPPING = "turning, then OFF3"
    COMMISSIONING = "commissioning diagnostics"


@dataclass(frozen=True)
class Case:
    """One fault in one situation, and the required reaction."""

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
    """Further faults of the device from power-on, with their parameters."""
    sent: tuple[str, ...] = ()
    """Commands that the gateway must send since the fault, in this order."""
    stopped: str = ""
    """How the drive must stop."""

    def __str__(self) -> str:
        """The id of its test, for example ``lost-pdos every=1, telegram 1, turning``."""
        chosen = "".join(f" {key}={value}" for key, value in self.values.items())
        beside = "".join(f" beside {name}" for name in self.beside)
        return f"{self.fault}{chosen}{beside}, telegram {self.telegram}, {self.activity.value}"


_QUICK_STOP = "CW 0002h"
_SILENT = (_QUICK_STOP, "NMT stop", CONFIGURES)
"""The commands to a drive that does not answer."""
DRIVE_CASES: tuple[Case, ...] = (
    Case("slow-sdo", Reaction.CONTINUES, activity=Activity.START, values={"delay_ms": 10}),
    Case("sdo-timeout", Reaction.REFUSES, (121,), Activity.START, sdo_timeout_ms=100),
    Case("sdo-timeout", Reaction.CONTINUES),
    Case("sdo-toggle-error", Reaction.REFUSES, (121,), Activity.START),
    Case("wrong-identity", Reaction.REFUSES, (106,), Activity.START, sent=(CONFIGURES,)),
    Case("object-missing", Reaction.REFUSES, (106,), Activity.START),
    # The drive is built for telegram 1, so its mapping need not be written.
    Case("fixed-pdo-mapping", Reaction.CONTINUES, activity=Activity.START),
    Case("fixed-pdo-mapping", Reaction.REFUSES, (106,), Activity.START, telegram=9),
    Case("mapping-abort", Reaction.REFUSES, (106,), Activity.START, telegram=9),
    Case("two-pdos", Reaction.CONTINUES, activity=Activity.START, telegram=100),
    Case("polled-tpdo", Reaction.CONTINUES, activity=Activity.START),
    Case("sync-counter", Reaction.CONTINUES, activity=Activity.START),
    Case("lost-pdos", Reaction.CONTINUES),
    Case(
        "lost-pdos",
        Reaction.STOPS,
        (101,),
        values={"every": 1},
        sent=(_QUICK_STOP, CONFIGURES),
        stopped="quick stop",
    ),
    Case("lost-pdos", Reaction.STOPS, (101,), values={"every": 1}, beside={"turns-in-pre-operational": {}}),
    Case("duplicated-pdos", Reaction.CONTINUES),
    Case("late-pdos", Reaction.CONTINUES),
    Case("heartbeat-stops", Reaction.REFUSES, (106,), Activity.START),
    Case("heartbeat-stops", Reaction.STOPS, (101,), sent=_SILENT, stopped="quick stop"),
    Case("emcy-burst", Reaction.CONTINUES, (10,)),
    Case("bus-off", Reaction.STOPS, (101,), sent=_SILENT),
    Case("error-passive", Reaction.CONTINUES, (12,)),
    Case("reboot", Reaction.STOPS, (105,), sent=(CONFIGURES,)),
    Case("reboot", Reaction.STOPS, (105,), telegram=100),
    Case("no-homing-attained", Reaction.STANDSTILL, (109,), Activity.HOMING, telegram=9),
    Case("late-status", Reaction.CONTINUES),
    Case("bouncing-status", Reaction.STOPS, (122,), sent=(_QUICK_STOP,)),
    Case("bouncing-status", Reaction.STOPS, (122,), telegram=100),
    Case("unknown-state", Reaction.STOPS, (107,), sent=(_QUICK_STOP,), stopped="quick stop"),
    Case("unknown-state", Reaction.STOPS, (107,), telegram=100, sent=(_QUICK_STOP,)),
    Case("mode-display-stuck", Reaction.REFUSES, (106,), Activity.START),
    Case("mode-display-stuck", Reaction.STANDSTILL, (110,), Activity.HOMING, telegram=9),
    Case("limit-switch", Reaction.STANDSTILL, (112,)),
    Case("enable-input-dropped", Reaction.STOPS, (122,)),
    Case("enable-input-dropped", Reaction.STOPS, (122,), telegram=100),
    Case("drive-fault", Reaction.STOPS, (10,)),
    Case("under-voltage", Reaction.STOPS, (6,), sent=("CW 0000h",)),
    Case("reboot-in-motion", Reaction.STOPS, (105,)),
    Case("deaf", Reaction.STOPS, (125,), Activity.STOPPING),
    Case("stop-ramp-missing", Reaction.STOPS, (125,), Activity.STOPPING),
    Case("turns-in-pre-operational", Reaction.CONTINUES),
)
"""At least one case for each fault of a drive (checked by a test)."""


def _encoder_cases(
    reaction: Reaction, numbers: tuple[int, ...], *faults: str, activity: Activity = Activity.SPEED
) -> tuple[Case, ...]:
    """The same case for several faults, with the encoder telegrams in turn."""
    return tuple(
        Case(fault, reaction, numbers, activity, telegram=81 + number % 4, device=Device.ENCODER)
        for number, fault in enumerate(faults)
    )


ENCODER_CASES: tuple[Case, ...] = (
    Case(
        "slow-sdo",
        Reaction.MEASURES,
        activity=Activity.START,
        values={"delay_ms": 10},
        telegram=81,
        device=Device.ENCODER,
    ),
    *_encoder_cases(Reaction.NEVER_GOOD, (121,), "sdo-timeout", "sdo-toggle-error", activity=Activity.START),
    *_encoder_cases(
        Reaction.NEVER_GOOD,
        (106,),
        "wrong-identity",
        "heartbeat-stops",
        activity=Activity.START,
    ),
    Case(
        "object-missing",
        Reaction.NEVER_GOOD,
        (106,),
        Activity.START,
        {"index": RESOLUTION},
        telegram=83,
        device=Device.ENCODER,
    ),
    # 1016h: an encoder moves nothing that it could stop by monitoring the gateway.
    *_encoder_cases(Reaction.MEASURES, (), "object-missing", activity=Activity.START),
    # The position is mapped already, or read by SDO.
    *_encoder_cases(
        Reaction.MEASURES,
        (),
        "fixed-pdo-mapping",
        "mapping-abort",
        "polled-tpdo",
        "sync-counter",
        activity=Activity.START,
    ),
    Case("two-pdos", Reaction.MEASURES, (), Activity.START, {"pdos": 0}, telegram=81, device=Device.ENCODER),
    Case(
        "sdo-timeout",
        Reaction.LOSES,
        (101,),
        telegram=82,
        sdo_timeout_ms=100,
        device=Device.ENCODER,
        beside={"two-pdos": {"pdos": 0}},
    ),
    *_encoder_cases(Reaction.MEASURES, (), "sdo-timeout", "lost-pdos", "duplicated-pdos", "late-pdos"),
    Case("lost-pdos", Reaction.LOSES, (101,), values={"every": 1}, telegram=83, device=Device.ENCODER),
    Case("heartbeat-stops", Reaction.LOSES, (101,), telegram=81, device=Device.ENCODER),
    Case("bus-off", Reaction.LOSES, (101,), telegram=82, device=Device.ENCODER, sent=("NMT stop", CONFIGURES)),
    Case("reboot", Reaction.LOSES, (105,), telegram=84, device=Device.ENCODER, sent=(CONFIGURES, "NMT start")),
    *_encoder_cases(Reaction.FAULT, (10,), "emcy-burst"),
    Case("emcy-burst", Reaction.MEASURES, (10,), values={"register": 0}, telegram=84, device=Device.ENCODER),
    *_encoder_cases(Reaction.FAULT, (12,), "error-passive"),
    *_encoder_cases(Reaction.SENSOR_ERROR, (10,), "position-error", "memory"),
    *_encoder_cases(
        Reaction.FAULT,
        (10,),
        "input-current",
        "input-voltage",
        "temperature",
        "software",
        "monitoring",
        "external",
        "device-specific",
    ),
    *_encoder_cases(Reaction.MEASURES, (), "sensor-defect"),
    *_encoder_cases(Reaction.SENSOR_ERROR, (10,), "sensor-defect", activity=Activity.COMMISSIONING),
    *_encoder_cases(
        Reaction.WARNS, (), "frequency", "light", "watchdog", "operating-time", "battery", "reference-point"
    ),
    *(
        Case(fault, Reaction.G1_ERROR, numbers, values=values, telegram=3, device=Device.SENSOR)
        for fault, numbers, values in (
            ("lost-pdos", (101,), {"every": 1}),
            ("heartbeat-stops", (101,), {}),
            ("reboot", (105,), {}),
            ("position-error", (10,), {}),
        )
    ),
    Case("wrong-identity", Reaction.G1_MISSING, (106,), Activity.START, telegram=3, device=Device.SENSOR),
)
"""At least one case for each fault of an encoder (checked by a test)."""
