"""The positioner's states and transitions, as data.

Source: basic positioners of public drive manuals (docs/motion.md). One function runs at a time. Another one starts from IDLE,
unless a row lets it replace the running one. In each step the first row whose event has occurred is used.
The docs contain this table, ``positioner`` executes it, the tests check all of it.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pdgw.gateway.motion.requests import Command


class State(enum.Enum):
    """States of the positioner: the active function; ``value`` is its name for people."""

    OFF = "not in operation"
    IDLE = "idle"
    MDI = "MDI position"
    SETTING_UP = "setting up"
    BLOCK = "traversing block"
    JOG = "jog"
    JOG_INCREMENTAL = "incremental jog"
    HOMING = "homing"
    TRACKING = "tracking"
    BRAKING = "braking"

    # Each member is a single object; Enum's own function is Python and would run in every cycle.
    __hash__ = object.__hash__


class Event(enum.Enum):
    """Conditions checked in a step; ``value`` is the text for readers."""

    NOT_OPERATING = "operation left, PLC lost, drive lost or in fault"
    OPERATING = "operation enabled"
    REJECTED = "STW1.4 = 0"
    TASK_REFUSED = "edge of STW1.6 with a task that cannot be done"
    MDI = "edge of STW1.6, MDI position"
    SETTING_UP = "edge of STW1.6, setting up"
    BLOCK = "edge of STW1.6, traversing block"
    CHANGED = "continuous update: a setpoint changed while STW1.6 = 1"
    REACHED = "target reached"
    BLOCK_DONE = "block done, another follows"
    CHAIN_DONE = "last block done"
    JOG = "one of STW1.8 and 9, POS_STW2.5 = 0"
    JOG_INCREMENTAL = "edge of one of STW1.8 and 9, POS_STW2.5 = 1"
    JOG_RELEASED = "STW1.8 = STW1.9, or the other one alone"
    HOMING = "edge of STW1.11"
    HOMING_LOST = "edge of STW1.11 with STW1.4 = 0 or SATZANW.15 = 0"
    HOMING_WITHDRAWN = "STW1.11 = 0"
    TASK_AFTER_HOMING = (
        "edge of STW1.6 in the frame with STW1.11 = 0 before the drive homes, or after the end of homing"
    )
    HOMING_OVER = "STW1.11 = 0 before the drive homes, or after the end of homing"
    HOMING_ATTAINED = "homing attained"
    HOMING_FAILED = "homing error"
    TRACKING = "POS_STW2.0 = 1"
    TRACKING_OFF = "POS_STW2.0 = 0"
    STANDING = "standstill"
    STANDING_HOMING = "standstill, a homing waits"
    STANDING_TASK = "standstill, a task waits"
    DESELECTED = "SATZANW.15 = 0"


class Action(enum.Enum):
    """Actions of a transition; ``value`` is the text for readers."""

    NOTHING = ""
    DROP = "drop task, kept task, jog and update"
    CLEAR = "clear the warning"
    BRAKE = "ramp to standstill, drop the task"
    BRAKE_TO_HOME = "ramp to standstill, keep the homing"
    REFUSE = "warning with the reason"
    REFUSE_AND_BRAKE = "warning, ramp to standstill"
    START = "start"
    REPLACE = "replace what runs"
    UPDATE = "take the new setpoints"
    FOLLOW = "run the next block"
    FINISH = "keep standing"
    JOG = "move while the bit is 1"
    JOG_DISTANCE = "move by the distance, once"
    HOME = "start homing"
    HOMED = "home position set, offset = reference coordinate"
    HOMING_ERROR = "warning: homing error"


@dataclass(frozen=True, slots=True)
class Transition:
    """One row of a state."""

    event: Event
    target: State
    action: Action = Action.NOTHING
    lost: int = 0
    """Bits that have lost their effect: while they are 1 they start nothing."""


_ACTIVATE, _HOME = Command.ACTIVATE_TASK, Command.START_HOMING
JOGS: Final = Command.JOG_1_ON | Command.JOG_2_ON
FUNCTIONS: Final = _ACTIVATE | _HOME | JOGS
"""Bits that start a function. One that is 1 and has started none, or whose function was rejected, is ignored."""
_LOST = Transition(Event.NOT_OPERATING, State.OFF, Action.DROP, FUNCTIONS)
_REJECTED = Transition(Event.REJECTED, State.BRAKING, Action.BRAKE, _ACTIVATE)
_JOG_REJECTED = Transition(Event.REJECTED, State.BRAKING, Action.BRAKE, JOGS)
_HOMING_REJECTED = Transition(Event.REJECTED, State.BRAKING, Action.BRAKE, _HOME)
_REFUSED = Transition(Event.TASK_REFUSED, State.BRAKING, Action.REFUSE_AND_BRAKE)
_REPLACED_BY_MDI = Transition(Event.MDI, State.MDI, Action.REPLACE)
_REPLACED_BY_SETTING_UP = Transition(Event.SETTING_UP, State.SETTING_UP, Action.REPLACE)
_REPLACED_BY_BLOCK = Transition(Event.BLOCK, State.BLOCK, Action.REPLACE)
_JOG_RELEASED = Transition(Event.JOG_RELEASED, State.BRAKING, Action.BRAKE, JOGS)
_TASK = (_LOST, _REJECTED, _REFUSED, _REPLACED_BY_MDI, _REPLACED_BY_SETTING_UP)
"""Rows of every task."""

TRANSITIONS: Mapping[State, tuple[Transition, ...]] = MappingProxyType(
    {
        State.OFF: (Transition(Event.OPERATING, State.IDLE, Action.CLEAR),),
        State.IDLE: (
            _LOST,
            Transition(Event.REJECTED, State.IDLE, Action.CLEAR),
            Transition(Event.TASK_REFUSED, State.IDLE, Action.REFUSE),
            Transition(Event.MDI, State.MDI, Action.START),
            Transition(Event.SETTING_UP, State.SETTING_UP, Action.START),
            Transition(Event.BLOCK, State.BLOCK, Action.START),
            Transition(Event.HOMING, State.HOMING, Action.HOME),
            Transition(Event.JOG, State.JOG, Action.JOG),
            Transition(Event.JOG_INCREMENTAL, State.JOG_INCREMENTAL, Action.JOG_DISTANCE),
            Transition(Event.TRACKING, State.TRACKING),
        ),
        State.MDI: (
            *_TASK,
            _REPLACED_BY_BLOCK,
            Transition(Event.CHANGED, State.MDI, Action.UPDATE),
            Transition(Event.REACHED, State.IDLE, Action.FINISH),
        ),
        State.SETTING_UP: (
            *_TASK,
            Transition(Event.BLOCK, State.SETTING_UP, Action.REFUSE),
            Transition(Event.CHANGED, State.SETTING_UP, Action.UPDATE),
        ),
        State.BLOCK: (
            *_TASK,
            _REPLACED_BY_BLOCK,
            Transition(Event.BLOCK_DONE, State.BLOCK, Action.FOLLOW),
            Transition(Event.CHAIN_DONE, State.IDLE, Action.FINISH),
        ),
        State.JOG: (_LOST, _JOG_REJECTED, _JOG_RELEASED),
        State.JOG_INCREMENTAL: (
            _LOST,
            _JOG_REJECTED,
            _JOG_RELEASED,
            Transition(Event.REACHED, State.IDLE, Action.FINISH),
        ),
        State.HOMING: (
            _LOST,
            _HOMING_REJECTED,
            Transition(Event.HOMING_ATTAINED, State.IDLE, Action.HOMED),
            Transition(Event.HOMING_FAILED, State.IDLE, Action.HOMING_ERROR),
            Transition(Event.HOMING_WITHDRAWN, State.BRAKING, Action.BRAKE),
        ),
        State.TRACKING: (
            _LOST,
            Transition(Event.REJECTED, State.TRACKING, Action.CLEAR),
            Transition(Event.TRACKING_OFF, State.IDLE),
        ),
        State.BRAKING: (_LOST, Transition(Event.STANDING, State.IDLE)),
    }
)
"""Every state with its rows, in the order of their check: what ends a motion comes first."""

_DROPPED = Transition(Event.NOT_OPERATING, State.IDLE, Action.DROP, FUNCTIONS)
MDI_TRANSITIONS: Mapping[State, tuple[Transition, ...]] = MappingProxyType(
    {
        State.IDLE: (
            _DROPPED,
            Transition(Event.HOMING, State.HOMING, Action.HOME),
            Transition(Event.MDI, State.MDI, Action.START),
        ),
        State.MDI: (
            _DROPPED,
            Transition(Event.HOMING_LOST, State.BRAKING, Action.BRAKE, _ACTIVATE | _HOME),
            _REJECTED,
            Transition(Event.DESELECTED, State.BRAKING, Action.BRAKE, _ACTIVATE),
            Transition(Event.HOMING, State.BRAKING, Action.BRAKE_TO_HOME),
            _REPLACED_BY_MDI,
            Transition(Event.REACHED, State.IDLE, Action.FINISH),
        ),
        State.BRAKING: (
            _DROPPED,
            Transition(Event.STANDING_HOMING, State.HOMING, Action.HOME),
            Transition(Event.STANDING_TASK, State.MDI, Action.START),
            Transition(Event.STANDING, State.IDLE),
        ),
        State.HOMING: (
            _DROPPED,
            _HOMING_REJECTED,
            Transition(Event.TASK_AFTER_HOMING, State.MDI, Action.START),
            Transition(Event.HOMING_OVER, State.IDLE, Action.FINISH),
            Transition(Event.HOMING_WITHDRAWN, State.BRAKING, Action.BRAKE),
        ),
    }
)
"""Those of telegram 9, whose homing may interrupt a task, and lasts until STW1.11 = 0."""

TASK_STATES = frozenset(state for state, rows in TRANSITIONS.items() if any(row.event is Event.MDI for row in rows)) | {
    State.BRAKING
}
"""States that accept an edge of STW1.6; BRAKING keeps it until standstill. Others reject it."""
JOG_STATES = frozenset({State.OFF, State.IDLE, State.JOG, State.JOG_INCREMENTAL, State.BRAKING})
"""The same for an edge of STW1.8 or .9; one before operation is early."""
