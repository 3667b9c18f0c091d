"""What the walk of the handshakes sees of a positioner and the shaft of its drive, for the safety rules.

It sees words and the shaft, nothing of the gateway.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from typing import Final, NamedTuple

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit
from tests.long.rules import (
    ENABLE,
    ZSW1_HOME_SET,
    ZSW1_OPERATION,
    ZSW1_REACHED,
    ZSW1_WARNING,
    Rule,
    Seen,
    broken,
)
from tests.long.walk.plc import ACTIVATE, DO_NOT_REJECT, FUNCTIONS, HOME, JOG, NO_INTERMEDIATE_STOP
from tests.long.walk.shaft import Line, Shaft, Signal
from tests.long.walk.values import Output, Plc, Shown

STOP_LIMIT: Final = 3
"""Number of long times and starts before which a shaft without an order stops."""
WAIT_RESTS: Final = 4
"""Long times at standstill within which an order is carried out, or has a reason."""
UNKNOWABLE: Final[Mapping[Signal, frozenset[Rule]]] = {
    Signal.REACHED: frozenset(),
    Signal.ANSWER: frozenset({Rule.ACKNOWLEDGED, Rule.HOMED}),
    Signal.ERROR: frozenset(),
    Signal.DONE: frozenset({Rule.ACKNOWLEDGED, Rule.HOMED}),
    Signal.MODE: frozenset({Rule.ACKNOWLEDGED}),
}
"""Rules for which the gateway has no other evidence than this signal of a drive, so they need its truth."""


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


def judge(
    memory: Memory, plc: Plc, shown: Shown, output: Output, before: Line, after: Line, *, rests: bool, replaces: bool
) -> tuple[Memory, list[Rule]]:
    """The memory after a cycle, and the broken rules. ``before`` and ``after``: the drive before and after the cycle.

    ``replaces``: a homing replaces a task."""
    was, shaft = before.shaft, after.shaft
    now = _orders(memory, plc, output, replaces=replaces)
    now = _counted(now, plc, output, was, shaft, rests=rests)
    rules = broken(_seen(memory, now, plc, shown, output, was, shaft))
    return _done(now, shown, output, was, shaft, starts=after.starts), rules


def _seen(memory: Memory, now: Memory, plc: Plc, shown: Shown, output: Output, was: Shaft, shaft: Shaft) -> Seen:
    """One cycle. ``memory``: before it; ``now``: with its orders."""
    explained = bool(output.reason) or output.zsw1 & ZSW1_WARNING != 0
    strobe = output.controlword & ControlBit.NEW_SETPOINT != 0 and not memory.strobe
    homing = strobe and output.mode == Mode.HOMING
    there = output.target == shaft.position and not shaft.turns
    ordered = (not strobe or there or now.task == output.target) and (not output.velocity or now.jog)
    task = now.awaited is Awaited.TASK and now.task is not None
    under_way = task and plc.word & NO_INTERMEDIATE_STOP != 0
    return Seen(
        zsw1=output.zsw1,
        reason=explained,
        age=now.unasked,
        bound=STOP_LIMIT - 1,
        moves=strobe or output.velocity != 0,
        ordered=now.homing if homing else ordered,
        follows=not shown.velocity and (explained or not under_way),
        accepted=now.taken or not task or not now.bits & memory.bits & ACTIVATE,
        homed=now.homed or memory.home_set or bool(shown.latched),
        homes=shown.velocity != 0 and now.homing and was.homes,
        waits=now.waits >= WAIT_RESTS,
    )


def _orders(memory: Memory, plc: Plc, output: Output, *, replaces: bool) -> Memory:
    """The orders of a frame: edges count in operation, and last until the stop that ends them."""
    word = plc.word if plc.setpoints is not None else 0
    stays = ENABLE | DO_NOT_REJECT
    operates = word & stays == stays and output.zsw1 & ZSW1_OPERATION != 0
    bits = word & FUNCTIONS
    rises = bits & ~memory.bits if operates else 0
    task, taken = memory.task, memory.taken
    if not operates or not plc.mdi or (replaces and rises & HOME):
        task = None
    elif rises & ACTIVATE:
        task, taken = plc.target, False
    now = memory._replace(
        bits=bits,
        task=task,
        taken=taken,
        homing=operates and not plc.passive and bits & HOME != 0 and (memory.homing or rises & HOME != 0),
        jog=operates and bits & JOG != 0 and (memory.jog or rises & JOG != 0),
        homed=memory.homed and not rises & HOME,
    )
    gone = memory.awaited is Awaited.TASK and task is None and memory.task is not None
    return _awaits(now, rises, passive=plc.passive, ends=not operates or gone)


def _awaits(now: Memory, rises: int, *, passive: bool, ends: bool) -> Memory:
    """The order that the PLC waits for. ``passive``: a homing by the probe has no time limit."""
    awaited, waits = now.awaited, now.waits
    if ends or (awaited in {Awaited.HOMING, Awaited.JOG} and not now.bits & awaited.value):
        awaited = Awaited.NOTHING
    for order in (Awaited.JOG, Awaited.TASK) if passive else (Awaited.HOMING, Awaited.JOG, Awaited.TASK):
        if rises & order.value and awaited is Awaited.NOTHING and now.operated:
            awaited, waits = order, 0
    if rises & ACTIVATE and awaited is Awaited.TASK:
        waits = 0
    return now._replace(awaited=awaited, waits=waits)


def _counted(now: Memory, plc: Plc, output: Output, before: Shaft, shaft: Shaft, *, rests: bool) -> Memory:
    """Long times without an order and without an end."""
    suspended = not plc.word & NO_INTERMEDIATE_STOP
    asked = {
        Mode.POSITION: now.task is not None and not suspended,
        Mode.HOMING: now.homing,
        Mode.VELOCITY: now.jog,
    }[Mode(shaft.mode)]
    ordered = now.task is not None or now.homing or now.jog
    unasked = now.unasked
    if asked or (not shaft.turns and (ordered or not output.zsw1 & ZSW1_OPERATION)):
        unasked = 0
    elif shaft.turns:
        # A jog lets Halt fall, and the drive may continue for a cycle what Halt has stopped.
        unasked = min(unasked + rests + (not before.turns and not now.jog), STOP_LIMIT)
    explained = bool(output.reason) or output.zsw1 & ZSW1_WARNING != 0
    held = suspended and now.awaited is Awaited.TASK
    ends = now.awaited is Awaited.NOTHING or explained or held or before.turns or shaft.turns
    return now._replace(unasked=unasked, waits=0 if ends else min(now.waits + rests, WAIT_RESTS))


def _done(now: Memory, shown: Shown, output: Output, was: Shaft, shaft: Shaft, *, starts: bool) -> Memory:
    """What the drive has done in this cycle."""
    zsw1, awaited = output.zsw1, now.awaited
    there = now.task == shaft.position and not shaft.turns and not starts
    homed = now.homed or (now.homing and shaft.homed and not was.homed) or shown.latched is True
    taken = shaft.taken and not was.taken and shaft.task in {None, now.task}
    ends = {
        Awaited.NOTHING: True,
        Awaited.TASK: now.task is None and zsw1 & ZSW1_REACHED != 0,
        Awaited.HOMING: homed and zsw1 & ZSW1_HOME_SET != 0,
        Awaited.JOG: shaft.turns,
    }
    return now._replace(
        operated=zsw1 & ZSW1_OPERATION != 0,
        strobe=output.controlword & ControlBit.NEW_SETPOINT != 0,
        task=None if there else now.task,
        taken=now.taken or taken,
        homed=homed,
        home_set=zsw1 & ZSW1_HOME_SET != 0,
        awaited=Awaited.NOTHING if ends[awaited] or zsw1 & ZSW1_WARNING else awaited,
    )
