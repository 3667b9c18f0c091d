"""Telegrams 5, 6, 105 and 106 on the simulated drive: DSC in both forms, with a proportional controller in the PLC."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import pytest

from pdgw.dsp402.drive_type import Quantity, Reference
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State, StatusBit
from pdgw.gateway.axis.demand_report import Flag
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.settings import AxisSettings, ControlLost
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS, FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.base.step_text import remedy_text
from pdgw.gateway.motion.dsc_setpoint import DscChoices, DscForm, dead_time_ns, highest_gain, longest_hold_ns
from pdgw.peers.drive import DriveModel
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.rig import Rig
from tests.support.drives.drive_types import References, described, engel

CYCLE_NS = 4_000_000
REFERENCES = References(max_acceleration=5000, max_deceleration=2000)
LONG_RAMP = replace(REFERENCES, max_deceleration=100)
OFF, ON, CONTROL = 0x040E, 0x040F, 0x0400
"""STW1.4 to .6 are not evaluated."""
KPC = 30_000
FORMS = list(DscForm)


def axis(
    form: DscForm,
    number: int = 105,
    references: References = REFERENCES,
    control_lost: ControlLost = ControlLost.STOP,
    **choices: int,
) -> Rig:
    dsc = DscChoices(form, **{"following_window": 4096, **choices})
    rig = Rig(number, dsc=dsc, control_lost=control_lost)
    rig.stepper.set_references(references)
    rig.enable(OFF)
    return rig


def control(rig: Rig, target: int, cycles: int, kpc: int = KPC) -> list[int]:
    """The PLC's proportional controller: the error of the position it last saw; returns the errors."""
    errors = []
    for _ in range(cycles):
        seen = rig.actuals["G1_XIST1"]
        position = seen - (1 << 32) if seen >> 31 else seen
        errors.append(target - position)
        rig.values |= {"XERR": target - position, "KPC": kpc, "NSOLL_B": 0}
        rig.step()
    return errors


@pytest.mark.parametrize("number", [5, 6, 105, 106])
@pytest.mark.parametrize("form", FORMS)
def test_each_form_has_its_mode(form: DscForm, number: int) -> None:
    rig = axis(form, number)
    wanted = {DscForm.POSITION: Mode.CYCLIC_POSITION, DscForm.SPEED: Mode.CYCLIC_VELOCITY}[form]
    assert rig.node.model.mode == wanted


def test_worked_example_105_50_per_second_and_2048_increments() -> None:
    rig = axis(DscForm.SPEED, delay_cycles=0)
    rig.values |= {"KPC": 50_000, "XERR": 0x0800}
    rig.step()
    gain = min(50_000, highest_gain(dead_time_ns(CYCLE_NS)))
    assert gain == 36_787, "at 4 ms the gain is limited"
    assert rig.stepper.command.target_velocity == round(3000 * gain / 50_000)


@pytest.mark.parametrize("form", FORMS)
def test_a_position_is_reached_and_held(form: DscForm) -> None:
    rig = axis(form)
    errors = control(rig, 3000, 400)
    assert errors[0] == 3000
    assert max(map(abs, errors[-50:])) <= 3


@pytest.mark.parametrize("form", FORMS)
def test_without_kpc_nsoll_b_is_the_speed(form: DscForm) -> None:
    rig = axis(form)
    rig.values["NSOLL_B"] = 1 << 28
    rig.step(150)
    assert abs(rig.feedback.velocity_actual - 1500) <= 15
    before = rig.feedback.position_actual
    rig.step(250)
    turned = rig.feedback.position_actual - before
    assert abs(turned - 750 * 4096 / 60) <= 60, "a second at 750 rpm"


@pytest.mark.parametrize("form", FORMS)
def test_operation_without_a_new_frame_shows_no_speed_reached(form: DscForm) -> None:
    rig = axis(form)
    rig.values["STW1"] = OFF
    rig.step(20)
    rig.values |= {"STW1": ON, "NSOLL_B": 1 << 28}
    while rig.stepper.command.controlword & 0xF != 0xF:
        rig.step()
    while rig.seen_statusword & 0x6F != 0x27:
        rig.silent(1)
    assert rig.stepper.command.target_velocity == rig.stepper.command.velocity_offset == 0
    assert not rig.actuals["ZSW1"] & Flag.REACHED
    assert rig.stepper.reason is Reason.DSC_OUT_OF_DATE
    rig.step()
    assert rig.stepper.reason is None


