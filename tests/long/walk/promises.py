"""What a positioner promises about the shaft of its drive: one function for each rule, for the walk of the handshakes.

Source: docs/motion.md, docs/translation.md "Positioning, telegram 9 (MDI)". A rule sees words and the
shaft, nothing of the gateway.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit
from tests.long.walk.plc import ACTIVATE, DO_NOT_REJECT, ENABLE, FUNCTIONS, HOME, JOG, NO_INTERMEDIATE_STOP
from tests.long.walk.shaft import Line, Shaft, Signal
from tests.long.walk.values import Output, Plc, Shown

_OPERATION_ENABLED, _WARNING, _REACHED, _HOME_SET, _ACKNOWLEDGED = 1 << 2, 1 << 7, 1 << 10, 1 << 11, 1 << 12
"""Bits of ZSW1."""
STOP_LIMIT: Final = 3
"""Number of long times and starts before which a shaft without an order stops."""
WAIT_RESTS: Final = 4
"""Long times at standstill within which an order is carried out, or has a reason."""


class Awaited(enum.Enum):
    """The order that the PLC waits for."""

    NOTHING = 0
    TASK = ACTIVATE
    HOMING = HOME
    JOG = JOG


class Memory(NamedTuple):
    """What the PLC has ordered, and what the drive has done since."""

    bits: int = 0
    """The last bits of STW1 that start a motion by their edge."""
    operated: bool = False
    """The last ZSW1.2."""
    strobe: bool = False
    """The last New Setpoint."""
    task: int | None = None
    """Target of the task that may move the shaft; None also when the shaft is there."""
    homing: bool = False
    """A homing may move the shaft,"""
    jog: bool = False
    """and so may a jog."""
    awaited: Awaited = Awaited.NOTHING
    taken: bool = False
    """The drive has taken a setpoint since the edge of the task."""
    homed: bool = False
    """A homing has ended well since its edge."""
    home_set: bool = False
    """The last ZSW1.11."""
    unasked: int = 0
    """Long times in which the shaft turned without an order in this operation, and starts of such motions."""
    waits: int = 0
    """Long times at standstill in which neither the end of the order nor a reason was shown."""


class Moment(NamedTuple):
    """One cycle. ``before``: the memory of the cycle before it; ``now``: with the orders of this one."""

    before: Memory
    now: Memory
    plc: Plc
    shown: Shown
    output: Output
    was: Shaft
    """The drive before the cycle,"""
    shaft: Shaft
    """and after it."""

    def shows(self, bit: int) -> bool:
        """Whether ZSW1 has the bit."""
        return self.output.zsw1 & bit != 0

    @property
    def explained(self) -> bool:
        """The gateway reports that something is wrong."""
        return bool(self.output.reason) or self.shows(_WARNING)

    @property
    def strobe(self) -> bool:
        """New Setpoint rises in this cycle."""
        return self.output.controlword & ControlBit.NEW_SETPOINT != 0 and not self.before.strobe


def starts_without_edge(moment: Moment) -> bool:
    """A motion that was not ordered by an edge since the last stop is sent."""
    now, output = moment.now, moment.output
    if moment.strobe and output.mode == Mode.HOMING:
        return not now.homing
    is_there = output.target == moment.shaft.position and not moment.shaft.turns
    if moment.strobe and now.task != output.target and not is_there:
        return True
    return output.velocity != 0 and not now.jog


def does_not_stop(moment: Moment) -> bool:
    """The shaft turns for a long time, or repeatedly, after a stop order or without any order."""
    return moment.now.unasked >= STOP_LIMIT


def reached_while_turning(moment: Moment) -> bool:
    """ZSW1.10 says reached while the drive shows a speed."""
    return moment.shows(_REACHED) and moment.shown.velocity != 0


def reached_elsewhere(moment: Moment) -> bool:
    """ZSW1.10 says reached before the shaft has been at the target of the task."""
    now, word = moment.now, moment.plc.word
    goes_on = now.awaited is Awaited.TASK and now.task is not None and word & NO_INTERMEDIATE_STOP != 0
    return moment.shows(_REACHED) and goes_on and not moment.explained


def acknowledged_untaken(moment: Moment) -> bool:
    """ZSW1.12 acknowledges a task that the drive has not taken, after the cycle of its edge."""
    now = moment.now
    asks = now.awaited is Awaited.TASK and now.task is not None and now.bits & moment.before.bits & ACTIVATE != 0
    return moment.shows(_ACKNOWLEDGED) and asks and not now.taken


def home_set_early(moment: Moment) -> bool:
    """ZSW1.11 says that the home position is set before the drive has homed."""
    return moment.shows(_HOME_SET) and not moment.before.home_set and not moment.now.homed and not moment.shown.latched


def home_set_while_homing(moment: Moment) -> bool:
    """ZSW1.11 is 1 while the drive shows that it turns in a homing."""
    return moment.shows(_HOME_SET) and moment.shown.velocity != 0 and moment.now.homing and moment.was.homes


def waits_silently(moment: Moment) -> bool:
    """An order is not carried out, the shaft is at standstill, and no reason is shown."""
    return moment.now.waits >= WAIT_RESTS


class Rule(enum.Enum):
    """The rules; ``value`` is the sentence."""

    def __new__(cls, check: Callable[[Moment], bool]) -> Rule:
        """A rule of a function."""
        item = object.__new__(cls)
        item._value_ = check.__doc__
        return item

    def __init__(self, check: Callable[[Moment], bool]) -> None:
        self.check = check

    STARTS = (starts_without_edge,)
    STOPS = (does_not_stop,)
    REACHED = (reached_while_turning,)
    REACHED_THERE = (reached_elsewhere,)
    ACKNOWLEDGED = (acknowledged_untaken,)
    HOMED = (home_set_early,)
    HOMES = (home_set_while_homing,)
    WAITS = (waits_silently,)


UNKNOWABLE: Final[Mapping[Signal, frozenset[Rule]]] = {
    Signal.REACHED: frozenset(),
    Signal.ANSWER: frozenset({Rule.ACKNOWLEDGED, Rule.HOMED}),
    Signal.ERROR: frozenset(),
    Signal.DONE: frozenset({Rule.ACKNOWLEDGED, Rule.HOMED}),
    Signal.MODE: frozenset({Rule.ACKNOWLEDGED}),
}
"""Rules for which the gateway has no other evidence than this signal of a drive, so they need its truth."""


def judge(
    memory: Memory, plc: Plc, shown: Shown, output: Output, before: Line, after: Line, *, rests: bool, replaces: bool
) -> tuple[Memory, list[Rule]]:
    """The memory after a cycle, and the broken rules. ``before`` and ``after``: the drive before and after the cycle.

    ``replaces``: a homing replaces a task."""
    now = _ordered(memory, plc, output, replaces=replaces)
    shaft = after.shaft
    now = _counted(now, plc, shown, output, before.shaft, shaft, rests=rests)
    moment = Moment(memory, now, plc, shown, output, before.shaft, shaft)
    broken = [rule for rule in Rule if rule.check(moment)]
    return _done(now, moment, starts=after.starts), broken


def _ordered(memory: Memory, plc: Plc, output: Output, *, replaces: bool) -> Memory:
    """The orders of a frame: edges count in operation, and last until the stop that ends them."""
    word = plc.word if plc.setpoints is not None else 0
    operates = word & ENABLE == ENABLE and word & DO_NOT_REJECT and output.zsw1 & _OPERATION_ENABLED
    bits = word & FUNCTIONS
    rises = bits & ~memory.bits if operates else 0
    task, taken, homed, awaited, waits = memory.task, memory.taken, memory.homed, memory.awaited, memory.waits
    homes = bool(operates) and bool(bits & HOME) and not plc.passive
    homing = homes and (memory.homing or rises & HOME != 0)
    jog = bool(operates) and bool(bits & JOG) and (memory.jog or rises & JOG != 0)
    if not operates or not plc.mdi or (replaces and rises & HOME):
        task = None
    elif rises & ACTIVATE:
        task, taken = plc.target, False
    homed = homed and not rises & HOME
    gone = awaited is Awaited.TASK and task is None and memory.task is not None
    if not operates or gone or (awaited in {Awaited.HOMING, Awaited.JOG} and not bits & awaited.value):
        awaited = Awaited.NOTHING
    for order in (Awaited.HOMING, Awaited.JOG, Awaited.TASK):
        if order is Awaited.HOMING and plc.passive:
            continue  # the probe has no time limit
        if rises & order.value and awaited is Awaited.NOTHING and memory.operated:
            awaited, waits = order, 0
    if rises & ACTIVATE and awaited is Awaited.TASK:
        waits = 0
    return memory._replace(
        bits=bits, task=task, homing=homing, jog=jog, awaited=awaited, taken=taken, homed=homed, waits=waits
    )


def _counted(
    now: Memory, plc: Plc, shown: Shown, output: Output, before: Shaft, shaft: Shaft, *, rests: bool
) -> Memory:
    """Long times without an order and without an end."""
    suspended = not plc.word & NO_INTERMEDIATE_STOP
    asked = {
        Mode.POSITION: now.task is not None and not suspended,
        Mode.HOMING: now.homing,
        Mode.VELOCITY: now.jog,
    }[Mode(shaft.mode)]
    ordered = now.task is not None or now.homing or now.jog
    unasked = now.unasked
    if asked or (not shaft.turns and (ordered or not output.zsw1 & _OPERATION_ENABLED)):
        unasked = 0
    elif shaft.turns:
        unasked = min(unasked + rests + (not before.turns), STOP_LIMIT)
    told = bool(output.reason) or output.zsw1 & _WARNING != 0
    held = suspended and now.awaited is Awaited.TASK
    if now.awaited is Awaited.NOTHING or told or held or before.turns or shaft.turns:
        return now._replace(unasked=unasked, waits=0)
    return now._replace(unasked=unasked, waits=min(now.waits + rests, WAIT_RESTS))


def _done(now: Memory, moment: Moment, *, starts: bool) -> Memory:
    """What the drive has done in this cycle."""
    was, shaft, awaited = moment.was, moment.shaft, now.awaited
    there = now.task == shaft.position and not shaft.turns and not starts
    homed = now.homed or (now.homing and shaft.homed and not was.homed) or moment.shown.latched is True
    taken = shaft.taken and not was.taken and shaft.task in {None, now.task}
    ends = {
        Awaited.NOTHING: True,
        Awaited.TASK: now.task is None and moment.shows(_REACHED),
        Awaited.HOMING: homed and moment.shows(_HOME_SET),
        Awaited.JOG: shaft.turns,
    }
    return now._replace(
        operated=moment.shows(_OPERATION_ENABLED),
        strobe=moment.output.controlword & ControlBit.NEW_SETPOINT != 0,
        task=None if there else now.task,
        taken=now.taken or taken,
        homed=homed,
        home_set=moment.shows(_HOME_SET),
        awaited=Awaited.NOTHING if ends[awaited] or moment.shows(_WARNING) else awaited,
    )
