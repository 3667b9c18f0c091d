"""Everything a drive can show: the walk's drive has no memory, so that it can be late, deaf, and lie in every way."""

from __future__ import annotations

from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from pdgw.workshop.walk.values import Shown

TURNING = 3000
"""606Ch of an axis that turns."""
_VOLTAGE = StatusBit.VOLTAGE_ENABLED | StatusBit.REMOTE
_NO_STATE = STATUS_OF[State.NOT_READY_TO_SWITCH_ON] | StatusBit.OPERATION_ENABLED
_OPERATING = STATUS_OF[State.OPERATION_ENABLED] | _VOLTAGE


def anything() -> list[Shown]:
    """Each state, standing and turning where that makes a difference, no state, a lost and a restarted drive."""
    shown = [Shown(state.value, word | _VOLTAGE) for state, word in STATUS_OF.items()]
    shown += [
        Shown("Operation Enabled, turns", _OPERATING, TURNING),
        Shown("Operation Enabled, turns, reached", _OPERATING | StatusBit.TARGET_REACHED, TURNING),
        Shown("Operation Enabled, at a limit", _OPERATING | StatusBit.TARGET_REACHED | StatusBit.INTERNAL_LIMIT),
        Shown("Quick Stop Active, turns", STATUS_OF[State.QUICK_STOP_ACTIVE] | _VOLTAGE, TURNING),
        Shown("a Statusword of no state", _NO_STATE | _VOLTAGE, TURNING),
        Shown("lost", _OPERATING, TURNING, ok=False),
        Shown("restarted", STATUS_OF[State.SWITCH_ON_DISABLED] | _VOLTAGE, restarted=True),
    ]
    return shown
