"""States of the power stage, commands, and limits of time: the vocabulary of the power table and its users.

Source: docs/translation.md "States".
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Final

from pdgw.dsp402.states import ControlBit, State


class Phase(enum.IntEnum):
    """State of the power stage, as the gateway commands it."""

    LOCKED = 0
    """Power is off; only an OFF is accepted."""
    UNCONFIRMED = 1
    """As LOCKED, but the drive may be in operation: Quick Stop until it shows that it is off."""
    FOLLOW = 2
    """The drive follows the PLC, one transition at a time."""
    PASS = 3
    """The Controlword of the telegram passes."""
    RAMP_STOP = 4
    """OFF1, or loss of the PLC: ramp to standstill with power on."""
    SHUTDOWN = 5
    """After the ramp: power off."""
    QUICK_STOP = 6
    """Quick Stop until the drive has left Quick Stop Active."""
    COAST = 7
    """OFF2: Disable Voltage until the drive shows no power. Only an OFF ends it."""
    INHIBITED = 8
    """As LOCKED, but the drive does not leave Switch On Disabled (STO, supply): Shutdown, so that it shows when that ends."""


class Drive(enum.IntEnum):
    """State of the drive; the last eleven need more than its Statusword."""

    NOT_READY = 0
    DISABLED = 1
    READY = 2
    SWITCHED_ON = 3
    OPERATING = 4
    """Operation enabled, as the last Controlword commanded."""
    QUICK_STOPPING = 5
    FAULT = 6
    UNKNOWN = 7
    """The Statusword matches no state."""
    STANDING = 8
    """As ``OPERATING``, inside the standstill window."""
    QUICK_STOPPED = 9
    """Quick Stop Active at standstill, and the drive stays in it (option codes 5-8)."""
    FELL_BACK = 10
    """Left operation without a command."""
    FELL_OFF = 11
    """Fell back to Switch On Disabled."""
    LOST = 12
    """Not online, or silent."""
    NO_REFERENCES = 13
    """Its reference objects are missing or invalid, so its speed is unknown."""
    POWERED_UNREAD = 14
    """As NO_REFERENCES, and it may have power: by its Statusword, or because the last Controlword was Enable Operation."""
    RESTARTED = 15
    """It booted or was configured again. This has priority over its Statusword."""
    LEAVING = 16
    """Operation enabled, but the last Controlword was another one: the Statusword is old, or the drive ramps down by Disable
    Operation. It may be off already, so Enable Operation could switch it on."""
    ENTERING = 17
    """Switched on, but the last Controlword was Enable Operation: the drive may be in operation already."""
    INHIBITED = 18
    """Not ready, or Switch On Disabled, although Shutdown is commanded: STO or the supply is missing, or it tests itself."""


class Action(enum.IntEnum):
    """Command to the drive."""

    DISABLE_VOLTAGE = 0
    QUICK_STOP = 1
    SHUTDOWN = 2
    SWITCH_ON = 3
    """In operation, this word is Disable Operation."""
    ENABLE_OPERATION = 4
    RAMP = 5
    """Enable Operation, while the executor ramps the axis to standstill."""
    RAMP_END = 6
    """Shutdown at the end of a ramp."""
    PASS = 7
    """The Controlword of the telegram."""


_SHUTDOWN = ControlBit.ENABLE_VOLTAGE | ControlBit.QUICK_STOP
_SWITCH_ON = _SHUTDOWN | ControlBit.SWITCH_ON
_ENABLE_OPERATION = _SWITCH_ON | ControlBit.ENABLE_OPERATION
CONTROLWORDS: Final = (
    0,
    ControlBit.ENABLE_VOLTAGE,
    _SHUTDOWN,
    _SWITCH_ON,
    _ENABLE_OPERATION,
    _ENABLE_OPERATION,
    _SHUTDOWN,
    0,
)
"""Controlword bits 0-3 by ``Action``; of PASS they are the telegram's."""

DRIVE_OF_STATE: Final = {
    State.NOT_READY_TO_SWITCH_ON: Drive.NOT_READY,
    State.SWITCH_ON_DISABLED: Drive.DISABLED,
    State.READY_TO_SWITCH_ON: Drive.READY,
    State.SWITCHED_ON: Drive.SWITCHED_ON,
    State.OPERATION_ENABLED: Drive.OPERATING,
    State.QUICK_STOP_ACTIVE: Drive.QUICK_STOPPING,
    State.FAULT_REACTION_ACTIVE: Drive.FAULT,
    State.FAULT: Drive.FAULT,
    None: Drive.UNKNOWN,
}


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


class Limit(enum.IntEnum):
    """What a command to a drive must bring about in time (``COLUMNS``); ``stop_supervision`` acts if it does not."""

    NONE = 0
    ENTER = 1
    DISABLE = 2
    HALT = 3
    RAMP = 4
    STOP = 5
    OFF = 6
    OFF2 = 7


@dataclass(frozen=True, slots=True)
class Columns:
    """The two parts of a limit, and its name for people."""

    leave: Leave
    line: Line
    text: str


COLUMNS: Final = {
    Limit.NONE: Columns(Leave.NONE, Line.NONE, "may last: the PLC asks for it, or the drive has no power"),
    Limit.ENTER: Columns(Leave.ENTER, Line.NONE, "Enable Operation must lead to Operation Enabled, else Quick Stop"),
    Limit.DISABLE: Columns(Leave.RAMP, Line.DRIVE, "Disable Operation must brake (605Ch), else Quick Stop"),
    Limit.HALT: Columns(Leave.NONE, Line.PLC, "Halt (CW.8) in operation must brake, else Quick Stop"),
    Limit.RAMP: Columns(Leave.NONE, Line.RAMP, "the ramp of OFF1 must brake, else NMT stop"),
    Limit.STOP: Columns(Leave.BRAKE, Line.RAMP, "Quick Stop must end Operation Enabled and brake, else NMT stop"),
    Limit.OFF: Columns(Leave.BRAKE, Line.NONE, "Shutdown or Disable Voltage must remove the power, else NMT stop"),
    Limit.OFF2: Columns(Leave.OFF2, Line.NONE, "OFF2 of the PLC must remove the power, else NMT stop"),
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