@pytest.mark.parametrize("form", FORMS)
def test_dsc_start_with_a_far_target_stays_at_standstill(form: DscForm) -> None:
    rig = axis(form)
    control(rig, 50_000, 50)
    assert rig.stepper.reason is Reason.DSC_FAR_FROM_AXIS
    assert not rig.actuals["ZSW1"] & Flag.REACHED
    assert rig.feedback.velocity_actual == 0


def test_a_gain_that_would_oscillate_is_limited_with_a_warning() -> None:
    rig = axis(DscForm.SPEED)
    errors = control(rig, 1000, 400, kpc=400_000)
    assert rig.stepper.numbers == [FaultNumber.DSC_GAIN]
    assert rig.actuals["ZSW1"] & 0x0080
    assert max(map(abs, errors[-50:])) <= 20


@pytest.mark.parametrize("form", FORMS)
def test_off1_ramps_down_with_power_on_and_enabling_again_does_not_jump(form: DscForm) -> None:
    rig = axis(form)
    rig.values["NSOLL_B"] = 1 << 29
    rig.step(200)
    fast = rig.feedback.velocity_actual
    assert fast >= 2900
    rig.values["STW1"] = OFF
    speeds = []
    for _ in range(400):
        rig.step()
        speeds.append(rig.feedback.velocity_actual)
    assert speeds[0] > fast // 2, "a ramp, no step"
    assert speeds[-1] == 0
    rig.values |= {"STW1": ON, "NSOLL_B": 0}
    rig.step(50)
    assert rig.feedback.velocity_actual == 0


@pytest.mark.parametrize("form", FORMS)
def test_loss_of_the_plc_stops_the_axis(form: DscForm) -> None:
    rig = axis(form)
    rig.values["NSOLL_B"] = 1 << 29
    rig.step(200)
    rig.step(400, plc=False)
    assert rig.feedback.velocity_actual == 0


HELD_CYCLES = longest_hold_ns(dead_time_ns(CYCLE_NS)) // CYCLE_NS


def turn(rig: Rig, cycles: int = 100) -> int:
    """Advance the setpoint by 20 increments per cycle (73 rpm), without NSOLL_B; return the target."""
    target = rig.feedback.position_actual
    for _ in range(cycles):
        target += 20
        control(rig, target, 1)
    return target


@pytest.mark.parametrize("form", FORMS)
def test_few_missing_frames_do_not_end_dsc(form: DscForm) -> None:
    rig = axis(form)
    target = turn(rig)
    rig.silent(HELD_CYCLES)
    assert rig.stepper.reason is None
    assert not rig.actuals["ZSW1"] & 0x0080
    control(rig, target, 200)
    assert rig.stepper.reason is None
    assert abs(rig.feedback.position_actual - target) <= 3


@pytest.mark.parametrize("form", FORMS)
def test_outdated_position_error_stops_the_axis_before_the_watchdog(form: DscForm) -> None:
    rig = axis(form)
    turn(rig)
    rig.silent(HELD_CYCLES + 1)
    assert rig.stepper.reason is Reason.DSC_OUT_OF_DATE
    rig.silent(30)
    assert rig.actuals["ZSW1"] & 0x0080, "a warning"
    assert rig.stepper.machine.outputs.warned == warning_bits(FaultNumber.DSC_OUT_OF_DATE), "not that of the gain"
    stopped = rig.feedback.position_actual
    rig.silent(200)
    assert abs(rig.feedback.position_actual - stopped) <= 1
    assert rig.state is State.OPERATION_ENABLED, "whether the PLC is lost is for the watchdog"


def test_out_of_date_setpoint_and_off1_end_the_warning_of_a_limited_gain() -> None:
    rig = axis(DscForm.SPEED)
    outputs = rig.stepper.machine.outputs
    gain = warning_bits(FaultNumber.DSC_GAIN)
    control(rig, 2000, 20, kpc=400_000)
    assert outputs.warned == gain
    rig.silent(HELD_CYCLES + 1)
    assert outputs.warned == warning_bits(FaultNumber.DSC_OUT_OF_DATE)
    control(rig, rig.feedback.position_actual, 200, kpc=400_000)
    assert outputs.warned == gain
    rig.values["STW1"] = OFF
    rig.step()
    assert not outputs.warned


