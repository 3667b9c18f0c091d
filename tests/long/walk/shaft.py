"""A drive with a shaft, for the walk of the handshakes: it takes setpoints, halts, homes, and may show something else.

It is as coarse as the gateway's decisions: few positions, standing or turning. A motion and a ramp last as long as the walk
chooses. Words reach the drive and the gateway a fixed number of cycles late.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import STATUS_OF, ControlBit, State, StatusBit
from tests.long.walk.drive import TURNING
from tests.long.walk.recovery import LateDrive
from tests.long.walk.values import Output, Shown

HOME_POSITION, TARGET_A, TARGET_B = 0, 125_000, 250_000
ON_THE_WAY = 62_500
"""Positions of the shaft, in the drive's unit."""
_VISIBLE = StatusBit.VOLTAGE_ENABLED | StatusBit.REMOTE
_OPERATING, _BRAKING = State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE


class Signal(enum.Enum):
    """What a drive can show wrongly."""

    REACHED = "SW.10"
    ANSWER = "SW.12"
    ERROR = "SW.13"
    DONE = "SW.10 and SW.12"
    MODE = "6061h"


class Wrong(enum.Enum):
    """How it shows a signal. ``MODE``: 1 is mode 1."""

    NEVER = "always 0"
    STUCK = "always 1"
    EARLY = "1 as soon as the shaft turns"
    FLICKERS = "wrong in single cycles"


class Event(enum.Enum):
    """What the shaft does by itself in a cycle."""

    NOTHING = ""
    ENDS = "it ends its motion"
    FAILS = "it stops on its way"


@dataclass(frozen=True, slots=True)
class Character:
    """A kind of drive. ``keeps``: Halt and power off interrupt its task, and it continues the task afterwards."""

    keeps: bool = False
    fails: bool = False
    """It may stop on its way, with SW.13."""
    signal: Signal = Signal.REACHED
    wrong: Wrong | None = None
    to_drive: int = 0
    to_gateway: int = 0
    """Cycles by which words are late."""


HONEST = Character()


class Word(NamedTuple):
    """What the gateway sends."""

    controlword: int = 0
    mode: int = Mode.POSITION
    velocity: int = 0
    target: int = 0


