"""What the walk of the guarding sees of NMT Stop and of the withheld heartbeat of the gateway, for the safety rules.

Source: docs/safety.md, "A drive that does not stop"; CiA 301, node guarding and heartbeat. Imports only the names of these
stops from the supervision.
"""

from __future__ import annotations

from typing import NamedTuple

from pdgw.dsp402.states import STATE_OF_STATUS, State
from pdgw.gateway.axis.orders import Brake
from tests.long.rules import UNPOWERED, Rule, Seen, broken
from tests.long.walk.plc import ENABLE
from tests.long.walk.values import Output, Plc, Shown

_STOPS, _QUICK_STOP = 0x6, 0x2
_MUST_END = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
_REACTION = 4
"""Steps until the reaction time (400 ms) and the braking time from full speed are over."""
_LEAVE = 5
"""The same after Disable Operation: the drive may brake with half of the ramp that the braking time is derived from."""
_NMT_REACTION = 2
"""Steps after NMT Stop until its reaction time is over."""


class BrakeMemory(NamedTuple):
    """State of the rules between steps."""

    brake: Brake = Brake.NONE
    ramp: bool = False
    """Enable Operation stays set for a ramp."""
    stop: bool = False
    """Quick Stop or Disable Voltage was commanded, not only Disable Operation: then the drive has its time again."""
    off2: bool = False
    """OFF2 was commanded: a drive at standstill has no more time than one that turns."""
    since: int = 0
    """Steps since it ignored the first command, also without it, or with another command."""
    ignores: int = 0
    """Steps in which the drive reported a state that the command ends: operation, and with Disable Voltage the quick stop."""
    state: State | None = None
    """The last of these states."""
    turns: int = 0
    """Steps in which it turned although it was braking under power."""
    waits: int = 0
    """Steps since NMT Stop was commanded."""
    obeyed: bool = False
    """The node has reported Stopped since then."""
    tried: bool = False
    """NMT Stop was executed and the drive was not off."""
    closes: bool = False
    """It was at standstill in the last step with a Statusword, and had the time of its brake."""


class BrakeMonitor:
    """Checks the steps in order. ``still_steps``: steps that a drive at standstill has for its brake; 0: no more than one that
    turns."""

    first = BrakeMemory()

    def __init__(self, still_steps: int = 0) -> None:
        self._still = still_steps

    def step(self, before: BrakeMemory, plc: Plc, shown: Shown, output: Output) -> tuple[BrakeMemory, list[Rule]]:
        """The state of the rules after the step, and the broken rules."""
        brake, cw = output.brake, output.controlword
        state = STATE_OF_STATUS[shown.statusword & 0x7F] if shown.ok else None
        off = shown.found_off or state in {*UNPOWERED, State.FAULT}
        braking = before.brake is Brake.NMT_STOP
        obeyed = braking and (before.obeyed or shown.stopped)
        there_again = obeyed and shown.ok
        tried = before.tried
        if there_again or off:
            before, tried = before._replace(ignores=0, turns=0), not off
        ramp = cw & ENABLE == ENABLE and (before.ramp or plc.word & ENABLE != ENABLE)
        stop = cw & _STOPS != _STOPS
        ignores, ignored = _ignored(before, shown, state, cw, max(_LEAVE, self._still + 3))
        off2 = ignores > 0 and (
            before.off2 or (shown.ok and plc.setpoints is not None and plc.word & _STOPS in (0x0, 0x4))
        )
        ends = ignores == 0 and (shown.ok or before.since == 0)
        since = 0 if ends else min(before.since + 1, self._still + 2)
        if off2 and not before.off2 and since > _REACTION:
            ignores = 1  # a drive that waited for its brake has the time of OFF2
        turns = before.turns
        if shown.ok:
            with_power = ramp or cw & _STOPS == _QUICK_STOP
            turns = min(turns + 1, _REACTION) if with_power and shown.velocity else 0
        waits = min(before.waits + 1, _NMT_REACTION) if braking else 0
        patience = _REACTION if stop else _LEAVE
        closes = shown.velocity == 0 and not off2 and not (braking or tried)
        if closes:
            patience = max(patience, self._still + (2 if stop else 3))  # Quick Stop comes before NMT Stop
        seen = Seen(
            brake=brake,
            braked=before.brake,
            overdue=(shown.ok and ignores >= patience and (stop or closes or not before.closes)) or turns == _REACTION,
            continues=(ignores > 0 and since > (self._still if closes else 0)) or turns > 0,
            unstopped=tried or (waits == _NMT_REACTION and not obeyed),
            off=off or there_again,
        )
        still = brake is Brake.NMT_STOP
        waits = waits if still else 0
        closes = (closes if shown.ok else before.closes) and ignores > 0
        obeyed = obeyed and still
        memory = BrakeMemory(brake, ramp, stop, off2, since, ignores, ignored, turns, waits, obeyed, tried, closes)
        return memory, broken(seen)


def _ignored(before: BrakeMemory, shown: Shown, state: State | None, cw: int, most: int) -> tuple[int, State | None]:
    """Steps in which the drive ignores the command, and the state that it does not leave."""
    stop = cw & _STOPS != _STOPS
    repeated = stop is before.stop
    if not shown.ok:
        return (before.ignores, before.state) if repeated and before.ignores else (0, None)
    ends = _MUST_END if stop and not cw & _QUICK_STOP else _MUST_END[:1]
    if cw & ENABLE == ENABLE or state not in ends:
        return 0, None
    return min(before.ignores + 1, most) if repeated and state is before.state else 1, state
