"""Defects planted in the gateway, to measure the time in which the soak finds each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any, Final

from pdgw.base.durations import SECOND
from pdgw.ds301.node.client import NodeClient
from pdgw.dsp402.drive import tpdo_check
from pdgw.dsp402.states import STATE_OF_STATUS
from pdgw.gateway.axis import interlock
from pdgw.gateway.axis.adapters.adapter import ControlWordAdapter
from pdgw.gateway.axis.adapters.speed_words import SpeedAdapter
from pdgw.gateway.axis.demand_report import STATE_MASK, Flag, PowerWish
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.power_states import Action, Drive, Phase
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.axis.supervision.drive_events import NodeWatch
from pdgw.gateway.axis.supervision.enable_guard import EnableGuard
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.new_frames import Verdict
from pdgw.profidrive.frame import IOPS_GOOD
from tests.long.planted import LOCKS, Patch, Plant, each_cell, replaced, wrapped
from tests.long.rules import FAULTY
from tests.long.soak.calm import CalmRun, draw_calm
from tests.long.soak.plan import parts
from tests.long.soak.soak_run import SoakRun
from tests.long.soak.watch import ViolationError

LIMIT_NS: Final = 7200 * SECOND
"""Virtual time in which the soak must find each defect."""
_SHUTDOWN: Final = 0x06
_RUNNING: Final = (Phase.FOLLOW, Phase.PASS)
CALM: Final = {"a TPDO that shows every motion counts as not sent": 111}
"""Defects that a calm day finds, with its telegram; the soak finds the others."""


@dataclass(frozen=True, slots=True)
class Found:
    """``time_ns``: virtual time until the soak found the defect; None: not within the limit."""

    time_ns: int | None
    message: str


def _unguarded(plant: Plant) -> Plant:
    """Remove the final guard as well, because it would stop what this defect starts."""

    def planted(patch: Patch) -> None:
        plant(patch)
        patch.setattr(EnableGuard, "step", lambda self, wish, controlword: True)

    return planted


def _fault_ignored(method: Any, self: Interlock, wish: Any, *arguments: Any) -> None:
    before = self.phase
    method(self, wish, *arguments)
    faulty = STATE_OF_STATUS[arguments[2] & STATE_MASK] in FAULTY
    if faulty and before in _RUNNING and self.phase not in _RUNNING:
        self.phase = before


def _never_lost(method: Any, self: Interlock, wish: Any, acknowledge: bool, condition: Any, *arguments: Any) -> None:
    method(self, wish, acknowledge, None if condition is Drive.LOST else condition, *arguments)


def _never_again(method: Any, self: Any) -> None:
    if self.generation:
        self.loop.sleep(3600 * SECOND)
    method(self)


def _speed_doubled(method: Any, self: SpeedAdapter, setpoints: Any) -> None:
    method(self, setpoints)
    self._asked.speed *= 2


def _stop_accepted(method: Any, *arguments: Any) -> Verdict:
    verdict: Verdict = method(*arguments)
    return Verdict.ACCEPTED if verdict is Verdict.PROVIDER_STOP else verdict


def _iops_ignored(method: Any, self: CyclicEndpoint, data: bytes, *arguments: Any, **named: Any) -> None:
    good = bytearray(data)
    for *_, iops in self._axes:
        good[iops] |= IOPS_GOOD
    method(self, bytes(good), *arguments, **named)


def _never_trusted(patch: Patch) -> None:
    """An object that was sent with every motion is compared again, and the first difference counts."""
    patch.setattr(tpdo_check.Place, "confirmed", property(lambda self: False))
    patch.setattr(tpdo_check, "CONTRADICTIONS", 1)


_QUICK_STOP_COASTS: Final = each_cell(
    lambda cell: replace(cell, controlword=_SHUTDOWN) if cell.action is Action.QUICK_STOP else cell
)

DEFECTS: Final[Mapping[str, Plant]] = {
    "setpoints stay in force after a loss of the PLC": replaced(CyclicEndpoint, "lose_setpoints", lambda self: None),
    "a lost PLC does not stop the drive": replaced(
        interlock, "_NO_PLC", dict.fromkeys(PlcLossReaction, PowerWish.ENABLE)
    ),
    "a lost drive is not brought up again": wrapped(NodeClient, "_bring_up", _never_again),
    "an EMCY is not in the fault buffer": replaced(NodeWatch, "_emergency", lambda self, notice: None),
    "the drive gets twice the speed": wrapped(SpeedAdapter, "read", _speed_doubled),
    "ZSW1.10 is always 1": wrapped(
        ControlWordAdapter, "status", lambda method, self, flags: method(self, flags | Flag.REACHED)
    ),
    "the drive follows a PLC in STOP": wrapped(CyclicEndpoint, "_check", _stop_accepted),
    "the drive follows setpoints with IOPS BAD": wrapped(CyclicEndpoint, "_take", _iops_ignored),
    "a Statusword older than the command counts as new": _unguarded(replaced(interlock, "_LEAVING", Drive.OPERATING)),
    "a TPDO that shows every motion counts as not sent": _never_trusted,
    **{text: _unguarded(plant) for text, plant in LOCKS.items()},
    "a fault of the drive does not lock": _unguarded(wrapped(Interlock, "step", _fault_ignored)),
    "a silent drive counts as online": _unguarded(wrapped(Interlock, "step", _never_lost)),
    "Quick Stop is sent as Shutdown": _QUICK_STOP_COASTS,
}
"""The defects by what they break."""


def search(text: str, seed: int, axes: int = 2) -> Found:
    """Run the soak with one defect until it is found."""
    calm = CALM.get(text)
    day = parts(seed, 1, [calm], draw_calm) if calm else parts(seed, axes)
    with Patch.context() as patch:
        DEFECTS[text](patch)
        for part in takewhile(lambda part: part.begin < LIMIT_NS, day):
            soak_run = CalmRun(part) if calm else SoakRun(part)
            try:
                soak_run.run_to(min(part.end, LIMIT_NS))
            except ViolationError as violation:
                return Found(soak_run.loop.now(), str(violation))
            finally:
                soak_run.close()
    return Found(None, "")
