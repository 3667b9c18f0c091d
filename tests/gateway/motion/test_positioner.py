"""The positioner's functions one by one, as an engineer asks for them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.blocks import Block, BlockMode, BlockNext
from pdgw.gateway.motion.requests import FULL, Command, Seen
from pdgw.gateway.motion.states import TASK_STATES, TRANSITIONS, Event, State
from pdgw.gateway.motion.travel import LIMIT_STANDING_NS
from tests.support.axis.positioner import ABSOLUTE, CYCLE, RELATIVE, SETTINGS, PositionerRig, changed, move

# -- the table ----------------------------------------------------------------------------------------------------------


def test_every_state_is_left_when_operation_ends() -> None:
    for state, rows in TRANSITIONS.items():
        if state is not State.OFF:
            assert (rows[0].event, rows[0].target) == (Event.NOT_OPERATING, State.OFF)


def test_every_function_is_ended_by_a_reject_before_anything_else() -> None:
    for state in set(State) - {State.OFF, State.BRAKING}:
        row = TRANSITIONS[state][1]
        assert row.event is Event.REJECTED
        assert row.target is (state if state in {State.IDLE, State.TRACKING} else State.BRAKING)


def test_only_an_edge_replaces_a_function_that_runs() -> None:
    starts = {Event.JOG, Event.JOG_INCREMENTAL, Event.HOMING, Event.TRACKING}
    for state in set(State) - {State.IDLE}:
        assert not starts & {row.event for row in TRANSITIONS[state]}


def test_edges_of_tasks_are_taken_where_the_table_has_rows_for_them() -> None:
    assert {State.IDLE, State.MDI, State.SETTING_UP, State.BLOCK, State.BRAKING} == TASK_STATES


# -- MDI ----------------------------------------------------------------------------------------------------------------


def test_an_absolute_task_is_acknowledged_moves_and_is_reached() -> None:
    rig = PositionerRig(delay=3)
    move(rig, target=8000, **ABSOLUTE)
    assert (rig.result.acknowledged, rig.result.reached) == (False, False)
    while not rig.result.acknowledged:
        rig.step()
        assert not rig.result.reached, "the old one's reached is never that of the new task"
    rig.run_out()
    assert (rig.position, rig.result.reached, rig.result.acknowledged) == (8000, True, True)
    assert (rig.result.state, rig.result.shown) == (State.IDLE, State.MDI)
    rig.step(activate=False)
    assert (rig.result.reached, rig.result.acknowledged, rig.result.shown) == (True, False, State.IDLE)


def test_a_task_of_the_same_target_is_acknowledged_and_reached_too() -> None:
    rig = PositionerRig()
    for _ in range(2):
        move(rig, target=0, **ABSOLUTE)
        rig.run_out()
        assert rig.result.acknowledged
        assert rig.result.reached


def test_a_relative_task_goes_its_distance_once_over_stops_and_overrides() -> None:
    rig = PositionerRig(delay=2)
    move(rig, target=8000, **RELATIVE)
    for changes in ({"override": 0x1000}, {"no_intermediate_stop": False}, {"override": 0}, {"override": FULL}):
        rig.step(1, **changes)
        rig.step(20)
    rig.step(no_intermediate_stop=True)
    rig.run_out()
    assert rig.position == 8000
    assert len([motion for motion in rig.starts if motion.goal.distance is not None]) == 1


def test_a_second_edge_replaces_the_task_with_its_own_data() -> None:
    rig = PositionerRig()
    move(rig, target=8000, **ABSOLUTE)
    rig.step(30)
    move(rig, target=-500, **ABSOLUTE)
    rig.run_out()
    assert rig.position == -500
    assert [motion.goal.target for motion in rig.starts] == [8000, -500]


def test_an_edge_in_the_frame_that_ends_the_reject_starts() -> None:
    rig = PositionerRig()
    rig.step(5, do_not_reject=False, no_intermediate_stop=False)
    rig.step(do_not_reject=True, no_intermediate_stop=True, activate=True, target=700, **ABSOLUTE)
    rig.run_out()
    assert rig.position == 700


def test_a_task_that_came_while_the_axis_brakes_starts_at_standstill() -> None:
    rig = PositionerRig()
    move(rig, target=20_000, **ABSOLUTE)
    rig.step(60)
    rig.step(do_not_reject=False)
    rig.step(do_not_reject=True, activate=False)
    assert rig.result.state is State.BRAKING
    rig.step(activate=True, target=100)
    assert rig.result.state is State.BRAKING
    rig.run_out()
    assert rig.position == 100


def test_a_reject_removes_a_task_that_waits_for_standstill() -> None:
    rig = PositionerRig()
    move(rig, target=20_000, **ABSOLUTE)
    rig.step(60)
    rig.step(do_not_reject=False)
    rig.step(do_not_reject=True, activate=False)
    rig.step(activate=True, target=100)
    rig.step(do_not_reject=False)
    rig.step(do_not_reject=True)
    rig.run_out()
    assert len(rig.starts) == 1


def test_an_edge_while_stw1_5_is_0_and_nothing_is_kept_starts_nothing_later() -> None:
    rig = PositionerRig()
    rig.step(no_intermediate_stop=False)
    move(rig, target=700, **ABSOLUTE)
    rig.step(no_intermediate_stop=True)
    rig.run_out()
    assert rig.starts == []


def test_a_new_edge_during_an_intermediate_stop_replaces_the_kept_task() -> None:
    rig = PositionerRig()
    move(rig, target=8000, **ABSOLUTE)
    rig.step(20, no_intermediate_stop=False)
    move(rig, target=-300)
    rig.step(100)
    assert (rig.speed, rig.result.reason) == (0, Reason.INTERMEDIATE_STOP)
    rig.step(no_intermediate_stop=True)
    rig.run_out()
    assert rig.position == -300


def test_override_scales_the_speed_and_0_stops_with_the_task_kept() -> None:
    rig = PositionerRig()
    move(rig, target=40_000, **ABSOLUTE)
    rig.step(60)
    full = rig.speed
    rig.step(60, override=FULL // 2)
    assert rig.speed == full // 2
    rig.step(60, override=0)
    assert (rig.speed, rig.result.reason, rig.result.reached) == (0, Reason.OVERRIDE_ZERO, False)
    rig.step(override=FULL)
    rig.run_out()
    assert rig.position == 40_000


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({**ABSOLUTE, "velocity": 0, "target": 5}, Reason.TASK_SPEED_ZERO),
        ({**ABSOLUTE, "acceleration": 0, "target": 5}, Reason.TASK_RAMP_ZERO),
        ({**ABSOLUTE, "deceleration": -1, "target": 5}, Reason.TASK_RAMP_ZERO),
        ({**ABSOLUTE, "target": (1 << 30) + 1}, Reason.TASK_DRIVE_RANGE),
        ({"mdi": False, "block": 77}, Reason.TASK_BLOCK_UNKNOWN),
        ({**ABSOLUTE, "setting_up": True}, Reason.TASK_DIRECTION),
        ({**ABSOLUTE, "setting_up": True, "positive": True, "negative": True}, Reason.TASK_DIRECTION),
    ],
)
@pytest.mark.parametrize("moving", [False, True])
def test_a_task_that_cannot_be_done_moves_nothing_and_says_why_until_the_reject(
    values: dict[str, object], reason: Reason, moving: bool
) -> None:
    rig = PositionerRig()
    if moving:
        move(rig, target=30_000, **ABSOLUTE)
        rig.step(50)
    move(rig, **values)
    rig.run_out()
    assert (rig.result.warning, rig.result.reason, rig.result.acknowledged) == (reason, reason, False)
    assert len(rig.starts) == moving
    rig.step(do_not_reject=False)
    assert rig.result.warning is None


def test_continuous_update_takes_changes_without_an_edge_also_at_standstill() -> None:
    rig = PositionerRig()
    move(rig, target=3000, continuous_update=True, **ABSOLUTE)
    rig.step(20, target=9000)
    assert rig.result.acknowledged
    rig.run_out()
    assert (rig.position, rig.result.acknowledged, rig.result.reached) == (9000, True, True)
    rig.step(target=-1000)
    rig.run_out()
    assert (rig.position, rig.result.acknowledged) == (-1000, True)
    rig.step(3, activate=False)
    rig.step(target=5000)
    rig.run_out()
    assert rig.position == -1000, "a falling STW1.6 ends the update"


def test_continuous_update_with_unchanged_values_gives_nothing_new() -> None:
    rig = PositionerRig()
    move(rig, target=3000, continuous_update=True, **ABSOLUTE)
    rig.step(500)
    assert len(rig.starts) == 1


def test_continuous_update_of_a_relative_task_is_refused_and_changes_nothing() -> None:
    rig = PositionerRig()
    move(rig, target=3000, continuous_update=True, **RELATIVE)
    rig.step(5, target=4000)
    assert rig.result.warning is Reason.UPDATE_RELATIVE
    rig.run_out()
    assert rig.position == 3000


def test_falling_stw1_6_stops_nothing() -> None:
    rig = PositionerRig()
    move(rig, target=3000, continuous_update=True, **ABSOLUTE)
    rig.step(5)
    rig.step(activate=False)
    rig.run_out()
    assert rig.position == 3000


# -- setting up and jog ---------------------------------------------------------------------------------------------------


def test_setting_up_runs_until_the_reject() -> None:
    rig = PositionerRig()
    move(rig, mdi=True, setting_up=True, negative=True, velocity=3000)
    rig.step(100)
    assert rig.speed == -200
    assert (rig.result.state, rig.result.shown, rig.result.reached) == (State.SETTING_UP, State.SETTING_UP, False)
    assert rig.result.acknowledged
    rig.step(do_not_reject=False)
    assert rig.result.shown is State.IDLE
    assert not rig.result.reached
    rig.run_out()
    assert rig.result.reached


def test_setting_up_is_held_by_an_intermediate_stop_and_changes_direction_by_update() -> None:
    rig = PositionerRig()
    move(rig, mdi=True, setting_up=True, positive=True, velocity=3000, continuous_update=True)
    rig.step(50)
    rig.step(50, no_intermediate_stop=False)
    assert rig.speed == 0
    rig.step(50, no_intermediate_stop=True)
    assert rig.speed > 0
    rig.step(60, positive=False, negative=True)
    assert rig.speed < 0
    rig.step(60, positive=True, negative=True)
    assert (rig.speed, rig.result.warning) == (0, Reason.TASK_DIRECTION)


def test_a_block_does_not_replace_setting_up() -> None:
    rig = PositionerRig(blocks=(Block(1, 100, 100),))
    move(rig, mdi=True, setting_up=True, positive=True, velocity=3000)
    rig.step(10)
    move(rig, mdi=False, number=1)
    assert (rig.result.state, rig.result.warning) == (State.SETTING_UP, Reason.FUNCTION_RUNS)


@pytest.mark.parametrize(("bit", "sign"), [("jog_1", -1), ("jog_2", 1)])
def test_jog_moves_while_its_bit_is_set_whatever_the_override(bit: str, sign: int) -> None:
    rig = PositionerRig()
    rig.step(60, override=0, **{bit: True})
    assert rig.speed == sign * 200
    assert (rig.result.state, rig.result.reached) == (State.JOG, False)
    rig.step(**{bit: False})
    assert rig.result.state is State.BRAKING
    rig.run_out()
    assert rig.result.reached


def test_both_jog_bits_ramp_down_and_the_one_left_does_not_move() -> None:
    rig = PositionerRig()
    rig.step(60, jog_1=True)
    rig.step(60, jog_2=True)
    assert rig.speed == 0
    rig.step(60, jog_1=False)
    assert rig.speed == 0, "released one button: the other one does not start to move"
    rig.step(jog_2=False)
    rig.step(60, jog_2=True)
    assert rig.speed > 0


@pytest.mark.parametrize(
    ("lacking", "given", "why"),
    [
        ({"jog_1": True, "jog_2": True}, {"jog_1": False}, "both were 1"),
        ({"jog_2": True, "do_not_reject": False}, {"do_not_reject": True}, "STW1.4 = 0 at its edge or after it"),
        ({"jog_2": True, "operating": False}, {"operating": True}, "it was 1 before operation"),
    ],
)
def test_a_jog_that_starts_nothing_keeps_the_cause_of_its_edge(
    lacking: dict[str, bool], given: dict[str, bool], why: str
) -> None:
    rig = PositionerRig()
    rig.step(3, **lacking)
    rig.step(60, **given)
    assert (rig.speed, rig.result.reason) == (0, Reason.LOST_JOG)
    assert rig.positioner.lack(Command.JOG_2_ON).text == why


@pytest.mark.parametrize("function", ["MDI position", "setting up", "traversing block", "homing", "tracking"])
@pytest.mark.parametrize("incremental", [False, True])
def test_a_jog_edge_during_another_function_is_refused_and_not_kept(function: str, incremental: bool) -> None:
    rig = PositionerRig(blocks=(Block(3, 9000, 3000),), delay=8)
    begin: dict[str, dict[str, object]] = {
        "MDI position": {"target": 9000, "activate": True, **ABSOLUTE},
        "setting up": {"mdi": True, "setting_up": True, "positive": True, "velocity": 3000, "activate": True},
        "traversing block": {"number": 3, "activate": True},
        "homing": {"homing": True},
        "tracking": {"tracking": True},
    }
    rig.step(2, jog_incremental=incremental, **begin[function])
    assert rig.result.state.value == function
    rig.step(2, jog_2=True)
    assert rig.result.reason is Reason.FUNCTION_RUNS
    rig.step(5, activate=False, homing=False, tracking=False, do_not_reject=function != "setting up")
    rig.step(do_not_reject=True)
    rig.run_out()
    position = rig.position
    rig.step(200)
    assert (rig.position, rig.result.reason) == (position, Reason.LOST_JOG)
    assert rig.positioner.lack(Command.JOG_2_ON).text == f"{function} was active at its edge"
    rig.step(2, jog_2=False)
    rig.step(60, jog_2=True)
    assert rig.position > position, "an edge of its own moves the axis"


def test_jog_changes_over_through_standstill() -> None:
    rig = PositionerRig()
    rig.step(60, jog_1=True)
    rig.step(jog_1=False, jog_2=True)
    assert rig.result.state is State.BRAKING
    rig.step(100)
    assert rig.speed == 200


@pytest.mark.parametrize(("bit", "distance"), [("jog_1", -500), ("jog_2", 2000)])
def test_incremental_jog_goes_its_distance_once_for_each_edge(bit: str, distance: int) -> None:
    rig = PositionerRig()
    for count in (1, 2):
        rig.step(jog_incremental=True, **{bit: True})
        rig.step(300)
        assert (rig.position, rig.result.state) == (count * distance, State.IDLE)
        rig.step(3, **{bit: False})
    assert [motion.goal.distance for motion in rig.starts] == [distance] * 2


def test_incremental_jog_whose_bit_is_removed_ramps_down() -> None:
    rig = PositionerRig()
    rig.step(10, jog_incremental=True, jog_2=True)
    rig.step(jog_2=False)
    rig.run_out()
    assert 0 < rig.position < 2000


@pytest.mark.parametrize(
    ("before", "edge", "why"),
    [
        ({"do_not_reject": False}, {"activate": True}, "STW1.4 = 0 at its edge or after it"),
        ({"no_intermediate_stop": False}, {"activate": True}, "STW1.5 = 0 at its edge or after it"),
        (
            {"do_not_reject": False, "no_intermediate_stop": False},
            {"activate": True},
            "STW1.4 = STW1.5 = 0 at its edge or after it",
        ),
        ({"jog_2": True}, {"activate": True}, "jog was active at its edge"),
        ({"activate": True}, {"do_not_reject": False}, "STW1.4 = 0 at its edge or after it"),
    ],
)
def test_an_edge_that_starts_nothing_keeps_what_it_lacked(
    before: dict[str, bool], edge: dict[str, bool], why: str
) -> None:
    rig = PositionerRig()
    rig.step(3, target=50_000, activate=False, **ABSOLUTE)
    rig.step(3, **before)
    rig.step(3, **edge)
    rig.step(do_not_reject=True, no_intermediate_stop=True, jog_2=False, homing=False)
    rig.run_out()
    assert rig.result.reason is Reason.LOST_EDGE
    assert rig.positioner.lack(Command.ACTIVATE_TASK).text == why


def test_jog_and_tasks_do_not_replace_each_other() -> None:
    rig = PositionerRig()
    rig.step(20, jog_2=True)
    move(rig, target=100, **ABSOLUTE)
    assert (rig.result.state, rig.result.warning) == (State.JOG, Reason.FUNCTION_RUNS)
    rig.step(jog_2=False)
    rig.run_out()
    assert rig.position != 100, "the edge is not kept"
    move(rig, target=30_000, **ABSOLUTE)
    rig.step(20, jog_1=True)
    assert rig.result.state is State.MDI


@pytest.mark.parametrize("standstill", [True, False])
def test_a_reference_point_is_set_by_its_edge_while_the_axis_is_off_and_at_standstill(standstill: bool) -> None:
    rig = PositionerRig()
    rig.step(20, jog_2=True)
    rig.step(100, operating=False, jog_2=False)
    rig.show(Seen.ASKED, True)
    rig.show(Seen.STANDSTILL, standstill)
    rig.positioner.step(rig.request, rig.now)
    rig.positioner.step(changed(rig.request, set_reference_point=True), rig.now)
    assert rig.positioner.home_set is standstill
    assert (rig.positioner.course.warning is Reason.REFERENCE_POINT_MOVING) is not standstill
    assert (rig.positioner.position == 0) is standstill


@pytest.mark.parametrize("first", [True, False])
def test_a_reference_bit_of_the_first_frame_is_not_an_edge(first: bool) -> None:
    rig = PositionerRig()
    rig.step(3, operating=False)
    rig.show(Seen.ASKED, True)
    rig.step(operating=False, set_reference_point=first)
    rig.step(3, operating=False, set_reference_point=True)
    assert rig.result.home_set is not first
    rig.step(3, operating=True)
    assert rig.result.home_set is not first


def test_a_refused_reference_point_is_named_until_its_bit_falls() -> None:
    rig = PositionerRig()
    rig.step(operating=False)
    rig.show(Seen.ASKED, True)
    rig.step(operating=False)
    rig.show(Seen.STANDSTILL, False)
    rig.positioner.step(changed(rig.request, set_reference_point=True), rig.now)
    rig.step(3, operating=True, set_reference_point=True)
    assert rig.result.reason is Reason.REFERENCE_POINT_MOVING
    rig.step(operating=False)
    rig.step(3, operating=True, set_reference_point=False)
    assert rig.result.reason is None


# -- limits ---------------------------------------------------------------------------------------------------------------


def test_a_target_beyond_a_software_limit_is_the_limit() -> None:
    rig = PositionerRig()
    rig.home()
    move(rig, target=80_000, **ABSOLUTE)
    rig.run_out()
    assert (rig.position, rig.result.at_plus, rig.result.warning) == (50_000, True, Reason.SOFTWARE_LIMIT)
    move(rig, target=0)
    rig.run_out()
    assert (rig.position, rig.result.at_plus) == (0, False)


def test_a_target_beyond_the_drives_range_is_the_software_limit_too() -> None:
    rig = PositionerRig()
    rig.home()
    move(rig, target=1 << 31, **ABSOLUTE)
    rig.run_out()
    assert rig.position == 50_000


@pytest.mark.parametrize("function", ["jog", "setting up", "endless block"])
def test_a_function_with_a_speed_ends_at_the_software_limit_and_moves_back(function: str) -> None:
    rig = PositionerRig(blocks=tuple(Block(n, 0, 3000, mode=mode) for n, mode in enumerate(list(BlockMode)[2:])))

    def go(forward: bool) -> None:
        rig.step(3, activate=False, jog_1=False, jog_2=False, do_not_reject=False)
        rig.step(10, do_not_reject=True)
        if function == "jog":
            rig.step(jog_2=forward, jog_1=not forward)
        elif function == "setting up":
            rig.step(activate=True, mdi=True, setting_up=True, velocity=3000, positive=forward, negative=not forward)
        else:
            rig.step(activate=True, mdi=False, number=0 if forward else 1)

    rig.home()
    go(True)
    rig.step(600)
    assert (rig.position, rig.result.at_plus) == (50_000, True)
    assert rig.result.reason is Reason.AT_SOFTWARE_LIMIT
    go(True)
    rig.step(50)
    assert rig.position == 50_000
    assert rig.result.reason is Reason.SOFTWARE_LIMIT
    go(False)
    rig.step(600)
    assert (rig.position, rig.result.at_minus) == (-50_000, True)


def test_an_axis_beyond_a_software_limit_moves_only_back() -> None:
    rig = PositionerRig()
    rig.home()
    rig.step(400, software_limits=False, jog_2=True)
    rig.step(60, jog_2=False)
    beyond = rig.position
    assert beyond > 50_000
    rig.step(200, software_limits=True, jog_2=True)
    assert (rig.position, rig.result.warning) == (beyond, Reason.SOFTWARE_LIMIT)
    rig.step(jog_2=False)
    rig.step(60, jog_1=True)
    assert rig.position < beyond


NARROW = replace(SETTINGS, software_limits=(-5000, 5000))


@pytest.mark.parametrize("values", [ABSOLUTE, RELATIVE], ids=["absolute", "relative"])
def test_a_software_limit_that_becomes_active_replaces_the_target_of_a_running_task(values: dict[str, object]) -> None:
    rig = PositionerRig(NARROW)
    rig.home()
    rig.step(software_limits=False)
    move(rig, target=9000, **values)
    rig.step(10)
    rig.step(software_limits=True)
    assert rig.run_out().warning is Reason.SOFTWARE_LIMIT
    assert (rig.position, rig.result.at_plus) == (5000, True)


def test_a_relative_task_that_begins_after_the_braking_of_another_ends_at_the_software_limit() -> None:
    rig = PositionerRig(replace(SETTINGS, software_limits=(-20_000, 20_000)))
    rig.home()
    move(rig, target=15_000, **ABSOLUTE)
    rig.step(60)
    rig.step(no_intermediate_stop=False)
    rig.step(activate=False)
    move(rig, target=8200, **RELATIVE)
    assert rig.position + 8200 < 20_000
    rig.step(100)
    assert rig.position + 8200 > 20_000, "it has braked"
    rig.step(no_intermediate_stop=True)
    assert rig.run_out().warning is Reason.SOFTWARE_LIMIT
    assert rig.position == 20_000


def test_a_task_that_is_beyond_a_software_limit_when_it_becomes_active_stops() -> None:
    rig = PositionerRig(NARROW)
    rig.home()
    rig.step(software_limits=False)
    move(rig, target=20_000, **ABSOLUTE)
    rig.step(60)
    beyond = rig.position
    assert beyond > 5000
    rig.step(software_limits=True)
    assert rig.run_out().warning is Reason.SOFTWARE_LIMIT
    assert beyond < rig.position < 20_000
    assert not rig.result.motion.goal.target, "not back to the limit"


def test_a_software_limit_that_becomes_active_also_counts_for_a_waiting_setpoint() -> None:
    rig = PositionerRig(NARROW, (Block(1, 4000, 3000, next=BlockNext.FLYING), Block(2, 9000, 3000)))
    rig.home()
    rig.step(software_limits=False)
    move(rig, number=1)
    rig.step(10)
    assert rig.waiting is not None
    rig.step(software_limits=True)
    rig.run_out()
    assert rig.position == 5000


@pytest.mark.parametrize("function", [ABSOLUTE, {"mdi": True, "setting_up": True, "positive": True, "velocity": 3000}])
def test_a_running_function_stops_at_the_software_limit_of_a_new_reference_point(function: dict[str, object]) -> None:
    rig = PositionerRig(replace(NARROW, reference_coordinate=4000))
    rig.home()
    move(rig, target=-4000, **ABSOLUTE)
    rig.run_out()
    move(rig, **{"target": 4900, **function})
    rig.step(10, homing=True, passive_homing=True)
    rig.positioner.latch(rig.seen.position)
    rig.step()
    rig.positioner.latch(None)
    rig.run_out()
    assert rig.position == 5000


def test_a_task_stopped_by_a_limit_switch_does_not_continue_on_its_release() -> None:
    rig = PositionerRig(stop_at=1000)
    move(rig, target=5000, **ABSOLUTE)
    rig.step(60)
    rig.show(Seen.INTERNAL_LIMIT, True)
    rig.step(LIMIT_STANDING_NS // CYCLE + 2)
    assert rig.result.reason is Reason.TASK_AT_LIMIT
    rig.show(Seen.INTERNAL_LIMIT, False)
    rig.stop_at = None
    rig.step(50)
    assert rig.position == 1000
    rig.step(3, no_intermediate_stop=False)
    rig.step(no_intermediate_stop=True)
    rig.run_out()
    assert rig.position == 5000


def test_limit_switches_show_only_when_they_are_watched() -> None:
    rig = PositionerRig()
    rig.show(Seen.NEGATIVE_LIMIT, True)
    assert not rig.step().negative_limit
    assert rig.step(hardware_limits=True).negative_limit


# -- what ends it all -------------------------------------------------------------------------------------------------------


def test_nothing_continues_when_operation_returns_and_set_bits_are_not_edges() -> None:
    rig = PositionerRig(blocks=(Block(1, 0, 300, mode=BlockMode.ENDLESS_POSITIVE),))
    move(rig, target=30_000, continuous_update=True, **ABSOLUTE)
    rig.step(60, jog_1=True, homing=True)
    rig.step(operating=False)
    assert (rig.result.state, rig.result.acknowledged) == (State.OFF, False)
    rig.step(60)
    rig.step(operating=True)
    stands = rig.position
    rig.step(100, target=1)
    assert (rig.position, rig.result.state) == (stands, State.IDLE)


def test_reason_of_a_refused_task_ends_when_operation_begins_again() -> None:
    rig = PositionerRig()
    rig.step(**{**ABSOLUTE, "velocity": 0, "activate": True})
    assert rig.result.reason is Reason.TASK_SPEED_ZERO
    rig.step(operating=False)
    rig.step(3, operating=True)
    assert rig.result.reason is Reason.EARLY_EDGE


@pytest.mark.parametrize(
    ("bit", "reason"),
    [("activate", Reason.EARLY_EDGE), ("homing", Reason.LOST_HOMING), ("jog_1", Reason.LOST_JOG)],
)
def test_bit_that_was_1_before_operation_is_named_until_it_falls(bit: str, reason: Reason) -> None:
    rig = PositionerRig()
    rig.step(operating=False)
    rig.step(operating=False, **{bit: True})
    rig.step(3, operating=True)
    assert rig.result.reason is reason
    rig.step(2, **{bit: False})
    assert rig.result.reason is None


@pytest.mark.parametrize("bit", ["do_not_reject", "no_intermediate_stop"])
def test_edge_that_came_while_a_bit_was_0_is_named_until_the_next_edge(bit: str) -> None:
    rig = PositionerRig()
    rig.step(**ABSOLUTE, **{bit: False})
    rig.step(2, activate=True)
    rig.step(3, **{bit: True})
    assert (rig.result.state, rig.result.reason) == (State.IDLE, Reason.LOST_EDGE)
    rig.step(2, activate=False)
    assert rig.result.reason is Reason.LOST_EDGE, "also after a pulse"
    rig.step(activate=True)
    assert (rig.result.state, rig.result.reason) == (State.MDI, None)


def test_an_ended_task_is_not_a_lost_edge_and_a_rejected_one_is() -> None:
    rig = PositionerRig()
    move(rig, target=1_000, **ABSOLUTE)
    rig.step(2000)
    assert (rig.result.state, rig.result.reason) == (State.IDLE, None)
    rig.step(activate=False)
    move(rig, target=30_000, **ABSOLUTE)
    rig.step(do_not_reject=False)
    rig.step(2000)
    rig.step(do_not_reject=True)
    assert (rig.result.state, rig.result.reason) == (State.IDLE, Reason.LOST_EDGE)


def test_homing_whose_edge_came_during_a_reject_is_named_until_it_is_withdrawn() -> None:
    rig = PositionerRig()
    rig.step(do_not_reject=False)
    rig.step(2, homing=True)
    rig.step(3, do_not_reject=True)
    assert (rig.result.state, rig.result.reason) == (State.IDLE, Reason.LOST_HOMING)
    rig.step(2, homing=False)
    assert rig.result.reason is None
