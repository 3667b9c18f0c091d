"""The walk of the handshakes: setpoint acknowledge, Halt, homing, mode change and jog, with a drive that has a shaft.

Unlike the walk of the power stage, the drive is a model: it carries out what it gets, some cycles late, and may report one
signal wrongly. A cycle takes no time. When another equal cycle would change nothing, a long time may pass. So every age is walked
inside and beyond its end, and all latencies are short against it.
"""

from __future__ import annotations

import enum
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from struct import pack
from typing import NamedTuple

from pdgw.base.durations import SECOND
from pdgw.gateway.axis.executors.positions.motion import MotionExecutor
from pdgw.gateway.axis.executors.positions.telegram_9 import PositioningExecutor
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import POSITIONER_TELEGRAM_NUMBERS, TASK_TELEGRAM_NUMBERS
from pdgw.gateway.axis.values import ProbeAnswer, ProbeWish
from pdgw.gateway.motion.blocks import Block
from pdgw.profidrive.signals import POSITIONER_FORMS, signal
from pdgw.profidrive.telegrams import telegram
from tests.long.rules import Rule
from tests.long.walk.cases import Case, drive
from tests.long.walk.machine import Transducer
from tests.long.walk.plc import (
    ACTIVATE,
    CONTROL,
    DO_NOT_REJECT,
    ENABLE,
    HOME,
    HOMING_METHOD,
    JOG,
    LOST,
    MDI,
    NO_INTERMEDIATE_STOP,
    OFF1,
    OFF2,
    OFF3,
    READY_FOR_TASKS,
    frame,
)
from tests.long.walk.promises import UNKNOWABLE, Memory, judge
from tests.long.walk.search import Result, search
from tests.long.walk.shaft import HOME_POSITION, HONEST, TARGET_A, TARGET_B, Character, Event, Line, Signal, Wrong
from tests.long.walk.values import Numbered, Output, Plc, Shown

REST_NS = SECOND
"""The long time: every age of a handshake is one or two of it."""
_LU_PER_UNIT = 1000
_VELOCITY = 30_000


class Orders(enum.Enum):
    """What the PLC orders beside OFF1 and ON, by its name in a trace."""

    TASKS = ("task A", "task B", "STW1.5 = 0", "STW1.4 = 0", "no MDI")
    HOMING = ("homing", "STW1.4 = 0")
    MIXED = ("task A", "homing", "STW1.4 = 0")
    JOG = ("task A", "jog", "homing", "STW1.4 = 0")
    PROBE = ("task A", "probe", "STW1.4 = 0")
    POWER = ("task A", "homing", "OFF2", "OFF3", "no PLC")
    ALL = ("task A", "task B", "homing", "jog", "STW1.5 = 0", "STW1.4 = 0", "no MDI", "OFF2", "OFF3", "no PLC")


def frames(number: int, chosen: Orders) -> Iterator[Plc]:
    """What the PLC sends in a cycle."""
    on = ENABLE | READY_FOR_TASKS | CONTROL
    words = {
        "OFF1": on & ~ENABLE | OFF1,
        "ON": on,
        "task A": on | ACTIVATE,
        "task B": on | ACTIVATE,
        "STW1.5 = 0": (on | ACTIVATE) & ~NO_INTERMEDIATE_STOP,
        "STW1.4 = 0": (on | ACTIVATE) & ~DO_NOT_REJECT,
        "homing": on | HOME,
        "probe": on | HOME,
        "OFF2": on & ~ENABLE | OFF2,
        "OFF3": on & ~ENABLE | OFF3,
    } | ({"jog": on | JOG} if number in POSITIONER_TELEGRAM_NUMBERS else {"no MDI": on | ACTIVATE})
    for name, word in words.items():
        if name in {"OFF1", "ON", *chosen.value}:
            target = TARGET_B if name == "task B" else TARGET_A
            yield _frame(number, name, word, target, mdi=name != "no MDI", passive=name == "probe")
    if LOST.name in chosen.value:
        yield LOST


def _frame(number: int, name: str, word: int, target: int, *, mdi: bool, passive: bool) -> Plc:
    values = {
        "MDI_TARPOS": (target << 30) // 500_000 if number == 9 else target,
        "POS_STW2": signal("POS_STW2").bit("PASSIVE_HOMING").mask if passive else 0,
        "MDI_TARPOS_F": int.from_bytes(pack(">f", target / _LU_PER_UNIT), "big"),
    }
    if number == 7:
        values["SATZANW"] = POSITIONER_FORMS["SATZANW"].bit("BLOCK").mask & (target == TARGET_B)
    elif number in {9, 110} and not mdi:
        values["SATZANW"] = HOMING_METHOD * (number == 9)
    elif number == 110:
        values["SATZANW"] = MDI
    return frame(number, name, word, **values)._replace(target=target, mdi=mdi, passive=passive)


