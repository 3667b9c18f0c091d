"""What makes the state of an axis known from a recording: an OFF while the drive is not powered."""

from __future__ import annotations

from typing import Final

from pdgw.dsp402.states import ControlBit, State, state_of
from pdgw.profidrive.signals import signal

HOME_POSITION_SET: Final = signal("ZSW1").bit("HOME_POSITION_SET", positioning=True).mask
"""Of the actual values: all that a machine has to be told beside."""
_CONTROL_BY_PLC: Final = signal("STW1").bit("CONTROL_BY_PLC").mask
_OFF: Final = ControlBit.ENABLE_VOLTAGE | ControlBit.QUICK_STOP
_OFF_MASK: Final = _OFF | ControlBit.SWITCH_ON
_UNPOWERED: Final = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)


def tells_state(word: int, statusword: int, *, transparent: bool) -> bool:
    """Whether STW1, or the Controlword of telegram 100, asks an unpowered drive for OFF: nothing of before matters then."""
    if not transparent and not word & _CONTROL_BY_PLC:
        return False
    return word & _OFF_MASK == _OFF and state_of(statusword) in _UNPOWERED
