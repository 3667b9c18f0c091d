"""The user's choices for an axis, and the scaling that its telegram requires.

Scaling of a drive that a telegram requires: the quantities whose fractions its signals are. Source: docs/devices.md "What each
signal needs". A signal in the drive's own units needs no 100 %. The user's choices for an axis or an encoder. Source:
docs/translation.md.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, NamedTuple

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.drive_type import Quantity, Scaling
from pdgw.dsp402.units.mechanics import KEY_LINES
from pdgw.gateway.motion.dsc_setpoint import DscChoices
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.sign_of_life import MONITORING_OFF
from pdgw.profidrive.signals import Signal, SignalQuantity
from pdgw.profidrive.telegrams import Telegram

_REFERENCES = {
    SignalQuantity.SPEED: Quantity.SPEED,
    SignalQuantity.MOTION_VELOCITY: Quantity.PROFILE_VELOCITY,
    SignalQuantity.ACCELERATION: Quantity.ACCELERATION,
    SignalQuantity.DECELERATION: Quantity.DECELERATION,
    SignalQuantity.POSITION: Quantity.POSITION,
}
"""The reference of the drive that is 100 % of a signal."""


def quantity_of(signal: Signal) -> Quantity | None:
    """The quantity that a signal is a fraction of; None for a signal in other units."""
    if signal.quantity is None or signal.type not in {DataType.N2, DataType.N4}:
        return None
    return _REFERENCES.get(signal.quantity)


def needed_quantities(telegram: Telegram) -> tuple[Quantity, ...]:
    """In the order of ``Quantity``; the speed always: without it no standstill is known."""
    signals = (*telegram.setpoints.signals, *telegram.actuals.signals)
    needed = {Quantity.SPEED} | {quantity for signal in signals if (quantity := quantity_of(signal)) is not None}
    return tuple(quantity for quantity in Quantity if quantity in needed)


_UNITS = (
    ("counts_per_revolution", "position units per revolution", "counts_per_revolution"),
    ("velocity_per_rpm", "velocity units per rpm", "velocity_unit"),
    ("acceleration_per_rpm_s", "acceleration units per rpm/s", "acceleration_unit"),
)
"""Parts of a scaling besides its 100 % values: attribute, name in messages, and configuration key."""


class Missing(NamedTuple):
    """All parts of a scaling that a telegram lacks."""

    why: str
    keys: tuple[str, ...]

    @property
    def lines(self) -> tuple[str, ...]:
        """Lines to paste into the [[axis]]; each is rejected until its value is filled in."""
        return tuple(KEY_LINES[key].text for key in self.keys)

    @property
    def remedy(self) -> str:
        """What to paste; empty if no key helps."""
        short = ", ".join(KEY_LINES[key].setting for key in self.keys)
        return f"paste into its [[axis]] and fill in: {short}" if short else ""

    @property
    def text(self) -> str:
        """For one line: the reasons, then what to paste."""
        return "; ".join(filter(None, (self.why, self.remedy)))


def missing(scaling: Scaling, needed: tuple[Quantity, ...], *, converts: bool) -> Missing:
    """``converts``: positions, velocities and accelerations are made of each other (positioner, DSC)."""
    parts = [text for text in (scaling.refusal(*needed),) if text]
    keys = list(scaling.missing_keys(*needed))
    for attribute, what, key in _UNITS if converts else ():
        if getattr(scaling, attribute) is None and key not in keys:
            if not parts or key not in parts[0]:
                parts.append(f"{what}: unknown, set {key}")
            keys.append(key)
    return Missing("; ".join(parts), tuple(keys))


LATENCY_NS: Final = 300 * MS
"""Shortest assumed time until a Statusword shows a command: 100 ms in each direction, the slowest cycle, and the event timer of
the TPDO."""


class PlcLossReaction(enum.Enum):
    """``on_plc_loss``: how the drive is stopped when the PLC is lost."""

    RAMP = "ramp"
    QUICK_STOP = "quick-stop"
    COAST = "coast"


class SetpointEnable(enum.Enum):
    """``setpoint_enable``: what STW1 bits 4-6 = 0 do in the velocity telegrams."""

    HOLD = "hold"
    """The last Target Velocity stays (the manufacturer's rule)."""
    PROFIDRIVE = "profidrive"
    """Bit 4 or 6 = 0: Target Velocity 0; bit 5 = 0: hold (the profile's)."""


class LastStop(enum.Enum):
    """``last_stop``: what a drive gets that no Quick Stop and no NMT stop has stopped."""

    DISABLE_VOLTAGE = "disable-voltage"
    """The shaft coasts, or its brake stops it."""
    NONE = "none"
    """Nothing: the load can fall, and the drive does not close its brake when its power goes."""


class SecondSensor(enum.Enum):
    """``g2``: source of G2 in telegrams 4, 6, 103 and 106."""

    NONE = "none"
    """G2 shows the error "not supported"."""
    DRIVE = "drive"
    """The drive's second encoder, 60E4h."""
    ENCODER = "encoder"
    """A channel of an encoder of its own."""


class ControlLost(enum.Enum):
    """``control_lost``: what STW1.10 = 0 does in operation; OFF1, OFF2 and OFF3 act in any case, and nothing starts."""

    STOP = "stop"
    """As OFF1, with a warning."""
    HOLD = "hold"
    """The last valid words stay in force (the manufacturer's rule)."""


@dataclass(frozen=True, slots=True)
class AxisSettings:
    """The user's choices for one axis."""

    on_plc_loss: PlcLossReaction = PlcLossReaction.QUICK_STOP
    setpoint_enable: SetpointEnable = SetpointEnable.PROFIDRIVE
    modulo_axis: bool = False
    ramp_stop_resume: bool = False
    """ON during an OFF1 ramp stop resumes operation (the PROFIdrive standard allows it; off by default)."""
    standstill_window: Fraction = Fraction(1, 100)
    """Standstill when |velocity| is at most this share of the reference speed."""
    control_lost: ControlLost = ControlLost.STOP
    reaction_ns: int = 400 * MS
    """Longest time until a stop must have an effect: twice the sum of RPDO refresh, event timer of the TPDO and one cycle."""
    stop_time_ns: int = 10 * SECOND
    """Time from 100 % speed to standstill with the drive's own ramps."""
    enter_ns: int = 10 * SECOND
    """Longest time from ON to Switched On, from Enable Operation to Operation Enabled, and at standstill out of it: DC link,
    commutation angle and brake take less."""
    last_stop: LastStop = LastStop.DISABLE_VOLTAGE
    stall_ns: int = 2 * SECOND
    """An axis that expects the end of its motion and makes no way for this time has stalled."""
    sign_of_life_failures: int = MONITORING_OFF
    """P925: tolerated failures of the PLC's sign of life in succession; 65535: not watched, only answered."""
    jog_speeds_rpm: tuple[Fraction, Fraction] | None = None
    """Signed, of jog 1 and jog 2 of the speed telegrams; None: their bits do nothing."""
    g1_is_encoder: bool = False
    """G1 is an encoder of its own, not the drive's position."""
    second_sensor: SecondSensor = SecondSensor.NONE
    cycle_ns: int = 0
    """Cycle of the PLC and period of SYNC; needed if setpoints are generated for each cycle."""
    dsc: DscChoices | None = None
    """Needed by telegrams 5, 6, 105 and 106."""
    intermediate_stop_reached: bool = False
    """ZSW1.10 = 1 at standstill in an intermediate stop; makers differ (docs/telegrams.md)."""
    positioner: PositionerChoices | None = None
    """Needed by telegrams 7, 110 and 111."""

    @property
    def latency_ns(self) -> int:
        """After this time, what the drive shows is its answer to a command."""
        return max(LATENCY_NS, self.reaction_ns)


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """The user's choices for one encoder."""

    sign_of_life_failures: int = MONITORING_OFF
    """P925: tolerated failures of the PLC's sign of life in succession; 65535 (off) where PLC and gateway cycles drift."""
