"""Check that an axis returns from every state: OFF ends without power and ON in operation, with a correct but slow drive.

The drive is CiA 402 with up to one step of latency in either direction, chosen for each step. All states are followed
together. After the allowed steps each must have reached its target.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import NamedTuple

from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from tests.long.walk.drive import TURNING
from tests.long.walk.machine import Transducer
from tests.long.walk.values import Output, Plc, Shown

_RESET = 0x80
_SHUTDOWN, _SWITCH_ON, _ENABLE = 0x6, 0x7, 0xF
_VOLTAGE, _STOPS = 0x2, 0x6
_BITS = StatusBit.VOLTAGE_ENABLED | StatusBit.REMOTE
_POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
STEPS_OF_OFF, STEPS_OF_ACKNOWLEDGE, STEPS_OF_ON = 16, 6, 10
"""Steps within which OFF removes power and a lost sign of life returns (15 correct counters), an acknowledgement ends a fault,
and ON leads to operation."""


class LateDrive(NamedTuple):
    """A correct drive. ``word``: the Controlword on its way to it. ``had``: the one it has received."""

    state: State
    turns: bool = False
    word: int = 0
    had: int = 0

    def step(self, output: Output, *, late: bool, stays: bool) -> LateDrive:
        """One cycle. ``late``: it uses the previous Controlword. ``stays``: it stays in Quick Stop Active (options 5 to 8)."""
        word = self.word if late else output.controlword
        state = self.after(word, stays=stays)
        operates = state is State.OPERATION_ENABLED
        turns = operates and output.velocity != 0
        return LateDrive(state, turns, output.controlword, word)

    def after(self, word: int, *, stays: bool) -> State:
        """The state of the drive after a Controlword."""
        state, command = self.state, word & _ENABLE
        if state is State.NOT_READY_TO_SWITCH_ON:
            return State.SWITCH_ON_DISABLED
        if state is State.FAULT_REACTION_ACTIVE:
            return State.FAULT
        if state is State.FAULT:
            return State.SWITCH_ON_DISABLED if word & ~self.had & _RESET else state
        if not word & _VOLTAGE:
            return State.SWITCH_ON_DISABLED
        if state is State.QUICK_STOP_ACTIVE:
            return state if stays or self.turns else State.SWITCH_ON_DISABLED
        if word & _STOPS == _VOLTAGE:
            return State.QUICK_STOP_ACTIVE if state is State.OPERATION_ENABLED else State.SWITCH_ON_DISABLED
        if command & _SWITCH_ON == _SHUTDOWN:
            return State.READY_TO_SWITCH_ON
        if state is State.SWITCH_ON_DISABLED:
            return state
        if state is State.READY_TO_SWITCH_ON or command == _SWITCH_ON:
            return State.SWITCHED_ON
        return State.OPERATION_ENABLED


class _Moment(NamedTuple):
    machine: int
    drive: LateDrive
    shown: Shown


def _shown(drive: LateDrive, mode: int) -> Shown:
    name = drive.state.value
    return Shown(name, STATUS_OF[drive.state] | _BITS, TURNING if drive.turns else 0, mode=mode)


def recovery(machine: Transducer, states: Iterable[int], mode: int, off: Plc, acknowledge: Plc, on: Plc) -> list[str]:
    """Send OFF, acknowledge, OFF and ON from all these states. Drives and outputs that are not where they must be."""
    drives = [LateDrive(state, turns) for state in State for turns in (False, True)]
    moments = {_Moment(number, drive, _shown(drive, mode)) for number in states for drive in drives}
    last: set[tuple[LateDrive, Output]] = set()
    steps = (off, STEPS_OF_OFF), (acknowledge, STEPS_OF_ACKNOWLEDGE), (off, STEPS_OF_OFF), (on, STEPS_OF_ON)
    for plc, count in steps:
        for _ in range(count):
            moments, last = _step(machine, moments, plc, mode)
        stuck = [
            f"after {plc.name}: {drive}, {output}"
            for drive, output in last
            if (drive.state is not State.OPERATION_ENABLED or output.reason if plc is on else drive.state in _POWERED)
        ]
        if stuck:
            return stuck
    return []


def _step(
    machine: Transducer, moments: set[_Moment], plc: Plc, mode: int
) -> tuple[set[_Moment], set[tuple[LateDrive, Output]]]:
    following: set[_Moment] = set()
    outputs: set[tuple[LateDrive, Output]] = set()
    for number, drive, shown in moments:
        after, place = machine.step(number, machine.inputs.number((plc, shown)))
        output = machine.outputs[place]
        stopping = drive.state is State.QUICK_STOP_ACTIVE
        for late, stays in product((False, True), (False, True) if stopping else (False,)):
            went = drive.step(output, late=late, stays=stays)
            outputs.add((went, output))
            following.update(_Moment(after, went, visible) for visible in {_shown(drive, mode), _shown(went, mode)})
    return following, outputs
