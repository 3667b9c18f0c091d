"""The positioner's homing and its reference point."""

from __future__ import annotations

from dataclasses import replace

from pdgw.gateway.motion.requests import MotionKind
from pdgw.gateway.motion.states import State
from pdgw.gateway.reasons import Reason
from tests.support.axis.positioner import ABSOLUTE, CYCLE, SETTINGS, PositionerRig, move


def test_homing_sets_the_reference_coordinate_and_is_shown_100_ms() -> None:
    rig = PositionerRig(replace(SETTINGS, reference_coordinate=1234))
    rig.step(homing=True)
    assert (rig.result.state, rig.result.homing, rig.result.home_set) == (State.HOMING, True, False)
    assert rig.result.motion.kind is MotionKind.HOMING
    rig.step(5)
    assert (rig.result.state, rig.result.home_set, rig.position) == (State.IDLE, True, 1234)
    assert rig.result.homing
    rig.step(100_000_000 // CYCLE)
    assert not rig.result.homing
    assert rig.result.state is State.IDLE, "a standing STW1.11 homes once"


def test_homing_that_is_taken_back_leaves_no_home_position() -> None:
    rig = PositionerRig(delay=5)
    rig.home()
    rig.step(2, homing=True)
    rig.step(homing=False)
    assert rig.result.state is State.BRAKING
    rig.settle()
    assert not rig.result.home_set


def test_a_reference_point_is_set_at_standstill_without_motion() -> None:
    rig = PositionerRig(replace(SETTINGS, reference_coordinate=-70))
    move(rig, target=500, **ABSOLUTE)
    rig.settle()
    rig.step(set_reference_point=True)
    assert (rig.position, rig.result.home_set, rig.result.homing) == (-70, True, True)
    move(rig, target=0)
    rig.settle()
    assert (rig.position, rig.seen.position) == (0, 570)
    move(rig, target=9000)
    rig.step(20, set_reference_point=False)
    rig.step(set_reference_point=True)
    assert rig.result.warning is Reason.REFERENCE_POINT_MOVING


def test_passive_homing_takes_the_probe_during_a_task_that_keeps_its_way() -> None:
    rig = PositionerRig()
    move(rig, target=5000, **ABSOLUTE)
    rig.step(3, homing=True, passive_homing=True)
    assert (rig.result.probe, rig.result.state) == (True, State.MDI)
    rig.seen.probe = 300
    rig.step()
    assert (rig.result.home_set, rig.result.probe) == (True, False)
    rig.settle()
    assert (rig.seen.position, rig.position, rig.result.reached) == (5000, 4700, True)


def test_passive_homing_needs_a_probe() -> None:
    rig = PositionerRig()
    rig.step(homing=True, passive_homing=True)
    rig.seen.probe_refused = True
    rig.step()
    assert (rig.result.warning, rig.result.probe) == (Reason.PASSIVE_HOMING_NOT_SUPPORTED, False)


def test_tracking_needs_no_task() -> None:
    rig = PositionerRig()
    rig.step(2, tracking=True)
    assert rig.result.state is State.TRACKING
    move(rig, target=900, **ABSOLUTE)
    assert rig.result.warning is Reason.FUNCTION_RUNS
    rig.step(2, tracking=False, activate=False)
    assert rig.result.state is State.IDLE