_PROBE = ProbeWish((0,))


class _Machine(Transducer):
    """The axis machine with the setpoint in its outputs."""

    def _number(self) -> int:
        # Each step in which the drive is known reads the position first; only a turntable uses the other.
        executor = self._machine.executor
        assert isinstance(executor, MotionExecutor)
        executor._seen.position = 0
        if isinstance(executor, PositioningExecutor):
            executor._resumed_at = 0
        return super()._number()

    def _step(self, plc: Plc, shown: Shown) -> Output:
        inputs, outputs = self._machine.inputs, self._machine.outputs
        if shown.latched is not None and outputs.probe is not None:
            positions = {0: HOME_POSITION} if shown.latched else {}
            inputs.news.append(ProbeAnswer(outputs.probe, positions, None if shown.latched else "refused"))
        output = super()._step(plc, shown)
        if outputs.probe is not None:
            outputs.probe = _PROBE  # so that armed probes are equal
        return output._replace(target=outputs.command.target_position, probe=outputs.probe is not None)


@dataclass(frozen=True, slots=True)
class Handshakes:
    """One walk: a telegram and a kind of drive."""

    number: int
    orders: Orders = Orders.ALL
    character: Character = HONEST

    @property
    def name(self) -> str:
        """Name for the output."""
        drive = self.character
        parts = (
            *(
                f"telegram {self.number} handshakes {self.orders.name}",
                "keeps tasks" * drive.keeps,
                "fails" * drive.fails,
            ),
            "" if drive.wrong is None else f"{drive.signal.value} {drive.wrong.value}",
            f"{drive.to_drive} + {drive.to_gateway} late" if drive.to_drive or drive.to_gateway else "",
        )
        return " ".join(filter(None, parts))

    def run(self, until: Collection[Rule] = ()) -> Result:
        """Walk to the fixpoint. ``until``: end when one of these rules is broken."""
        walk = _Walk(self)
        return search(walk, walk.machine, until)

    def machine(self) -> Transducer:
        """The axis machine of the telegram."""
        return _Machine(self.number, self._settings(), drive(), 0)

    def _settings(self) -> AxisSettings:
        settings = Case(self.number).settings()
        assert settings.positioner is not None
        blocks = tuple(Block(i, position=at, velocity=_VELOCITY) for i, at in enumerate((TARGET_A, TARGET_B)))
        return replace(settings, positioner=replace(settings.positioner, blocks=blocks, homing_method=HOMING_METHOD))


_Node = tuple[int, int, int]
"""Numbers of a state of the machine, a drive and a memory."""


class _Move(NamedTuple):
    """The choices of one cycle: the input of the machine, and what the drive does."""

    number: int
    event: Event
    rests: bool = False
    flickers: bool = False


class _Walk:
    """Drives and memories have numbers as the states of the machine have."""

    first = (0, 0, 0)

    def __init__(self, case: Handshakes) -> None:
        self._character = case.character
        self.machine = case.machine()
        self._replaces = case.number not in POSITIONER_TELEGRAM_NUMBERS
        self._orders = list(frames(case.number, case.orders))
        self._lines, self._memories = Numbered[Line](), Numbered[Memory]()
        self._lines.number(Line.of(self._character))
        self._memories.number(Memory())
        self._moves_of = cache(self._with_orders)
        self._after = cache(self._moved)
        self._judge = cache(self._checked)

    def moves(self, node: _Node) -> Iterator[_Move]:
        """A long time may pass only where an equal cycle changes nothing."""
        bits = self._memories[node[2]].bits
        for at_once, later in self._moves_of(node[1]):
            word = self.machine.inputs[at_once[0].number][0].word
            if word & ACTIVATE & ~bits and not word & NO_INTERMEDIATE_STOP:
                continue  # whether such an edge counts depends on what runs
            yield from at_once
            if self.go(node, at_once[0])[0] == node:
                yield from later

    def _with_orders(self, line: int) -> list[tuple[list[_Move], list[_Move]]]:
        """For each order: the choices of a cycle, the first of them without anything else, and those after a long time."""
        return [self._with_order(self._lines[line], plc) for plc in self._orders]

    def _with_order(self, line: Line, plc: Plc) -> tuple[list[_Move], list[_Move]]:
        character, number = self._character, self.machine.inputs.number
        events = [Event.NOTHING]
        if line.shaft.turns:
            events += [Event.ENDS, Event.FAILS] if character.fails else [Event.ENDS]
        shown = list(line.sees(character))
        later = number((plc, shown[0]._replace(after_ns=REST_NS)))
        flips = (False, True) if character.wrong is Wrong.FLICKERS and character.to_gateway else (False,)
        at_once = [
            _Move(number((plc, item)), event, flickers=flip) for item in shown for event in events for flip in flips
        ]
        return at_once, [_Move(later, event, rests=True) for event in events]

    def go(self, node: _Node, move: _Move) -> tuple[_Node, list[Rule]]:
        """The node after a cycle, and the broken rules."""
        state, place, memory = node
        after, output = self.machine.step(state, move.number)
        line = self._after(place, output, move._replace(number=0))
        remembered, broken = self._judge(memory, move.number, output, place, line, move.rests)
        return (after, line, remembered), broken

    def _moved(self, place: int, output: int, move: _Move) -> int:
        line, out = self._lines[place], self.machine.outputs[output]
        after = line.after(out, move.event, self._character, rests=move.rests, flickers=move.flickers)
        return self._lines.number(after)

    def _checked(
        self, memory: int, number: int, output: int, place: int, line: int, rests: bool
    ) -> tuple[int, list[Rule]]:
        words = self._memories[memory], *self.machine.inputs[number], self.machine.outputs[output]
        after, broken = judge(*words, self._lines[place], self._lines[line], rests=rests, replaces=self._replaces)
        unknown = UNKNOWABLE[self._character.signal] if self._character.wrong is not None else ()
        return self._memories.number(after), [rule for rule in broken if rule not in unknown]

    def line(self, node: _Node, move: _Move) -> str:
        """A cycle in a trace."""
        machine = self.machine
        out = machine.outputs[machine.step(node[0], move.number)[1]]
        plc, shown = machine.inputs[move.number]
        shaft = self._lines[self.go(node, move)[0][1]].shaft
        sent = (
            f"CW {out.controlword:04X} 6060h {out.mode} 60FFh {out.velocity} 607Ah {out.target:6} ZSW1 {out.zsw1:04X}"
        )
        time = "1 s    " if move.rests else "       "
        return f"{time}{plc.name:19} | {shown.name} | {sent} {out.reason:18} | {shaft} {move.event.value}"