@pytest.mark.parametrize("form", FORMS)
def test_dsc_restarts_after_late_frames_only_near_the_axis(form: DscForm) -> None:
    rig = axis(form)
    turn(rig)
    rig.silent(60)
    stopped = rig.feedback.position_actual
    control(rig, stopped + 5000, 50)
    assert rig.stepper.reason is Reason.DSC_FAR_FROM_AXIS
    assert abs(rig.feedback.position_actual - stopped) <= 1
    control(rig, stopped + 1000, 200)
    assert rig.stepper.reason is None
    assert abs(rig.feedback.position_actual - stopped - 1000) <= 3


def test_stop_after_late_frames_ramps_to_standstill_despite_new_frames() -> None:
    rig = axis(DscForm.SPEED, references=LONG_RAMP)
    turn(rig)
    rig.silent(HELD_CYCLES + 2)
    speeds = []
    while rig.stepper.reason is Reason.DSC_OUT_OF_DATE:
        speeds.append(rig.stepper.command.target_velocity)
        control(rig, rig.feedback.position_actual + 1000, 1)
    assert speeds == sorted(speeds, reverse=True)
    assert len(speeds) >= 16, "1000 rpm/s from 73 rpm, while new set-points come"
    assert speeds[-1] == 0
    assert rig.stepper.command.target_velocity > 0, "then it follows again"


@pytest.mark.parametrize("form", FORMS)
def test_speed_without_kpc_stays_until_the_watchdog_expires(form: DscForm) -> None:
    rig = axis(form)
    rig.values["NSOLL_B"] = 1 << 28
    rig.step(150)
    rig.silent(200)
    assert rig.stepper.reason is None
    assert abs(rig.feedback.velocity_actual - 1500) <= 15


@pytest.mark.parametrize("form", FORMS)
def test_position_error_from_before_the_loss_of_control_stops_the_axis(form: DscForm) -> None:
    rig = axis(form, control_lost=ControlLost.HOLD)
    turn(rig)
    rig.values["STW1"] = ON & ~CONTROL
    rig.step(HELD_CYCLES + 30)
    stopped = rig.feedback.position_actual
    rig.step(200)
    assert abs(rig.feedback.position_actual - stopped) <= 1
    assert rig.state is State.OPERATION_ENABLED, "the last ON stands"


@pytest.mark.parametrize("form", FORMS)
def test_speed_without_kpc_and_control_stays_if_configured(form: DscForm) -> None:
    rig = axis(form, control_lost=ControlLost.HOLD)
    rig.values["NSOLL_B"] = 1 << 28
    rig.step(150)
    rig.values |= {"STW1": ON & ~CONTROL, "NSOLL_B": 0}
    rig.step(200)
    assert abs(rig.feedback.velocity_actual - 1500) <= 15


def test_off1_ramps_also_with_positions_and_without_nsoll_b() -> None:
    rig = axis(DscForm.POSITION, references=LONG_RAMP)
    turn(rig)
    rig.values["STW1"] = OFF
    rig.step()
    before = rig.feedback.position_actual
    rig.step(10)
    assert rig.feedback.position_actual - before > 100, "it does not stop dead"


def limit_switch(rig: Rig, *, reached: bool) -> None:
    """The positive one: where the axis is, or nowhere."""
    model = rig.node.model
    model.machine = replace(model.machine, positive_limit=model.machine_position if reached else None)
    model.wake()


@pytest.mark.parametrize("form", FORMS)
def test_an_axis_that_a_limit_switch_stopped_does_not_move_on_when_it_is_released(form: DscForm) -> None:
    rig = axis(form)
    rig.values["NSOLL_B"] = 1 << 28
    rig.step(100)
    limit_switch(rig, reached=True)
    rig.step(400)
    assert rig.stepper.reason is Reason.STOPPED_AT_LIMIT
    assert not rig.actuals["ZSW1"] & Flag.REACHED, "nobody turns at the setpoint"
    limit_switch(rig, reached=False)
    rig.step(200)
    assert rig.feedback.velocity_actual == 0
    rig.values["NSOLL_B"] = 0
    rig.step(3)
    rig.values["NSOLL_B"] = 1 << 28
    rig.step(100)
    assert rig.feedback.velocity_actual > 1400


@pytest.mark.parametrize("form", FORMS)
def test_axis_stopped_at_its_limit_switch_stays_when_it_is_released(form: DscForm) -> None:
    rig = axis(form)
    limit_switch(rig, reached=True)
    rig.step(10)
    rig.values["NSOLL_B"] = 1 << 28
    rig.step(400)
    assert rig.stepper.reason is Reason.STOPPED_AT_LIMIT
    limit_switch(rig, reached=False)
    rig.step(200)
    assert rig.feedback.velocity_actual == 0


