"""The orders to a drive that are watched until the shaft has followed them: what must come in time, and what follows else.

``power_table`` and the machine name the order in force; ``stop_supervision`` and ``velocity_check`` act. Source: docs/safety.md.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Final


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
    PLC = 1
    DRIVE = 2
    RAMP = 3


class Order(enum.IntEnum):
    """What a command to a drive must bring about in time (``ORDERS``); ``stop_supervision`` acts if it does not."""

    NONE = 0
    ENTER = 1
    DISABLE = 2
    HALT = 3
    RAMP = 4
    STOP = 5
    OFF = 6
    OFF2 = 7


@dataclass(frozen=True, slots=True)
class Row:
    """The two parts of a limit, and its name for people."""

    leave: Leave
    line: Line
    text: str


ORDERS: Final = {
    Order.NONE: Row(Leave.NONE, Line.NONE, "may last: the PLC asks for it, or the drive has no power"),
    Order.ENTER: Row(Leave.ENTER, Line.NONE, "Enable Operation must lead to Operation Enabled, else Quick Stop"),
    Order.DISABLE: Row(Leave.RAMP, Line.DRIVE, "Disable Operation must brake (605Ch), else Quick Stop"),
    Order.HALT: Row(Leave.NONE, Line.PLC, "Halt (CW.8) in operation must brake, else Quick Stop"),
    Order.RAMP: Row(Leave.NONE, Line.RAMP, "the ramp of OFF1 must brake, else NMT stop"),
    Order.STOP: Row(Leave.BRAKE, Line.RAMP, "Quick Stop must end Operation Enabled and brake, else NMT stop"),
    Order.OFF: Row(Leave.BRAKE, Line.NONE, "Shutdown or Disable Voltage must remove the power, else NMT stop"),
    Order.OFF2: Row(Leave.OFF2, Line.NONE, "OFF2 of the PLC must remove the power, else NMT stop"),
}

LEAVE_TEXTS: Final = {
    Leave.NONE: "no limit",
    Leave.ENTER: "10 s (brake, commutation angle)",
    Leave.RAMP: "the reaction time and twice `stop_time_ms`; at standstill at least 10 s (brake)",
    Leave.BRAKE: "the reaction time; at standstill 10 s (brake)",
    Leave.OFF2: "the reaction time",
}
"""The reaction time is ``AxisSettings.reaction_ns``, the 10 s are ``AxisSettings.enter_ns``."""
LINE_TEXTS: Final = {
    Line.NONE: "no limit",
    Line.PLC: "falls at all in the reaction time and twice `stop_time_ms`, at least in 10 s",
    Line.DRIVE: "after the reaction time and 1/7 of `stop_time_ms` (jerk), has fallen by the standstill window, or by 5 % in "
    "each `stop_time_ms`",
    Line.RAMP: "falls, from the reaction time on, along a ramp of twice `stop_time_ms`",
}
"""Above the standstill window."""
