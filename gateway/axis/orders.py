"""The orders to a drive that are watched until the shaft has followed them: what must come in time, and what follows else.

``power_table`` and the machine name the order in force; ``stop_supervision`` and ``velocity_check`` act. Source: docs/safety.md.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Final

from pdgw.gateway.base.fault_numbers import FaultNumber


class Leave(enum.IntEnum):
    """Time in which a drive must leave the state that it shows under a command. The later members are the more urgent."""

    NONE = 0
    ENTER = 1
    RAMP = 2
    BRAKE = 3
    OFF2 = 4


class Line(enum.IntEnum):
    """Line under which the speed of a drive must be after a command."""

    NONE = 0
    SETPOINT = 1
    HALT = 2
    DRIVE = 3
    RAMP = 4


class Order(enum.IntEnum):
    """What a command to a drive must bring about in time (``ORDERS``)."""

    NONE = 0
    ENTER = 1
    SETPOINT = 2
    ZERO = 3
    HALT = 4
    STANDSTILL = 5
    DISABLE = 6
    RAMP = 7
    STOP = 8
    OFF = 9
    OFF2 = 10


class Brake(enum.IntEnum):
    """Stops beside the Controlword."""

    NONE = 0
    NMT_STOP = 1
    WITHHOLD_HEARTBEAT = 2


@dataclass(frozen=True, slots=True)
class Row:
    """One order: the state that must end, the line of the speed, the fault of a drive that does not follow, and a text.

    ``stops``: a stop is commanded already, so NMT stop is the next brake; else Quick Stop is.
    """

    leave: Leave
    line: Line
    stops: bool
    fault: FaultNumber
    text: str


_ENTERS, _STOPS, _SPEED = FaultNumber.NOT_ENTERED, FaultNumber.STOP_IGNORED, FaultNumber.VELOCITY
ORDERS: Final = {
    Order.NONE: Row(
        Leave.NONE,
        Line.NONE,
        False,
        _STOPS,
        "may last: the PLC asks for it, or the drive is off; an ON ends after `enter_ms`",
    ),
    Order.ENTER: Row(Leave.ENTER, Line.NONE, False, _ENTERS, "Enable Operation must lead to Operation Enabled"),
    Order.SETPOINT: Row(
        Leave.NONE, Line.SETPOINT, False, _SPEED, "a speed setpoint in operation, also 0, must not be exceeded"
    ),
    Order.ZERO: Row(
        Leave.NONE,
        Line.RAMP,
        False,
        _STOPS,
        "a speed setpoint inside the standstill window must brake a turning shaft; one below the minimum speed of an inverter "
        "(6046h), to 150 % of it",
    ),
    Order.HALT: Row(Leave.NONE, Line.HALT, False, _STOPS, "Halt (CW.8) in operation must brake"),
    Order.STANDSTILL: Row(
        Leave.NONE, Line.HALT, False, _STOPS, "Halt of an axis that turns without a task (warning 130) must brake"
    ),
    Order.DISABLE: Row(Leave.RAMP, Line.DRIVE, False, _ENTERS, "Disable Operation must brake (605Ch)"),
    Order.RAMP: Row(Leave.NONE, Line.RAMP, True, _STOPS, "the ramp of OFF1 must brake"),
    Order.STOP: Row(Leave.BRAKE, Line.RAMP, True, _STOPS, "Quick Stop must end Operation Enabled and brake"),
    Order.OFF: Row(Leave.BRAKE, Line.NONE, True, _STOPS, "Shutdown or Disable Voltage must remove the power"),
    Order.OFF2: Row(Leave.OFF2, Line.NONE, True, _STOPS, "OFF2 of the PLC must remove the power"),
}

LEAVE_TEXTS: Final = {
    Leave.NONE: "no limit",
    Leave.ENTER: "`enter_ms` (brake, commutation angle)",
    Leave.RAMP: "the reaction time and twice `stop_time_ms`; at standstill at least `enter_ms` (brake)",
    Leave.BRAKE: "the reaction time; at standstill `enter_ms` (brake)",
    Leave.OFF2: "the reaction time",
}
"""The reaction time is ``AxisSettings.reaction_ns``."""
LINE_TEXTS: Final = {
    Line.NONE: "no limit",
    Line.SETPOINT: "150 % of the setpoint and the standstill window, for 0.5 s; after a larger or an opposite setpoint, "
    "a ramp of twice `stop_time_ms`. Above 120 %: no growth by 1 % in each of five steps of 0.1 s",
    Line.HALT: "after the reaction time, falls by 5 % or the standstill window in each `stop_time_ms`, and does not grow by 1 % "
    "in each of five steps of 0.1 s; without a task, also not above 10 % for 0.5 s",
    Line.DRIVE: "after the reaction time and 1/7 of `stop_time_ms` (jerk), has fallen by the standstill window, or by 5 % in "
    "each `stop_time_ms`",
    Line.RAMP: "falls, from the reaction time on, along a ramp of twice `stop_time_ms`; under Quick Stop, does not grow by "
    "1 % in each fifth of the reaction time",
}
"""Above the standstill window."""
