"""The user's choices for an axis or an encoder. Source: docs/translation.md."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

from pdgw.durations import MS, SECOND
from pdgw.gateway.motion.dsc import DscChoices
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.profidrive.sign_of_life import MONITORING_OFF

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
    """Longest time from Enable Operation to Operation Enabled: a brake and the search of the commutation angle take less."""
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
