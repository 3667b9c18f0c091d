"""The CiA 402 state machine as tables: states, Statusword patterns, Controlword commands, transitions.

Source: CiA DSP 402 V2.0 chapter 10, the manufacturer's guide chapters 5.1 and 7.1/7.2.
The same table drives the simulator, the gateway's view of the drive, the decoder and the documentation.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Final

from pdgw.base.durations import MS


class State(enum.Enum):
    """Drive states; ``value`` is the name of the standard."""

    NOT_READY_TO_SWITCH_ON = "Not Ready to Switch On"
    SWITCH_ON_DISABLED = "Switch On Disabled"
    READY_TO_SWITCH_ON = "Ready to Switch On"
    SWITCHED_ON = "Switched On"
    OPERATION_ENABLED = "Operation Enabled"
    QUICK_STOP_ACTIVE = "Quick Stop Active"
    FAULT_REACTION_ACTIVE = "Fault Reaction Active"
    FAULT = "Fault"


UNPOWERED: Final = (
    State.NOT_READY_TO_SWITCH_ON,
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.FAULT,
)
"""Nothing turns the axis."""


@dataclass(frozen=True, slots=True)
class StatePattern:
    """Statusword bits of a state: ``word & mask == value``."""

    state: State
    mask: int
    value: int


# Bit 5 distinguishes Operation Enabled from Quick Stop Active. The guide's diagram prints x00x x011 for Quick Stop Active,
# its table x00x 0111: 0111 is sent, both are accepted.
STATUS_PATTERNS: Final = (
    StatePattern(State.NOT_READY_TO_SWITCH_ON, 0x4F, 0x00),
    StatePattern(State.SWITCH_ON_DISABLED, 0x4F, 0x40),
    StatePattern(State.READY_TO_SWITCH_ON, 0x6F, 0x21),
    StatePattern(State.SWITCHED_ON, 0x6F, 0x23),
    StatePattern(State.OPERATION_ENABLED, 0x6F, 0x27),
    StatePattern(State.QUICK_STOP_ACTIVE, 0x6F, 0x07),
    StatePattern(State.QUICK_STOP_ACTIVE, 0x6F, 0x03),
    StatePattern(State.FAULT_REACTION_ACTIVE, 0x4F, 0x0F),
    StatePattern(State.FAULT, 0x4F, 0x08),
)

STATUS_OF: Final = {
    State.NOT_READY_TO_SWITCH_ON: 0x0000,
    State.SWITCH_ON_DISABLED: 0x0040,
    State.READY_TO_SWITCH_ON: 0x0021,
    State.SWITCHED_ON: 0x0023,
    State.OPERATION_ENABLED: 0x0027,
    State.QUICK_STOP_ACTIVE: 0x0007,
    State.FAULT_REACTION_ACTIVE: 0x000F,
    State.FAULT: 0x0008,
}
"""Statusword bits 0-3, 5 and 6 a drive reports in a state."""


STATE_BITS: Final = reduce(or_, (pattern.mask for pattern in STATUS_PATTERNS))
"""All Statusword bits that define the state."""


def _decode_table() -> tuple[State | None, ...]:
    table: list[State | None] = [None] * 128
    for word in range(128):
        for pattern in STATUS_PATTERNS:
            if word & pattern.mask == pattern.value:
                table[word] = pattern.state
                break
    return tuple(table)


STATE_OF_STATUS: Final = _decode_table()
"""State by Statusword & 7Fh, None for a combination no state has (treat as unknown: stop)."""


def state_of(statusword: int) -> State | None:
    """The state a Statusword reports, None when its bits fit no state."""
    return STATE_OF_STATUS[statusword & 0x7F]


class ControlBit:
    """Controlword bits (6040h) of the profile; 11 to 15 are the manufacturer's, in the overlays (``dsp402/families``)."""

    SWITCH_ON: Final = 1 << 0
    ENABLE_VOLTAGE: Final = 1 << 1
    QUICK_STOP: Final = 1 << 2
    """Active low: 0 requests the quick stop."""
    ENABLE_OPERATION: Final = 1 << 3
    NEW_SETPOINT: Final = 1 << 4
    """Profile position: new setpoint; homing: operation start."""
    CHANGE_IMMEDIATELY: Final = 1 << 5
    RELATIVE: Final = 1 << 6
    FAULT_RESET: Final = 1 << 7
    HALT: Final = 1 << 8


class StatusBit:
    """Statusword bits (6041h)."""

    READY_TO_SWITCH_ON: Final = 1 << 0
    SWITCHED_ON: Final = 1 << 1
    OPERATION_ENABLED: Final = 1 << 2
    FAULT: Final = 1 << 3
    VOLTAGE_ENABLED: Final = 1 << 4
    NO_QUICK_STOP: Final = 1 << 5
    SWITCH_ON_DISABLED: Final = 1 << 6
    WARNING: Final = 1 << 7
    REMOTE: Final = 1 << 9
    TARGET_REACHED: Final = 1 << 10
    INTERNAL_LIMIT: Final = 1 << 11
    MODE_12: Final = 1 << 12
    """Setpoint acknowledge (1), speed is 0 (3), homing attained (6)."""
    MODE_13: Final = 1 << 13
    """Following error (1), max slippage (3), homing error (6)."""