_WRONG = tuple(
    Character(fails=signal is Signal.ERROR, signal=signal, wrong=wrong)
    for signal in Signal
    for wrong in Wrong
    if (signal, wrong) != (Signal.MODE, Wrong.EARLY)
)
_LATE = tuple(Character(to_drive=out, to_gateway=back) for out, back in ((1, 1), (0, 3), (3, 0), (3, 3)))
_LIARS = tuple(replace(liar, to_drive=1, to_gateway=1) for liar in _WRONG)
_DRIVES = (HONEST, Character(keeps=True), Character(fails=True), Character(fails=True, wrong=Wrong.STUCK), *_WRONG)


def _orders(number: int) -> list[Orders]:
    """What this telegram has."""
    without = {Orders.ALL}
    if number not in POSITIONER_TELEGRAM_NUMBERS:
        without.add(Orders.JOG)
    if "POS_STW2" not in telegram(number).setpoints.names:
        without.add(Orders.PROBE)
    return [item for item in Orders if item not in without]


def short() -> Iterator[Handshakes]:
    """For the tests: both positioners with a correct drive, and some that are late, keep a task or report a signal wrongly."""
    yield Handshakes(9, Orders.MIXED)
    yield Handshakes(9, Orders.TASKS, Character(keeps=True))
    yield Handshakes(9, Orders.TASKS, Character(wrong=Wrong.EARLY))
    yield Handshakes(9, Orders.HOMING, _LATE[0])
    yield Handshakes(110, Orders.TASKS, Character(signal=Signal.ANSWER, wrong=Wrong.STUCK))
    yield Handshakes(110, Orders.HOMING, Character(signal=Signal.DONE, wrong=Wrong.STUCK))
    yield Handshakes(110, Orders.HOMING, Character(wrong=Wrong.NEVER))


def selected() -> Iterator[Handshakes]:
    """For CI: each telegram with a correct drive; telegrams 9 and 110 with every kind of drive and every wrong signal."""
    yield from (Handshakes(number, item) for number in TASK_TELEGRAM_NUMBERS for item in _orders(number))
    yield from (Handshakes(number, Orders.MIXED, Character(keeps=True)) for number in (9, 110))
    for number, item in product((9, 110), (Orders.TASKS, Orders.HOMING)):
        yield from (Handshakes(number, item, kind) for kind in (*_DRIVES[1:], _LATE[0]))
        yield from (Handshakes(number, item, late) for late in _LATE[1:])


def every() -> Iterator[Handshakes]:
    """All orders of all telegrams with every kind of drive, and all orders together with a correct one.

    Telegrams 9 and 110 also have tasks and homing with a late drive that reports a signal wrongly."""
    before = list(selected())
    yield from before
    yield from (Handshakes(*each) for each in product((9, 110), (Orders.TASKS, Orders.HOMING), _LIARS))
    for number in TASK_TELEGRAM_NUMBERS:
        for item, kind in product(_orders(number), (*_DRIVES, *_LATE)):
            case = Handshakes(number, item, kind)
            if case not in before:
                yield case
        yield Handshakes(number, Orders.ALL)
