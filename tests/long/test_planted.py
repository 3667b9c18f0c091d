"""Defects planted in the gateway: the walk finds each of them, and prints after how many steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest

from pdgw.dsp402.states import State
from pdgw.gateway.axis.demand_report import OFFS, PowerWish
from pdgw.gateway.axis.executors.positions.handshake import ACKNOWLEDGE_NS, Handshake
from pdgw.gateway.axis.executors.speed import SpeedExecutor
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.orders import Order
from pdgw.gateway.axis.power_states import Action, Drive, Phase
from pdgw.gateway.axis.power_table import (
    ENABLES,
    IN_OPERATION,
    RAMPS,
    RUNNING,
    SHOWS_OPERATION,
)
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.axis.supervision.stop_supervision import StopWatch
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.basic_positioner import BasicPositioner
from pdgw.gateway.motion.function_orders import Jogs
from pdgw.gateway.motion.mdi import MdiPositioner
from pdgw.gateway.motion.positioner import ACTIVATE, HOME
from pdgw.gateway.motion.requests import Motion, PositionerRequest
from pdgw.gateway.motion.states import Event
from pdgw.profidrive.sign_of_life import SignOfLife
from tests.long.planted import FOLLOW, LOCKS, Patch, Plant, each_cell, replaced, row, wrapped
from tests.long.rules import Rule
from tests.long.walk.cases import LONG_TICK_NS, Case
from tests.long.walk.values import Plc, Shown

UNPOWERED_STATES = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)


@dataclass(frozen=True, slots=True)
class Narrow(Case):
    """Only the inputs that the way to a defect needs. A walk with all inputs has this way, too, but takes a minute."""

    also: tuple[str, ...] = ()
    """Further frames and reports, by the beginning of their names."""

    def _frames(self) -> list[Plc]:
        motion = ("homing", "jog") if self.homing or self.jog else ("task",)
        kept = (*(f"{name} 0" for name in ("OFF1", "OFF1 ack", "ON+enable", *motion)), *self.also)
        return [item for item in Case._frames(self) if item.name.startswith(kept)]

    def _shown(self) -> list[Shown]:
        kept = (*(state.value for state in UNPOWERED_STATES), "Operation Enabled", *self.also)
        return [item for item in Case._shown(self) if item.name.startswith(kept)]


def speed_does_not_fall_in_a_stop(method: Any, self: SpeedExecutor) -> Reason | None:
    reason: Reason | None = method(self)
    self.command.target_velocity = self._value
    return reason


def standing_task_bit_starts(method: Any, self: MdiPositioner, request: PositionerRequest, now: int) -> Any:
    self._commands &= ~ACTIVATE
    return method(self, request, now)


def brake_ends_with_the_drive(
    method: Any, self: StopWatch, order: Order, state: State | None, seen: bool, *rest: Any, **more: bool
) -> Any:
    if not seen:
        self.over()
    return method(self, order, state, seen, *rest, **more)


def standing_homing_bit_starts(method: Any, self: MdiPositioner) -> Any:
    self._commands &= ~HOME
    return method(self)


def standing_homing_bit_of_a_positioner_starts(method: Any, self: BasicPositioner) -> Any:
    return {**method(self), Event.HOMING: lambda: HOME & self.request.commands}


def homing_continues_without_its_bit(patch: Patch) -> None:
    replaced(MdiPositioner, "_homes", lambda _: True)(patch)
    wrapped(MdiPositioner, "_events", lambda method, self: method(self) | {Event.HOMING_WITHDRAWN: lambda: False})(
        patch
    )


def setpoint_is_repeated(self: Handshake, motion: Motion, given: int) -> bool:
    overdue = self._inputs.now - self.raised_at >= ACKNOWLEDGE_NS
    if overdue:
        self._seen.given = 0
    return overdue


DEFAULT = Narrow(1)
STOPS = Narrow(1, also=("OFF2", "OFF3"))
RAMP = Narrow(1, PlcLossReaction.RAMP, also=("ON 0", "no PLC", "OFF3 without"))
GUARDING = Narrow(1, guarding=True, also=("OFF3", "lost"))

PLANTED: dict[str, tuple[Case, Plant]] = {
    **{text: (STOPS, plant) for text, plant in LOCKS.items()},
    "fault not locking": (
        Narrow(1, also=("Fault",)),
        row(FOLLOW, (Drive.FAULT,), tuple(PowerWish), None, Action.SHUTDOWN),
    ),
    "lost drive followed": (
        Narrow(1, also=("lost",)),
        row(FOLLOW, (Drive.LOST,), ENABLES, None, Action.ENABLE_OPERATION),
    ),
    "late supply starts the drive": (DEFAULT, row(FOLLOW, (Drive.INHIBITED,), ENABLES, None, Action.SWITCH_ON)),
    "quick stop sent as Shutdown": (
        STOPS,
        row(tuple(Phase), SHOWS_OPERATION, (PowerWish.QUICK_STOP,), Phase.QUICK_STOP, Action.SHUTDOWN),
    ),
    "stale Statusword trusted": (
        DEFAULT,
        row(FOLLOW, (Drive.LEAVING,), OFFS, Phase.RAMP_STOP, Action.RAMP),
    ),
    "ramp with power after Disable Operation": (
        RAMP,
        row(FOLLOW, (Drive.LEAVING,), RAMPS, Phase.RAMP_STOP, Action.RAMP),
    ),
    "resume without OFF": (
        RAMP,
        row((Phase.RAMP_STOP,), IN_OPERATION, (PowerWish.ENABLE,), Phase.FOLLOW, Action.ENABLE_OPERATION),
    ),
    "loss of the PLC ignored": (
        Narrow(1, also=("no PLC",)),
        row(RUNNING, IN_OPERATION, (PowerWish.NO_PLC_QUICK_STOP,), None, Action.ENABLE_OPERATION),
    ),
    "restart forgotten": (
        Narrow(1, also=("restarted",)),
        replaced(Interlock, "restarted", lambda _: None),
    ),
    "speed does not fall in a stop": (DEFAULT, wrapped(SpeedExecutor, "step", speed_does_not_fall_in_a_stop)),
    "operation shown in a stop": (DEFAULT, each_cell(lambda cell: replace(cell, operating=True))),
    "OFF2 and OFF3 after a loss ignored": (
        RAMP,
        replaced(AxisMachine, "_stop_without_plc", lambda _: None),
    ),
    "loss of the sign of life ignored": (
        Narrow(2, life=1),
        replaced(SignOfLife, "failed", False),
    ),
    "drive that does not stop left alone": (GUARDING, replaced(StopWatch, "step", lambda *_, **__: None)),
    "brake released when the drive is lost": (GUARDING, wrapped(StopWatch, "step", brake_ends_with_the_drive)),
    "standing task bit starts": (Narrow(9), wrapped(MdiPositioner, "step", standing_task_bit_starts)),
    "standing homing bit starts": (
        Narrow(9, homing=True, tick_ns=LONG_TICK_NS),
        wrapped(MdiPositioner, "_take_homing", standing_homing_bit_starts),
    ),
    "homing continues without its bit": (
        Narrow(9, homing=True, tick_ns=LONG_TICK_NS),
        homing_continues_without_its_bit,
    ),
    "standing homing bit of a positioner starts": (
        Narrow(110, homing=True, tick_ns=LONG_TICK_NS),
        wrapped(BasicPositioner, "_events", standing_homing_bit_of_a_positioner_starts),
    ),
    "standing jog bit starts": (
        Narrow(110, jog=True, tick_ns=LONG_TICK_NS),
        replaced(Jogs, "wait", lambda self, commands: self.alone(commands) > 0),
    ),
    "jog goes on without its bit": (
        Narrow(110, jog=True, tick_ns=LONG_TICK_NS),
        wrapped(BasicPositioner, "_events", lambda method, self: method(self) | {Event.JOG_RELEASED: lambda: False}),
    ),
    "handshake waits without a reason": (
        Narrow(9, tick_ns=LONG_TICK_NS),
        replaced(Handshake, "_await", lambda _: None),
    ),
    "setpoint is repeated": (
        Narrow(7, tick_ns=LONG_TICK_NS),
        replaced(Handshake, "is_replaced", setpoint_is_repeated),
    ),
    "refusal without reason": (DEFAULT, each_cell(lambda cell: replace(cell, reason=None))),
}


@pytest.mark.planted
@pytest.mark.parametrize("name", PLANTED)
def test_the_walk_finds_a_planted_defect(name: str, monkeypatch: Patch) -> None:
    case, plant = PLANTED[name]
    plant(monkeypatch)
    result = case.run(until=list(Rule))
    assert result.violations
    rules = ", ".join(rule.name for rule in result.violations)
    print(f"{name}: {rules} after {result.transitions} steps")