@pytest.mark.parametrize("form", FORMS)
def test_limit_bit_of_an_axis_at_its_target_is_nothing(form: DscForm) -> None:
    rig = axis(form)

    def limited(model: DriveModel, _: int) -> None:
        model.statusword |= StatusBit.INTERNAL_LIMIT

    rig.node.model.disguises.append(limited)
    for speed in (1 << 28, 0):
        rig.values["NSOLL_B"] = speed
        for _ in range(400):
            rig.step()
            assert rig.stepper.reason is None
            assert not rig.stepper.warning


@pytest.mark.parametrize("form", FORMS)
def test_axis_at_a_limit_switch_follows_a_setpoint_away_from_it(form: DscForm) -> None:
    rig = axis(form)
    limit_switch(rig, reached=True)
    rig.step(400)
    assert rig.stepper.reason is None
    rig.values["NSOLL_B"] = -(1 << 28)
    rig.step(100)
    assert rig.feedback.velocity_actual < -1400


def test_limited_gain_of_an_axis_at_a_limit_switch_is_one_warning() -> None:
    rig = axis(DscForm.SPEED)
    rig.values |= {"KPC": 60_000, "XERR": 1000, "NSOLL_B": 1 << 27}
    rig.step(100)
    limit_switch(rig, reached=True)
    rig.step(200)
    assert rig.stepper.numbers.count(FaultNumber.DSC_GAIN) == 1
    assert rig.stepper.machine.outputs.warning & warning_bits(FaultNumber.DSC_GAIN)
    rig.values["STW1"] = OFF
    rig.step(200)
    assert not rig.stepper.machine.outputs.warning & warning_bits(FaultNumber.DSC_GAIN)


def test_torque_reduction_works_with_dsc() -> None:
    rig = axis(DscForm.SPEED)
    rig.values["MOMRED"] = 0x2000
    rig.step(3)
    assert rig.node.model.max_torque == 1500


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("sign", [1, -1])
def test_speed_is_limited_to_the_range_of_its_object(form: DscForm, sign: int) -> None:
    rig = axis(form)
    drive = engel(REFERENCES)
    fast = {**drive.scaling.references, Quantity.SPEED: Reference(Fraction(2_000_000_000), "")}
    scaling = replace(drive.scaling, references=fast, velocity_per_rpm=Fraction(1_000_000))
    synchronous = replace(described("synchronous"), scaling=scaling)
    rig.stepper.set_drive(synchronous)
    rig.values["NSOLL_B"] = sign * ((1 << 31) - 1)
    rig.step(2)
    attribute = "target_velocity" if form is DscForm.SPEED else "velocity_offset"
    assert getattr(rig.stepper.command, attribute) == synchronous.limits(attribute)[sign > 0]


def test_dsc_without_its_key_is_rejected() -> None:
    with pytest.raises(GatewayError, match='needs dsc = "position" or "speed"'):
        AxisMachine(telegram(105), AxisSettings(), Rig(1).feedback)


def test_a_drive_whose_units_are_not_known_does_not_operate() -> None:
    rig = axis(DscForm.SPEED)
    drive = engel(REFERENCES)
    rig.stepper.set_drive(replace(drive, scaling=replace(drive.scaling, velocity_per_rpm=None)))
    rig.step(2)
    assert rig.stepper.numbers == [FaultNumber.REFERENCE]
    assert rig.stepper.events[0].remedy == 'paste into its [[axis]] and fill in: velocity_unit = "?"'


def test_the_remedy_of_a_quantity_that_no_key_gives_is_that_of_the_fault() -> None:
    rig = axis(DscForm.SPEED)
    drive = engel(REFERENCES)
    rig.stepper.set_drive(replace(drive, scaling=replace(drive.scaling, references={})))
    rig.step(2)
    (event,) = rig.stepper.events
    assert event.text.endswith("speed: 100 % is unknown")
    assert event.remedy == remedy_text(GATEWAY_FAULTS[FaultNumber.REFERENCE].remedy)


@pytest.mark.parametrize("form", FORMS)
def test_unusable_dsc_values_block_operation(form: DscForm) -> None:
    rig = Rig(105, dsc=DscChoices(form, following_window=4096), cycle_ns=0)
    rig.step(2)
    (event,) = rig.stepper.events
    assert event.number == FaultNumber.REFERENCE
    assert "SYNC period: 0 is not allowed" in event.text