class Command(enum.Enum):
    """Controlword commands: (bits that count, their value)."""

    SHUTDOWN = (0x07, 0x06)
    SWITCH_ON = (0x0F, 0x07)
    """In Operation Enabled the same word is Disable Operation."""
    ENABLE_OPERATION = (0x0F, 0x0F)
    DISABLE_VOLTAGE = (0x02, 0x00)
    QUICK_STOP = (0x06, 0x02)
    FAULT_RESET = (0x80, 0x80)
    """Only its rising edge counts."""

    # No __init__: mypyc cannot compile an enum that has one.

    @property
    def mask(self) -> int:
        return self.value[0]

    @property
    def word(self) -> int:
        return self.value[1]

    def matches(self, controlword: int) -> bool:
        return controlword & self.mask == self.word


_ENABLE_MASK: Final[int] = Command.ENABLE_OPERATION.mask
_ENABLE: Final[int] = Command.ENABLE_OPERATION.word


def enables(controlword: int) -> bool:
    """Whether a Controlword is Enable Operation; the same as ``matches`` without reading an enum in every cycle."""
    return controlword & _ENABLE_MASK == _ENABLE


def operates(controlword: int) -> bool:
    """Whether a Controlword lets a drive move: Enable Operation without Halt."""
    return enables(controlword) and not controlword & ControlBit.HALT


@dataclass(frozen=True, slots=True)
class Transition:
    """A numbered transition of the standard, triggered by a Controlword command."""

    number: int
    source: State
    command: Command
    target: State


COMMAND_TRANSITIONS: Final = (
    Transition(2, State.SWITCH_ON_DISABLED, Command.SHUTDOWN, State.READY_TO_SWITCH_ON),
    Transition(3, State.READY_TO_SWITCH_ON, Command.SWITCH_ON, State.SWITCHED_ON),
    # Enable Operation in Ready to Switch On executes transition 3; 4 follows with the next evaluation.
    Transition(3, State.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION, State.SWITCHED_ON),
    Transition(4, State.SWITCHED_ON, Command.ENABLE_OPERATION, State.OPERATION_ENABLED),
    Transition(5, State.OPERATION_ENABLED, Command.SWITCH_ON, State.SWITCHED_ON),
    Transition(6, State.SWITCHED_ON, Command.SHUTDOWN, State.READY_TO_SWITCH_ON),
    Transition(7, State.READY_TO_SWITCH_ON, Command.DISABLE_VOLTAGE, State.SWITCH_ON_DISABLED),
    Transition(7, State.READY_TO_SWITCH_ON, Command.QUICK_STOP, State.SWITCH_ON_DISABLED),
    Transition(8, State.OPERATION_ENABLED, Command.SHUTDOWN, State.READY_TO_SWITCH_ON),
    Transition(9, State.OPERATION_ENABLED, Command.DISABLE_VOLTAGE, State.SWITCH_ON_DISABLED),
    Transition(10, State.SWITCHED_ON, Command.DISABLE_VOLTAGE, State.SWITCH_ON_DISABLED),
    Transition(10, State.SWITCHED_ON, Command.QUICK_STOP, State.SWITCH_ON_DISABLED),
    Transition(11, State.OPERATION_ENABLED, Command.QUICK_STOP, State.QUICK_STOP_ACTIVE),
    Transition(12, State.QUICK_STOP_ACTIVE, Command.DISABLE_VOLTAGE, State.SWITCH_ON_DISABLED),
    Transition(15, State.FAULT, Command.FAULT_RESET, State.SWITCH_ON_DISABLED),
)
"""Transition 0, 1, 13 and 14 (and 12 at the end of the quick stop) happen inside the drive."""


_FROM: Final = {
    state: tuple(
        (*of.command.value, ControlBit.FAULT_RESET if of.command is Command.FAULT_RESET else 0, of.target)
        for of in COMMAND_TRANSITIONS
        if of.source is state
    )
    for state in State
}
"""Transitions from each state: mask and value of the Controlword, the bit that must rise, the target."""


def next_state(state: State, controlword: int, previous: int) -> State:
    """The state after a Controlword (``previous`` is the one before it, for the fault reset edge)."""
    for mask, word, rising, target in _FROM[state]:
        if controlword & mask == word and not previous & rising:
            return target
    return state


EDGE_NS: Final = 50 * MS
"""Duration of each level of a repeated fault reset, long enough for the drive."""


class FaultReset:
    """Rising edges of Controlword 7 for a drive that needs several of them to leave its fault: one in, ``edges`` out.

    ``step`` is the Controlword to send; it is called in every cycle with the time (monotonic nanoseconds).
    """

    def __init__(self, edges: int) -> None:
        self._edges = edges
        self._asked = self._high = False
        self._left = 0
        self._until = 0

    def step(self, word: int, statusword: int, now: int) -> int:
        asked = bool(word & ControlBit.FAULT_RESET)
        if asked and not self._asked:
            self._left, self._high, self._until = self._edges, True, now + EDGE_NS
        self._asked = asked
        if not self._left:
            return word
        if now >= self._until:
            self._left -= self._high
            self._high, self._until = not self._high, now + EDGE_NS
        if state_of(statusword) is not State.FAULT:
            self._left = 0
        return word | ControlBit.FAULT_RESET if self._left and self._high else word & ~ControlBit.FAULT_RESET
