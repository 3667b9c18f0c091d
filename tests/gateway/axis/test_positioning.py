"""Telegram 9 on the simulated drive: hand-shakes, sub-states, homing, stops, by the rows of docs/translation.md."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import pytest

from pdgw.dsp402.drive_type import Quantity, Reference
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, State
from pdgw.gateway.axis.executors.positions.limits import TaskScaling
from pdgw.gateway.base.reasons import Reason
from pdgw.peers.drive import Machine
from pdgw.peers.drive.objects import HOMING_METHODS, TURNTABLE
from pdgw.profidrive.datatypes import N4_100_PERCENT
from pdgw.profidrive.signals import signal
from tests.support.axis.hand import ON
from tests.support.axis.rig import Rig
from tests.support.axis.tasks import (
    ACKNOWLEDGED,
    ACTIVATE,
    HOME_SET,
    HOMING,
    INTERMEDIATE,
    POSITION,
    REACHED,
    REJECT,
    WARNING,
    ZSW1,
)
from tests.support.drives.drive_types import engel

STOPPED = ZSW1.bit("DRIVE_STOPPED", positioning=True).mask
MDI_ACTIVE = signal("AKTSATZ").bit("MDI_ACTIVE").mask
SMALL = Machine(negative_limit=-20_000, positive_limit=20_000, negative_stop=-30_000, positive_stop=30_000)


def axis(machine: Machine | None = None, **settings: object) -> Rig:
    rig = Rig(9, machine, **settings)
    rig.values |= {"SATZANW": 0x8000, "MDI_VELOCITY": 1 << 30, "MDI_ACC": 1 << 14, "MDI_DEC": 1 << 14, "MDI_MOD": 1}
    rig.enable()
    return rig


def task(rig: Rig, target: int, *, relative: bool = False, hold: int = 4) -> None:
    """An edge of STW1.6 with its data, held for some cycles."""
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(target), "MDI_MOD": 0 if relative else 1, "STW1": ON | ACTIVATE}
    rig.step(hold)
    rig.values["STW1"] = ON
    rig.step(1)


def position(rig: Rig) -> int:
    return rig.node.model.position_actual


def reached(actuals: dict[str, int]) -> bool:
    return bool(actuals["ZSW1"] & REACHED)


def test_published_example_tarpos_429496_goes_to_position_200() -> None:
    rig = axis()
    rig.values |= {"MDI_TARPOS": 429_496, "STW1": ON | ACTIVATE}
    rig.step(2)
    assert rig.stepper.command.target_position == 200


def test_absolute_and_relative_tasks_end_at_their_targets() -> None:
    rig = axis()
    task(rig, 30_000)
    assert not rig.actuals["ZSW1"] & REACHED
    rig.until(reached)
    assert position(rig) == 30_000
    task(rig, -10_000, relative=True)
    rig.until(reached)
    assert position(rig) == 20_000


def test_handshake_cw4_stays_until_stw1_6_falls_and_zsw1_12_follows() -> None:
    rig = axis()
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(200_000), "STW1": ON | ACTIVATE}
    rig.until(lambda actuals: bool(actuals["ZSW1"] & ACKNOWLEDGED), 5)
    rig.step(20)
    assert rig.actuals["ZSW1"] & ACKNOWLEDGED
    assert rig.stepper.command.controlword & ControlBit.NEW_SETPOINT
    rig.values["STW1"] = ON
    rig.step(1)
    assert not rig.stepper.command.controlword & ControlBit.NEW_SETPOINT
    rig.step(1)
    assert not rig.actuals["ZSW1"] & ACKNOWLEDGED


def test_edge_during_the_handshake_is_latched_with_its_own_data() -> None:
    rig = axis()
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(200_000), "STW1": ON | ACTIVATE}
    rig.step(1)
    rig.values["STW1"] = ON
    rig.step(1)
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(-5_000), "STW1": ON | ACTIVATE}
    rig.step(1)
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(77_777), "STW1": ON}
    rig.until(reached)
    rig.until(reached)
    assert position(rig) == -5_000
    rises = sum(
        not a & ControlBit.NEW_SETPOINT and bool(b & ControlBit.NEW_SETPOINT) for a, b in pairwise(rig.controlwords)
    )
    assert rises == 2, "each edge once"


def test_constant_activate_bit_starts_only_one_task() -> None:
    rig = axis()
    task(rig, 5_000, hold=400)
    assert reached(rig.actuals)
    rig.values["MDI_TARPOS"] = POSITION.to_wire(9_000)
    rig.step(100)
    assert position(rig) == 5_000


def test_second_task_on_the_fly_replaces_the_first_at_once() -> None:
    rig = axis()
    task(rig, 200_000)
    rig.step(50)
    task(rig, -20_000)
    rig.until(reached)
    assert position(rig) == -20_000


@pytest.mark.parametrize("satzanw", [0x0000, 0x7FFF])
def test_without_mdi_no_task_starts(satzanw: int) -> None:
    rig = axis()
    rig.values["SATZANW"] = satzanw
    task(rig, 5_000)
    rig.step(50)
    assert position(rig) == 0
    assert rig.stepper.reason is Reason.MDI_OFF
    assert not rig.actuals["AKTSATZ"] & MDI_ACTIVE


@pytest.mark.parametrize("missing", [REJECT, INTERMEDIATE])
def test_an_edge_with_bit_4_or_5_missing_starts_nothing(missing: int) -> None:
    rig = axis()
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(5_000), "STW1": (ON | ACTIVATE) & ~missing}
    rig.step(20)
    rig.values["STW1"] = ON | ACTIVATE
    rig.step(50)
    assert position(rig) == 0


def test_reject_brakes_with_halt_drops_the_task_and_does_not_restart() -> None:
    rig = axis()
    task(rig, 200_000)
    rig.step(50)
    rig.values["STW1"] = ON & ~REJECT
    rig.step(1)
    assert rig.stepper.command.controlword & ControlBit.HALT
    assert rig.stepper.reason is Reason.REJECTED
    rig.until(reached)
    stopped_at = position(rig)
    rig.values["STW1"] = ON
    rig.step(200)
    assert position(rig) == stopped_at
    assert not rig.stepper.command.controlword & ControlBit.HALT
    assert rig.actuals["ZSW1"] & STOPPED
    task(rig, 1_000)
    rig.until(reached)
    assert position(rig) == 1_000


@pytest.mark.parametrize("pending", [False, True])
def test_task_rejected_before_its_acceptance_never_starts(pending: bool) -> None:
    rig = axis()
    task(rig, 200_000)
    rig.step(60)
    assert rig.feedback.velocity_actual > 0
    if pending:
        task(rig, -5_000, hold=1)
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(-70_000), "STW1": ON | ACTIVATE}
    rig.step(1)
    rig.values["STW1"] = ON & ~REJECT
    rig.step(1)
    rig.values["STW1"] = ON
    rig.until(lambda actuals: bool(actuals["ZSW1"] & STOPPED))
    stood = position(rig)
    rig.step(200)
    assert position(rig) == stood
    assert not rig.stepper.command.controlword & (ControlBit.NEW_SETPOINT | ControlBit.HALT)


@pytest.mark.parametrize("withheld", [0, INTERMEDIATE], ids=["running", "interrupted"])
def test_homing_in_the_frame_of_a_reject_does_not_start(withheld: int) -> None:
    rig = axis()
    task(rig, 200_000)
    rig.step(60)
    rig.values["STW1"] = ON & ~withheld
    rig.step(200 if withheld else 1)
    rig.values |= {"SATZANW": 0x8000 | 35, "STW1": ON & ~(REJECT | withheld) | HOMING}
    rig.step(200)
    rig.values["STW1"] = ON | HOMING
    rig.step(200)
    assert not rig.actuals["ZSW1"] & HOME_SET
    assert rig.stepper.command.modes_of_operation == Mode.POSITION
    assert rig.stepper.reason is Reason.LOST_HOMING


@pytest.mark.parametrize("relative", [False, True])
def test_intermediate_stop_keeps_the_task_and_resumes_to_its_target(relative: bool) -> None:
    rig = axis()
    task(rig, 10_000)
    rig.until(reached)
    task(rig, 100_000, relative=relative)
    rig.step(40)
    rig.values["STW1"] = ON & ~INTERMEDIATE
    rig.step(1)
    assert not rig.actuals["ZSW1"] & STOPPED
    rig.until(lambda actuals: bool(actuals["ZSW1"] & STOPPED))
    rig.step(50)
    assert not rig.actuals["ZSW1"] & REACHED
    between = position(rig)
    assert 10_000 < between < 90_000
    del rig.controlwords[:-1]
    rig.values["STW1"] = ON
    rig.until(reached)
    assert position(rig) == (110_000 if relative else 100_000)
    for before, after in pairwise(rig.controlwords):
        halt_falls = before & ControlBit.HALT and not after & ControlBit.HALT
        rises = not before & ControlBit.NEW_SETPOINT and after & ControlBit.NEW_SETPOINT
        assert not (halt_falls and rises), "Halt cleared and bit 4 set in one Controlword"


def test_off1_while_traversing_ramps_down_by_halt() -> None:
    rig = axis()
    task(rig, 200_000)
    rig.step(50)
    rig.values["STW1"] = 0x043E
    rig.step(1)
    assert rig.stepper.command.controlword & (ControlBit.HALT | 0x0F) == ControlBit.HALT | 0x0F
    assert rig.actuals["ZSW1"] & 0x4F == 0x03
    rig.until(lambda _: rig.state is State.READY_TO_SWITCH_ON)
    stopped_at = position(rig)
    rig.enable()
    rig.step(100)
    assert position(rig) == stopped_at, "the task is dropped by OFF"


def home(rig: Rig, method: int) -> None:
    rig.values |= {"SATZANW": 0x8000 | method & 0xFF, "STW1": ON | HOMING}
    rig.step(3)


@pytest.mark.parametrize("method", sorted(HOMING_METHODS))
def test_homing_with_every_method_of_the_guide(method: int) -> None:
    rig = axis(SMALL)
    home(rig, method)
    if method != 35:
        assert not rig.actuals["ZSW1"] & (REACHED | HOME_SET | ACKNOWLEDGED)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET))
    assert rig.actuals["ZSW1"] & (REACHED | STOPPED | ACKNOWLEDGED) == REACHED | STOPPED
    assert rig.actuals["AKTSATZ"] & 0xFF == method & 0xFF
    rig.values["STW1"] = ON
    rig.step(4)
    assert rig.feedback.modes_of_operation_display == Mode.POSITION
    assert rig.actuals["ZSW1"] & HOME_SET
    offset = 3_000 if method in {1, 17, -17, 35} else -3_000
    task(rig, offset)
    rig.until(reached)
    assert position(rig) == offset


def test_homing_speed_comes_from_mdi_velocity_in_velocity_units() -> None:
    rig = axis(SMALL)
    rig.values["MDI_VELOCITY"] = 1 << 29
    home(rig, 17)
    assert rig.node.read(0x6099, 1) == rig.node.read(0x6099, 2) == 3000


def test_reject_stops_a_homing_which_does_not_begin_again_with_stw1_4() -> None:
    rig = axis(SMALL)
    home(rig, 17)
    rig.step(20)
    assert rig.feedback.velocity_actual
    rig.values["STW1"] = ON & ~REJECT | HOMING
    rig.step(1)
    assert rig.stepper.command.controlword & (ControlBit.HALT | ControlBit.NEW_SETPOINT) == ControlBit.HALT
    assert rig.stepper.reason is Reason.REJECTED
    rig.until(lambda _: rig.feedback.modes_of_operation_display == Mode.POSITION)
    rig.values["STW1"] = ON | HOMING
    stood = position(rig)
    rig.step(200)
    assert position(rig) == stood
    assert not rig.actuals["ZSW1"] & HOME_SET
    rig.values["STW1"] = ON
    rig.step(2)
    home(rig, 17)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET))


def test_reject_after_the_end_of_a_homing_keeps_the_home_position() -> None:
    rig = axis(SMALL)
    home(rig, 35)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET))
    rig.values["STW1"] = ON & ~REJECT | HOMING
    rig.until(lambda _: rig.feedback.modes_of_operation_display == Mode.POSITION)
    rig.step(5)
    assert rig.actuals["ZSW1"] & (HOME_SET | REACHED) == HOME_SET | REACHED
    assert not rig.stepper.command.controlword & ControlBit.HALT


@pytest.mark.parametrize("moves", [False, True])
def test_a_homing_begins_neither_with_stw1_4_at_0_nor_after_it_while_the_axis_brakes(moves: bool) -> None:
    rig = axis(SMALL)
    if moves:
        task(rig, 10_000)
        rig.step(20)
        home(rig, 17)
        rig.step(1)
    rig.values |= {"SATZANW": 0x8000 | 17, "STW1": ON & ~REJECT | HOMING}
    rig.step(2)
    assert moves or rig.stepper.reason is Reason.REJECTED
    rig.step(200)
    rig.values["STW1"] = ON | HOMING
    rig.step(200)
    assert rig.stepper.command.modes_of_operation == Mode.POSITION
    rig.values["STW1"] = ON
    rig.step(2)
    home(rig, 17)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET))
    assert rig.stepper.reason is None


@pytest.mark.parametrize("method", [0, 3, 34, -1, 127])
def test_an_unsupported_homing_method_starts_nothing_and_warns(method: int) -> None:
    rig = axis(SMALL)
    home(rig, method)
    rig.step(20)
    assert rig.actuals["ZSW1"] & WARNING
    assert rig.stepper.reason is Reason.HOMING_METHOD
    assert rig.stepper.numbers == [108]
    assert rig.feedback.modes_of_operation_display == Mode.POSITION
    rig.values["STW1"] = ON
    rig.step(2)
    assert not rig.actuals["ZSW1"] & WARNING


def test_a_homing_error_warns_and_leaves_the_home_position_unset() -> None:
    rig = axis(Machine(negative_limit=None, positive_limit=None, negative_stop=-9_000, positive_stop=9_000))
    home(rig, 17)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & WARNING))
    assert rig.stepper.numbers == [109]
    assert not rig.actuals["ZSW1"] & HOME_SET


def test_homing_clears_the_home_position_at_its_start() -> None:
    rig = axis(SMALL)
    home(rig, 35)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET))
    rig.values["STW1"] = ON
    rig.step(4)
    home(rig, 17)
    assert not rig.actuals["ZSW1"] & HOME_SET


def test_an_edge_in_the_cycle_that_ends_homing_is_not_lost() -> None:
    rig = axis(SMALL)
    home(rig, 35)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET))
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(4_000), "MDI_MOD": 1, "STW1": ON | ACTIVATE}
    rig.step(1)
    rig.values["STW1"] = ON
    rig.until(lambda _: position(rig) == 4_000)


def test_the_mode_is_never_changed_while_halt_is_set() -> None:
    rig = axis(SMALL)
    task(rig, 15_000)
    rig.step(10)
    home(rig, 17)
    seen: list[tuple[bool, int]] = []
    for _ in range(600):
        rig.step()
        command = rig.stepper.command
        seen.append((bool(command.controlword & ControlBit.HALT), command.modes_of_operation))
    for (_, before), (halt, after) in pairwise(seen):
        assert not (halt and before != after)
    assert seen[-1][1] == Mode.HOMING


@pytest.mark.parametrize(
    ("mod", "expected"),
    [(0b001, 96), (0b011, 4096 - 4000 + 0), (0b101, -4000)],
    ids=["shortest", "positive", "negative"],
)
def test_modulo_axis_directions(mod: int, expected: int) -> None:
    rig = axis(modulo_axis=True)
    assert rig.feedback.modes_of_operation_display == TURNTABLE.mode
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(4_000), "MDI_MOD": 0b011, "STW1": ON | ACTIVATE}
    rig.step(4)
    rig.values["STW1"] = ON
    rig.until(reached)
    start = position(rig)
    assert start == 4_000
    rig.values |= {"MDI_TARPOS": 0, "MDI_MOD": mod, "STW1": ON | ACTIVATE}
    rig.step(4)
    rig.values["STW1"] = ON
    rig.until(reached)
    assert position(rig) - start == expected


def test_excessive_values_saturate_and_are_counted() -> None:
    rig = axis()
    rig.values |= {"MDI_VELOCITY": (1 << 31) - 1, "MDI_ACC": 32767, "MDI_DEC": 1}
    task(rig, 1_000)
    command = rig.stepper.command
    assert (command.profile_velocity, command.profile_acceleration, command.profile_deceleration) == (6000, 1000, 1)
    assert rig.stepper.saturations == 3


def test_target_outside_the_position_range_is_limited_to_it() -> None:
    rig = axis()
    rig.values |= {"MDI_TARPOS": (1 << 31) - 1, "STW1": ON | ACTIVATE}
    rig.step(2)
    assert rig.stepper.command.target_position == 500_000
    assert rig.stepper.saturations == 1


def test_loss_of_the_plc_while_traversing_stops_the_axis_and_drops_the_task() -> None:
    rig = axis()
    task(rig, 300_000)
    rig.step(50)
    rig.step(100, plc=False)
    assert rig.node.model.velocity_actual == 0
    assert rig.state is State.SWITCH_ON_DISABLED
    stopped_at = position(rig)
    rig.values["STW1"] = ON | ACTIVATE
    rig.step(50)
    assert position(rig) == stopped_at
    rig.enable()
    rig.step(50)
    assert position(rig) == stopped_at


# -- limit switches ----------------------------------------------------------------------------------------------------


LIMITED = Machine(positive_limit=20_000)


def at_limit() -> Rig:
    """A task to 60 000 that the limit switch at 20 000 has stopped, and the switch released since."""
    rig = axis(LIMITED)
    task(rig, 60_000)
    rig.until(lambda _: rig.stepper.reason is Reason.TASK_AT_LIMIT)
    assert rig.stepper.command.controlword & ControlBit.HALT
    rig.step(10)
    assert rig.stepper.command.controlword & ControlBit.HALT, "it is kept"
    rig.node.model.machine = replace(LIMITED, positive_limit=None)
    rig.step(200)
    return rig


def test_released_limit_switch_does_not_resume_a_task() -> None:
    rig = at_limit()
    assert 20_000 <= position(rig) < 45_000
    assert rig.stepper.reason is Reason.TASK_AT_LIMIT
    assert rig.actuals["ZSW1"] & (REACHED | STOPPED) == STOPPED
    assert rig.state is State.OPERATION_ENABLED


def test_task_at_a_limit_resumes_after_an_intermediate_stop() -> None:
    rig = at_limit()
    rig.values["STW1"] = ON & ~INTERMEDIATE
    rig.step(2)
    assert rig.stepper.reason is Reason.INTERMEDIATE_STOP
    rig.values["STW1"] = ON
    rig.until(reached)
    assert position(rig) == 60_000


@pytest.mark.parametrize("target", [-5_000, 50_000])
def test_a_new_task_replaces_the_one_at_a_limit(target: int) -> None:
    rig = at_limit()
    task(rig, target)
    rig.until(reached)
    assert position(rig) == target


def test_a_task_at_a_limit_can_be_rejected() -> None:
    rig = at_limit()
    before = position(rig)
    rig.values["STW1"] = ON & ~REJECT
    rig.step(5)
    rig.values["STW1"] = ON
    rig.until(reached)
    rig.step(100)
    assert position(rig) == before
    assert rig.stepper.reason is None, "at rest the limit of the drive is nothing"


def test_reference_values_are_limited_to_the_objects() -> None:
    drive = engel()
    known = {quantity: Reference(Fraction(10**12), "") for quantity in Quantity}
    scaling = TaskScaling.of(replace(drive, scaling=replace(drive.scaling, references=known)))
    for attribute, conversion in (
        ("profile_velocity", scaling.velocity),
        ("profile_acceleration", scaling.acceleration),
        ("profile_deceleration", scaling.deceleration),
    ):
        assert conversion.to_value(N4_100_PERCENT) == drive.limits(attribute)[1]
