"""Traversing blocks of the positioner and chains of them, its homing and its reference point."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.blocks import Block, BlockMode, BlockNext, BlockTable, BlockTask
from pdgw.gateway.motion.requests import MotionKind
from pdgw.gateway.motion.states import State
from tests.support.axis.positioner import ABSOLUTE, CYCLE, SETTINGS, PositionerRig, move

# -- tables -------------------------------------------------------------------------------------------------------


CONTINUE = BlockNext.CONTINUE_WITH_STOP


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"number": 128, "velocity": 1}, r"block 128: number = 128 is not allowed, expected 0\.\.127"),
        ({"number": 1}, r"block 1: velocity = 0 is not allowed, expected 1"),
        ({"number": 1, "velocity": 1, "acceleration": 101}, "acceleration = 101"),
        ({"number": 1, "velocity": 1, "position": 1 << 31}, "position = 2147483648"),
        ({"number": 1, "velocity": 1, "value": 3}, "value = 3 is not allowed, expected 0$"),
        ({"number": 1, "task": BlockTask.WAIT, "value": -1}, "value = -1"),
        ({"number": 1, "task": BlockTask.SET_OUTPUT, "value": 4}, r"value = 4 is not allowed, expected 1\.\.3"),
        ({"number": 1, "task": BlockTask.WAIT, "next": BlockNext.FLYING}, "next = flying"),
        (
            {"number": 1, "velocity": 1, "mode": BlockMode.ENDLESS_POSITIVE, "next": CONTINUE},
            "next = continue-with-stop",
        ),
        (
            {"number": 1, "velocity": 1, "task": BlockTask.FIXED_STOP, "value": 9, "next": BlockNext.FLYING},
            "fixed-stop",
        ),
    ],
)
def test_a_block_is_refused_with_number_key_value_and_what_is_allowed(values: dict[str, object], message: str) -> None:
    with pytest.raises(GatewayError, match=message):
        Block(**values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        ([Block(1, 0, 1), Block(1, 5, 1)], "block 1: defined twice"),
        ([Block(1, 0, 1, next=CONTINUE)], "block 1: continues with block 2, which is missing"),
        ([Block(1, task=BlockTask.GOTO, value=7)], "block 1: continues with block 7, which is missing"),
        ([Block(1, task=BlockTask.GOTO, value=1)], "block 1: the chain is a loop"),
        (
            [Block(1, task=BlockTask.SET_OUTPUT, value=1, next=CONTINUE), Block(2, task=BlockTask.GOTO, value=1)],
            "block 1: the chain is a loop",
        ),
        (
            [Block(1, task=BlockTask.WAIT, next=CONTINUE), Block(2, task=BlockTask.GOTO, value=1)],
            "block 1: the chain is a loop",
        ),
    ],
)
def test_a_table_that_cannot_be_run_is_refused(blocks: list[Block], message: str) -> None:
    with pytest.raises(GatewayError, match=message):
        BlockTable(blocks)


def test_a_ring_that_moves_or_waits_is_allowed() -> None:
    assert len(BlockTable([Block(1, 0, 1, next=CONTINUE), Block(2, task=BlockTask.GOTO, value=1)])) == 2
    BlockTable([Block(1, task=BlockTask.WAIT, value=10, next=CONTINUE), Block(2, task=BlockTask.GOTO, value=1)])


# -- chains -------------------------------------------------------------------------------------------------------


def chain(*blocks: Block, **settings: object) -> PositionerRig:
    rig = PositionerRig(replace(SETTINGS, **settings), blocks)  # type: ignore[arg-type]
    rig.step(activate=True, mdi=False, number=blocks[0].number)
    return rig


def test_a_chain_runs_to_its_end_with_stops_waits_and_outputs() -> None:
    rig = chain(
        Block(1, 1000, 3000, next=BlockNext.CONTINUE_WITH_STOP),
        Block(2, task=BlockTask.SET_OUTPUT, value=0b10, next=BlockNext.CONTINUE_WITH_STOP),
        Block(3, task=BlockTask.WAIT, value=200, next=BlockNext.CONTINUE_WITH_STOP),
        Block(4, task=BlockTask.GOTO, value=9),
        Block(9, -400, 3000, mode=BlockMode.RELATIVE),
    )
    numbers = [rig.result.block]
    waited = 0
    while rig.result.state is State.BLOCK:
        rig.step()
        waited += rig.result.block == 3
        assert not (rig.result.block == 3 and rig.speed)
        if rig.result.block != numbers[-1]:
            numbers.append(rig.result.block)
    assert numbers == [1, 3, 9, 0]
    assert waited == 200_000_000 // CYCLE
    assert (rig.position, rig.result.outputs, rig.result.reached) == (600, 0b10, True)


def test_a_flying_block_continues_without_a_stop() -> None:
    rig = chain(Block(1, 2000, 3000, next=BlockNext.FLYING), Block(2, 3000, 3000))
    stops = 0
    while rig.result.state is State.BLOCK:
        before = rig.result.block
        rig.step()
        stops += before == 1 and rig.result.block == 2
    assert [motion.serial in rig.queued for motion in rig.starts] == [False, True]
    assert stops == 1
    assert rig.position == 3000


def test_a_flying_block_without_waiting_set_points_stops_and_warns() -> None:
    rig = chain(Block(1, 2000, 3000, next=BlockNext.FLYING), Block(2, 3000, 3000), waiting_setpoints=False)
    rig.step(20)
    assert rig.result.warning is Reason.FLYING_NOT_SUPPORTED
    rig.run_out()
    assert rig.position == 3000
    assert not rig.queued


def test_an_intermediate_stop_in_a_flying_chain_loses_and_doubles_nothing() -> None:
    rig = chain(
        Block(1, 2000, 3000, next=BlockNext.FLYING),
        Block(2, 500, 3000, mode=BlockMode.RELATIVE, next=BlockNext.FLYING),
        Block(3, 500, 3000, mode=BlockMode.RELATIVE),
    )
    for _ in range(12):
        rig.step(7)
        rig.step(25, no_intermediate_stop=False)
        assert rig.speed == 0
        rig.step(no_intermediate_stop=True)
    rig.run_out()
    assert (rig.position, rig.result.state) == (3000, State.IDLE)


def test_an_external_edge_starts_the_next_block_in_motion_or_at_standstill() -> None:
    rig = chain(
        Block(1, 0, 3000, mode=BlockMode.ENDLESS_POSITIVE, next=BlockNext.EXTERNAL),
        Block(2, 0, 3000, next=BlockNext.EXTERNAL),
        Block(3, 77, 3000),
    )
    rig.step(100)
    assert rig.result.block == 1
    rig.step(external_block_change=True)
    assert rig.result.block == 2
    rig.step(300)
    assert (rig.position, rig.result.block) == (0, 2), "one edge, one block"
    rig.step(external_block_change=False)
    rig.step(external_block_change=True)
    rig.run_out()
    assert rig.position == 77


def test_an_endless_block_runs_until_it_is_replaced() -> None:
    rig = chain(Block(1, 0, 3000, mode=BlockMode.ENDLESS_NEGATIVE), Block(2, 50, 3000))
    rig.step(100)
    assert rig.result.motion.kind is MotionKind.SPEED
    assert rig.speed == -200
    move(rig, number=2)
    rig.run_out()
    assert (rig.position, rig.result.shown, rig.result.state) == (50, State.BLOCK, State.IDLE)


def test_a_block_in_the_middle_of_a_chain_that_cannot_be_done_ends_it() -> None:
    rig = chain(
        Block(1, 100, 3000, next=BlockNext.CONTINUE_WITH_STOP),
        Block(2, (1 << 30) + 5, 3000, next=BlockNext.CONTINUE_WITH_STOP),
        Block(3, 900, 3000),
    )
    rig.run_out()
    assert (rig.position, rig.result.warning, rig.result.state) == (100, Reason.TASK_DRIVE_RANGE, State.IDLE)


def test_a_fixed_stop_presses_with_its_torque_until_the_reject() -> None:
    rig = PositionerRig(blocks=(Block(1, 5000, 3000, task=BlockTask.FIXED_STOP, value=250),), stop_at=1500)
    rig.step(activate=True, mdi=False, number=1)
    assert (rig.result.motion.torque, rig.result.to_fixed_stop) == (250, True)
    rig.step(100)
    assert (rig.result.fixed_stop, rig.result.state) == (True, State.BLOCK)
    rig.step(200)
    assert rig.result.motion.kind is MotionKind.POSITION
    rig.step(2, do_not_reject=False)
    assert (rig.result.motion.torque, rig.result.fixed_stop, rig.result.to_fixed_stop) == (None, False, False)


def test_a_fixed_stop_that_is_not_there_ends_the_chain_with_a_warning() -> None:
    rig = chain(
        Block(1, 500, 3000, task=BlockTask.FIXED_STOP, value=250, next=BlockNext.CONTINUE_WITH_STOP),
        Block(2, 900, 3000),
    )
    rig.run_out()
    assert (rig.position, rig.result.warning, rig.result.state) == (500, Reason.FIXED_STOP_MISSED, State.IDLE)


def test_stw2_8_moves_an_mdi_task_to_a_fixed_stop() -> None:
    rig = PositionerRig(stop_at=1000)
    move(rig, target=5000, to_fixed_stop=True, **ABSOLUTE)
    assert rig.result.motion.torque == SETTINGS.clamping_torque
    rig.step(100)
    assert rig.result.fixed_stop


# -- homing and reference point -----------------------------------------------------------------------------------


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


def test_a_withdrawn_homing_leaves_no_home_position() -> None:
    rig = PositionerRig(delay=5)
    rig.home()
    rig.step(2, homing=True)
    rig.step(homing=False)
    assert rig.result.state is State.BRAKING
    rig.run_out()
    assert not rig.result.home_set


def test_a_reference_point_is_set_at_standstill_without_motion() -> None:
    rig = PositionerRig(replace(SETTINGS, reference_coordinate=-70))
    move(rig, target=500, **ABSOLUTE)
    rig.run_out()
    rig.step(set_reference_point=True)
    assert (rig.position, rig.result.home_set, rig.result.homing) == (-70, True, True)
    move(rig, target=0)
    rig.run_out()
    assert (rig.position, rig.seen.position) == (0, 570)
    move(rig, target=9000)
    rig.step(20, set_reference_point=False)
    rig.step(set_reference_point=True)
    assert rig.result.warning is Reason.REFERENCE_POINT_MOVING
    rig.step(set_reference_point=False)
    rig.run_out()
    assert rig.result.warning is Reason.REFERENCE_POINT_MOVING, "withdrawn, not carried out"
    rig.step(set_reference_point=True)
    assert (rig.position, rig.result.warning) == (-70, None)


def test_passive_homing_takes_the_probe_during_a_task_that_keeps_its_way() -> None:
    rig = PositionerRig()
    move(rig, target=5000, **ABSOLUTE)
    rig.step(3, homing=True, passive_homing=True)
    assert (rig.result.probe, rig.result.state) == (True, State.MDI)
    rig.positioner.latch(300)
    rig.step()
    assert (rig.result.home_set, rig.result.probe) == (True, False)
    rig.run_out()
    assert (rig.seen.position, rig.position, rig.result.reached) == (5000, 4700, True)


def test_passive_homing_needs_a_probe() -> None:
    rig = PositionerRig()
    rig.step(homing=True, passive_homing=True)
    rig.positioner.latch(Reason.PASSIVE_HOMING_NOT_SUPPORTED)
    rig.step()
    assert (rig.result.warning, rig.result.probe) == (Reason.PASSIVE_HOMING_NOT_SUPPORTED, False)


def test_passive_homing_ends_with_operation_and_needs_another_edge_then() -> None:
    rig = PositionerRig()
    rig.step(operating=False)
    rig.step(2, operating=True, homing=True, passive_homing=True)
    assert rig.positioner.armed
    rig.step(operating=False)
    rig.positioner.latch(300)
    rig.step(5, operating=True)
    assert (rig.positioner.armed, rig.result.probe, rig.result.home_set) == (False,) * 3, "STW1.11 has stayed 1"
    rig.positioner.latch(None)
    rig.step(homing=False)
    rig.step(homing=True)
    assert rig.positioner.armed


def test_tracking_needs_no_task() -> None:
    rig = PositionerRig()
    rig.step(2, tracking=True)
    assert rig.result.state is State.TRACKING
    move(rig, target=900, **ABSOLUTE)
    assert rig.result.warning is Reason.FUNCTION_RUNS
    rig.step(2, tracking=False, activate=False)
    assert rig.result.state is State.IDLE
