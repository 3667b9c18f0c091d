"""Defects planted in the gateway, to measure the time in which the soak finds each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any, Final
from unittest.mock import patch

from pdgw.ds301.node.client import NodeClient
from pdgw.dsp402.drive import tpdo_check
from pdgw.dsp402.states import STATE_OF_STATUS, State
from pdgw.durations import SECOND
from pdgw.gateway.axis import interlock
from pdgw.gateway.axis.adapters.base import ControlWordAdapter
from pdgw.gateway.axis.adapters.speed import SpeedAdapter
from pdgw.gateway.axis.demand_report import STATE_MASK, Flag, PowerWish
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.power_states import Action, Drive, Phase
from pdgw.gateway.axis.power_table import CELLS
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.axis.supervision.drive_events import NodeWatch
from pdgw.gateway.axis.supervision.enable_guard import EnableGuard
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.new_frames import Verdict
from pdgw.profidrive.frame import IOPS_GOOD
from tests.long.soak.calm import CalmRun, draw_calm
from tests.long.soak.plan import parts
from tests.long.soak.soak_run import SoakRun
from tests.long.soak.watch import ViolationError

LIMIT_NS: Final = 7200 * SECOND
"""Virtual time in which the soak must find each defect."""
_SHUTDOWN: Final = 0x06
_RUNNING: Final = (Phase.FOLLOW, Phase.PASS)
Plant = Callable[[], AbstractContextManager[object]]


@dataclass(frozen=True, slots=True)
class Defect:
    """``plant`` breaks the gateway while its context is active."""

    text: str
    plant: Plant
    calm: int = 0
    """Telegram of the calm day that finds it; 0: the soak finds it."""


@dataclass(frozen=True, slots=True)
class Found:
    """``time_ns``: virtual time until the soak found the defect; None: not within the limit."""

    name: str
    time_ns: int | None
    message: str


def _replaced(place: object, name: str, value: object) -> Plant:
    return lambda: patch.object(place, name, value)


def _wrapped(place: type, name: str, around: Callable[..., Any]) -> Plant:
    """Replace a method by ``around``, which gets the original method and the arguments."""
    method = getattr(place, name)

    def replacement(*arguments: Any, **named: Any) -> Any:
        return around(method, *arguments, **named)

    return lambda: patch.object(place, name, replacement)


def _step(change: Callable[[Interlock, Phase, PowerWish | None, int], None]) -> Plant:
    """Call ``change`` after each step with interlock, phase before, wish and Statusword."""

    def step(method: Any, self: Interlock, wish: PowerWish | None, *arguments: Any) -> None:
        before = self.phase
        method(self, wish, *arguments)
        change(self, before, wish, arguments[2])

    return _wrapped(Interlock, "step", step)


def _kept(because: Callable[[PowerWish | None, int], bool]) -> Plant:
    """The axis stays in operation where it must be locked."""

    def change(self: Interlock, before: Phase, wish: PowerWish | None, statusword: int) -> None:
        if before in _RUNNING and self.phase not in _RUNNING and because(wish, statusword):
            self.phase = before

    return _step(change)


def _off_forgotten(method: Any, self: Interlock, *arguments: Any) -> None:
    if self.phase is Phase.LOCKED:
        self.phase = Phase.FOLLOW
    method(self, *arguments)


def _off3_not_latched(self: Interlock, before: Phase, wish: PowerWish | None, statusword: int) -> None:
    if before is Phase.QUICK_STOP and self.phase is Phase.LOCKED and wish is not None:
        self.phase = Phase.FOLLOW


def _never_lost(method: Any, self: Interlock, wish: Any, acknowledge: bool, condition: Any, *arguments: Any) -> None:
    method(self, wish, acknowledge, None if condition is Drive.LOST else condition, *arguments)


def _never_again(method: Any, self: Any) -> None:
    if self.generation:
        self.loop.sleep(3600 * SECOND)
    method(self)


def _speed_doubled(method: Any, self: SpeedAdapter, setpoints: Any, demand: Any) -> None:
    method(self, setpoints, demand)
    demand.speed *= 2


def _stop_accepted(method: Any, *arguments: Any) -> Verdict:
    verdict: Verdict = method(*arguments)
    return Verdict.ACCEPTED if verdict is Verdict.PROVIDER_STOP else verdict


def _iops_ignored(method: Any, self: CyclicEndpoint, data: bytes) -> Any:
    good = bytearray(data)
    for _, _, iops, _ in self._axes:
        good[iops] |= IOPS_GOOD
    return method(self, bytes(good))


def _unguarded(plant: Plant) -> Plant:
    """Remove the final guard as well, because it would stop what this defect starts."""

    @contextmanager
    def planted() -> Iterator[None]:
        with plant(), patch.object(EnableGuard, "step", lambda self, wish, controlword: True):
            yield

    return planted


@contextmanager
def _never_trusted() -> Iterator[None]:
    """An object that was sent with every motion is compared again, and the first difference counts."""
    with (
        patch.object(tpdo_check.Place, "confirmed", property(lambda self: False)),
        patch.object(tpdo_check, "CONTRADICTIONS", 1),
    ):
        yield


_QUICK_STOP_COASTS: Final = tuple(
    replace(cell, controlword=_SHUTDOWN) if cell.action is Action.QUICK_STOP else cell for cell in CELLS
)

DEFECTS: Final[Mapping[str, Defect]] = {
    "plc-loss-forgotten": Defect(
        "setpoints stay in force after a loss of the PLC",
        _replaced(CyclicEndpoint, "lose_setpoints", lambda self: None),
    ),
    "off-forgotten": Defect(
        "an ON without an OFF before it starts the drive", _unguarded(_wrapped(Interlock, "step", _off_forgotten))
    ),
    "loss-without-stop": Defect(
        "a lost PLC does not stop the drive",
        _replaced(interlock, "_NO_PLC", dict.fromkeys(PlcLossReaction, PowerWish.ENABLE)),
    ),
    "drive-never-again": Defect(
        "a lost drive is not brought up again", _wrapped(NodeClient, "_bring_up", _never_again)
    ),
    "off2-not-latched": Defect("OFF2 does not lock", _unguarded(_kept(lambda wish, _: wish is PowerWish.COAST))),
    "off3-not-latched": Defect("OFF3 does not lock", _unguarded(_step(_off3_not_latched))),
    "fault-not-locking": Defect(
        "a fault of the drive does not lock",
        _unguarded(
            _kept(
                lambda _, statusword: (
                    STATE_OF_STATUS[statusword & STATE_MASK] in {State.FAULT, State.FAULT_REACTION_ACTIVE}
                )
            )
        ),
    ),
    "lost-drive-followed": Defect(
        "a silent drive counts as online", _unguarded(_wrapped(Interlock, "step", _never_lost))
    ),
    "emcy-lost": Defect(
        "an EMCY is not in the fault buffer", _replaced(NodeWatch, "_emergency", lambda self, notice: None)
    ),
    "speed-doubled": Defect("the drive gets twice the speed", _wrapped(SpeedAdapter, "read", _speed_doubled)),
    "reached-always": Defect(
        "ZSW1.10 is always 1",
        _wrapped(ControlWordAdapter, "status", lambda method, self, flags: method(self, flags | Flag.REACHED)),
    ),
    "provider-stop-ignored": Defect(
        "the drive follows a PLC in STOP", _wrapped(CyclicEndpoint, "_check", _stop_accepted)
    ),
    "iops-ignored": Defect(
        "the drive follows setpoints with IOPS BAD", _wrapped(CyclicEndpoint, "_decode", _iops_ignored)
    ),
    "stale-statusword": Defect(
        "a Statusword older than the command counts as new",
        _unguarded(_replaced(interlock, "_LEAVING", Drive.OPERATING)),
    ),
    "quick-stop-coasts": Defect("Quick Stop is sent as Shutdown", _replaced(interlock, "CELLS", _QUICK_STOP_COASTS)),
    "value-never-trusted": Defect("a TPDO that shows every motion counts as not sent", _never_trusted, calm=111),
}
"""The defects by name."""


def search(name: str, seed: int, axes: int = 2, limit_ns: int = LIMIT_NS) -> Found:
    """Run the soak with one defect until it is found."""
    calm = DEFECTS[name].calm
    day = parts(seed, 1, [calm], draw_calm) if calm else parts(seed, axes)
    with DEFECTS[name].plant():
        for part in takewhile(lambda part: part.begin < limit_ns, day):
            soak_run = CalmRun(part) if calm else SoakRun(part)
            try:
                soak_run.play(min(part.end, limit_ns))
            except ViolationError as violation:
                return Found(name, soak_run.loop.now(), str(violation))
            finally:
                soak_run.close()
    return Found(name, None, "")