class Shaft(NamedTuple):
    """The drive."""

    state: State = State.SWITCH_ON_DISABLED
    mode: int = Mode.POSITION
    word: int = 0
    """New Setpoint and Fault Reset of the last Controlword."""
    task: int | None = None
    """Target that it has not reached."""
    taken: bool = False
    """The acknowledge of mode 1."""
    homes: bool = False
    homed: bool = False
    """Its last homing was successful; until another one starts."""
    failed: bool = False
    turns: bool = False
    position: int = HOME_POSITION

    def step(self, word: Word, event: Event, character: Character, *, rests: bool) -> Shaft:
        """One cycle. ``rests``: a long time passes, in which every ramp ends."""
        cw = word.controlword
        state = LateDrive(self.state, self.turns, had=self.word).after(cw, stays=False)
        operates, halted = state is _OPERATING, cw & ControlBit.HALT != 0
        task, taken, homes, homed, failed = self.task, self.taken, self.homes, self.homed, self.failed
        mode, position = word.mode, self.position
        if mode != self.mode or not operates:
            homes = failed = False
            task = task if character.keeps else None
        strobe = cw & ControlBit.NEW_SETPOINT
        starts = operates and strobe != 0 and not self.word & ControlBit.NEW_SETPOINT and not halted
        turns = self.turns
        taken = taken and strobe != 0 and mode == Mode.POSITION
        if starts and mode == Mode.POSITION:
            task, taken, failed = word.target, True, False
        elif starts and mode == Mode.HOMING:
            homes, homed, failed = True, False, False
            turns = False  # the motion that ends in this cycle is another one
        homes = homes and strobe != 0
        if task == position and mode == Mode.POSITION and operates and not halted:
            task = None
        return self._replace(
            state=state,
            mode=mode,
            word=cw & (ControlBit.NEW_SETPOINT | ControlBit.FAULT_RESET),
            task=task,
            taken=taken,
            homes=homes,
            homed=homed,
            failed=failed,
            turns=turns,
        )._turned(event, word, character, rests=rests)

    def _turned(self, event: Event, word: Word, character: Character, *, rests: bool) -> Shaft:
        """What the shaft does in this cycle."""
        mode, state, task, turns, position = self.mode, self.state, self.task, self.turns, self.position
        homes, homed, failed = self.homes, self.homed, self.failed
        operates, halted = state is _OPERATING, word.controlword & ControlBit.HALT != 0
        ways = {Mode.POSITION: task is not None, Mode.HOMING: homes, Mode.VELOCITY: word.velocity != 0}
        goes = operates and not halted and ways.get(Mode(mode), False)
        if goes and turns and event is not Event.NOTHING and mode != Mode.VELOCITY:
            turns = False
            if event is Event.FAILS:
                failed = True
            elif mode == Mode.HOMING:
                homed, position = True, HOME_POSITION
            elif task is not None:
                position = task
            task, homes = (None, False) if mode == Mode.POSITION else (task, False)
        elif goes:
            turns, position = True, ON_THE_WAY
        elif turns and (rests or event is not Event.NOTHING or state not in {_OPERATING, _BRAKING}):
            turns = False
        if halted and not turns and not character.keeps:
            task = None
        return self._replace(task=task, homes=homes, homed=homed, failed=failed, turns=turns, position=position)

    def shown(self, character: Character, *, flickers: bool) -> Shown:
        """What it shows. ``flickers``: the signal is wrong in this cycle."""
        position = self.mode == Mode.POSITION
        at_rest = not self.turns and not (position and self.failed)
        says = {
            Signal.REACHED: at_rest or self.mode == Mode.VELOCITY,
            Signal.ANSWER: self.taken if position else self.homed and self.mode == Mode.HOMING and not self.homes,
            Signal.ERROR: self.failed,
            Signal.MODE: position,
        }
        both = (Signal.REACHED, Signal.ANSWER)
        for signal in both if character.signal is Signal.DONE else (character.signal,):
            truth = says[signal]
            said = {Wrong.NEVER: False, Wrong.STUCK: True, Wrong.EARLY: truth or self.turns}
            says[signal] = (truth if character.wrong is None else said.get(character.wrong, truth)) is not flickers
        word = STATUS_OF[self.state] | _VISIBLE
        word |= StatusBit.TARGET_REACHED * says[Signal.REACHED] | StatusBit.MODE_12 * says[Signal.ANSWER]
        word |= StatusBit.MODE_13 * says[Signal.ERROR]
        mode = Mode.POSITION if says[Signal.MODE] else Mode.VELOCITY if position else self.mode
        speed = TURNING if self.turns else 0
        name = f"SW {word:04X} 6061h {mode} 606Ch {speed:4} 6064h {self.position:6}"
        return Shown(name, word, speed, mode=mode, position=self.position, answer="")

    def __str__(self) -> str:
        doing = "homes" if self.homes else "turns" if self.turns else "stands"
        return f"shaft {doing} at {self.position}" + (f", has task {self.task}" if self.task is not None else "")


class Line(NamedTuple):
    """The drive with the words on their way, oldest first."""

    shaft: Shaft
    sent: tuple[Word, ...] = ()
    shown: tuple[Shown, ...] = ()
    probe: bool = False
    """The touch probe is armed."""

    @property
    def starts(self) -> bool:
        """A setpoint to another place, a speed or a homing is on its way to the drive."""
        here = {0, self.shaft.position}
        return any(
            word.target not in here
            or word.velocity
            or (word.mode == Mode.HOMING and word.controlword & ControlBit.NEW_SETPOINT)
            for word in self.sent
        )

    @classmethod
    def of(cls, character: Character) -> Line:
        """A drive without power that has shown its state and received no command."""
        shaft = Shaft()
        shown = shaft.shown(character, flickers=False)
        return cls(shaft, (Word(),) * character.to_drive, (shown,) * character.to_gateway)

    def sees(self, character: Character) -> Iterator[Shown]:
        """What may arrive in this cycle."""
        first = self.shown[0] if self.shown else self.shaft.shown(character, flickers=False)
        yield first
        if character.wrong is Wrong.FLICKERS and not self.shown:
            yield self.shaft.shown(character, flickers=True)
        if self.probe:
            yield from (first._replace(latched=latched) for latched in (True, False))

    def after(self, output: Output, event: Event, character: Character, *, rests: bool, flickers: bool) -> Line:
        """One cycle later."""
        last = self.sent[-1].controlword if self.sent else self.shaft.word
        starts = output.controlword & ~last & ControlBit.NEW_SETPOINT and output.mode == Mode.POSITION
        word = Word(output.controlword, output.mode, output.velocity, output.target if starts else 0)
        sent = (*self.sent, word)
        shaft = self.shaft.step(sent[0], event, character, rests=rests)
        shown = (*self.shown, shaft.shown(character, flickers=flickers))[1:] if self.shown else ()
        return Line(shaft, sent[1:], shown, output.probe)
