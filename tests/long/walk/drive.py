"""Everything a drive can report. This drive has no memory, so it can be late, ignore commands and report wrong states.

Every behaviour of a real drive, with any latency, rejection or wrong report, is a path through these values.
"""

from __future__ import annotations

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from tests.long.walk.values import Answered, Shown

TURNING = 3000
"""606Ch of an axis that turns, at the setpoint."""
_VOLTAGE = StatusBit.VOLTAGE_ENABLED | StatusBit.REMOTE
_NO_STATE = STATUS_OF[State.NOT_READY_TO_SWITCH_ON] | StatusBit.OPERATION_ENABLED | _VOLTAGE
_OPERATING = STATUS_OF[State.OPERATION_ENABLED] | _VOLTAGE
_OFF = STATUS_OF[State.SWITCH_ON_DISABLED] | _VOLTAGE
_ONLY_IN_FULL = (State.NOT_READY_TO_SWITCH_ON, State.FAULT_REACTION_ACTIVE)


def anything(mode: int, *, tasks: bool, homing: bool, jog: bool, full: bool) -> list[Shown]:
    """Each state, at standstill and turning where that matters; no state; a lost and a restarted drive.

    ``mode``: 6061h. ``tasks``: setpoints are acknowledged. ``homing``: the drive accepts SDO writes, and homes. ``jog``: it
    reports the mode of a speed. ``full``: also values that the machine treats as equal.
    """
    states = [state for state in STATUS_OF if full or state not in _ONLY_IN_FULL]
    shown = [Shown(state.value, STATUS_OF[state] | _VOLTAGE) for state in states]
    reached = _OPERATING | StatusBit.TARGET_REACHED
    shown += [
        Shown("Operation Enabled, turns, reached", reached, TURNING),
        Shown("no state, turns", _NO_STATE, TURNING),
        Shown("lost", _OPERATING, TURNING, ok=False),
        Shown("restarted", _OFF, restarted=True),
    ]
    if tasks:
        shown.append(Shown("Operation Enabled, acknowledged", _OPERATING | StatusBit.MODE_12, TURNING))
    if homing:
        homed = _OPERATING | StatusBit.MODE_12 | StatusBit.TARGET_REACHED
        shown += [
            Shown("Operation Enabled, parameters taken", _OPERATING, answer=""),
            Shown("Operation Enabled, parameters refused", _OPERATING, answer="refused"),
            Shown("Operation Enabled, homes", _OPERATING, TURNING, mode=Mode.HOMING),
            Shown("Operation Enabled, homed", homed, mode=Mode.HOMING),
            Shown("Operation Enabled, homing error", _OPERATING | StatusBit.MODE_13, mode=Mode.HOMING),
        ]
    if jog:
        shown.append(Shown("Operation Enabled, velocity mode", _OPERATING, mode=Mode.VELOCITY))
    if full:
        shown += [
            Shown("Operation Enabled, turns", _OPERATING, TURNING),
            Shown("Operation Enabled, at a limit", reached | StatusBit.INTERNAL_LIMIT),
            Shown("Quick Stop Active, turns", STATUS_OF[State.QUICK_STOP_ACTIVE] | _VOLTAGE, TURNING),
            Shown("restarted, Operation Enabled", _OPERATING, TURNING, restarted=True),
        ]
    return [item if item.mode else item._replace(mode=mode) for item in shown]


def polled(shown: list[Shown]) -> list[Shown]:
    """Those in which the speed matters also with a late answer for it, or none."""
    enabled = STATUS_OF[State.OPERATION_ENABLED]
    return [
        item._replace(name=", ".join(filter(None, (item.name, answered.value))), answered=answered)
        for item in shown
        for answered in (Answered if item.ok and item.statusword & enabled == enabled else (Answered.FRESH,))
    ]


def guarded(shown: list[Shown]) -> list[Shown]:
    """Each of them, also with the results of guarding: node stopped, or drive found without power."""
    lost = next(item for item in shown if not item.ok)
    return [
        *shown,
        lost._replace(name="lost, node stopped", stopped=True),
        lost._replace(name="lost, found without power", found_off=True),
    ]
