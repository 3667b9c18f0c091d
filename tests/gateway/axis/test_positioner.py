"""Telegrams 7, 110 and 111 on the simulated drive: words in, objects and words out, in virtual time."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from fractions import Fraction

import pytest

from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import Quantity, Reference
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, State
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.settings import AxisSettings, PlcLossReaction
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.blocks import Block, BlockNext, BlockTask
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.peers.drive import Machine
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import Rig
from tests.support.drives.drive_types import References, engel

REFERENCES = References(
    position_min=-2_000_000,
    position_max=2_000_000,
    max_acceleration=2000,
    max_deceleration=2000,
)
OFF, ON = 0x043E, 0x043F


def positioner(
    number: int = 111,
    choices: PositionerChoices = CHOICES,
    machine: Machine | None = None,
    on_plc_loss: PlcLossReaction = PlcLossReaction.QUICK_STOP,
    **changes: object,
) -> Rig:
    rig = Rig(number, machine, positioner=choices, on_plc_loss=on_plc_loss)
    for index, subindex, value in (
        (0x607B, 1, -2_000_000),
        (0x607B, 2, 2_000_000),
        (0x60C5, 0, 2000),
        (0x60C6, 0, 2000),
    ):
        rig.node.set_data(index, subindex, value.to_bytes(4, "little", signed=index == 0x607B), check_writable=False)
    rig.stepper.set_references(REFERENCES, homing_method=35)
    rig.enable(OFF)
    rig.stepper.events.clear()
    rig.values |= {"OVERRIDE": 0x4000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000} if number != 7 else {}
    rig.values |= changes  # type: ignore[arg-type]
    return rig


def send(rig: Rig, words: str) -> None:
    half = rig.stepper.telegram.setpoints
    rig.values |= half.as_dict(half.decode(bytes.fromhex(words)))


def bits(rig: Rig, name: str) -> set[str]:
    signal = rig.stepper.telegram.actuals.signals[rig.stepper.telegram.actuals.index(name)]
    return {bit.name for bit in signal.fields(positioning=True) if bit.of(rig.actuals[name])}


def home(rig: Rig) -> None:
    rig.values["STW1"] |= 0x0800
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0800), 200)
    rig.values["STW1"] &= ~0x0800
    rig.step(30)


def test_worked_example_111_absolute_to_50000_lu_at_12000() -> None:
    rig = positioner()
    home(rig)
    rig.controlwords.clear()
    send(rig, "047F 8100 0000 0000 4000 0000 C350 0000 2EE0 4000 4000 0000")
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x1000), 10)
    command = rig.stepper.command
    assert (command.target_position, command.profile_velocity) == (20_480, 2400)
    assert (command.profile_acceleration, command.profile_deceleration) == (1200, 1200)
    assert 0x003F in rig.controlwords
    rig.until(lambda actuals: actuals["NIST_B"] >= 0x1999_0000, 200)
    assert {name: rig.actuals[name] for name in ("ZSW1", "POS_ZSW1", "POS_ZSW2")} == {
        "ZSW1": 0x1B37,
        "POS_ZSW1": 0x8000,
        "POS_ZSW2": 0x8010,
    }
    assert rig.actuals["NIST_B"] <= 0x1999_9999
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 2000)
    assert (rig.actuals["ZSW1"], rig.actuals["XIST_A"]) == (0x3F37, 0xC350)


def test_edge_that_started_nothing_ends_the_warning_of_the_task_before() -> None:
    rig = positioner()
    send(rig, "047F 8100 0000 0000 4000 0000 C350 0000 0000 4000 4000 0000")
    rig.step(5)
    assert rig.stepper.reason is Reason.TASK_SPEED_ZERO
    assert "WARNING" in bits(rig, "ZSW1")
    for word in (0x041F, 0x045F, 0x043F):
        rig.values["STW1"] = word
        rig.step(5)
    assert rig.stepper.reason is Reason.LOST_EDGE
    assert "WARNING" not in bits(rig, "ZSW1")


def test_worked_example_111_with_override_2000h() -> None:
    rig = positioner()
    send(rig, "047F 8100 0000 0000 2000 0000 C350 0000 2EE0 4000 4000 0000")
    rig.step(6)
    assert rig.stepper.command.profile_velocity == 1200


def test_worked_example_111_relative() -> None:
    rig = positioner()
    home(rig)
    send(rig, "047F 8000 0000 0000 4000 0000 2710 0000 2EE0 4000 4000 0000")
    rig.step(6)
    assert any(word & ControlBit.RELATIVE for word in rig.controlwords)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 2000)
    assert rig.actuals["XIST_A"] == 10_000
    rig.values["STW1"] &= ~0x40
    rig.step(3)
    rig.values["STW1"] |= 0x40
    rig.step(3)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 2000)
    assert rig.actuals["XIST_A"] == 20_000


def _length(rig: Rig) -> int:
    value = rig.actuals["XIST_A"]
    return value - (1 << 32) if value >> 31 else value


@pytest.mark.parametrize("late", [False, True], ids=["with the Statusword", "a cycle after it"])
def test_homing_after_a_reference_point_never_mixes_offset_and_zero(late: bool) -> None:
    rig = positioner(choices=replace(CHOICES, reference_coordinate=1000))
    send(rig, "047F 8100 0000 0000 4000 0000 C350 0000 2EE0 4000 4000 0000")
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 2000)
    rig.values |= {"STW1": ON, "POS_STW2": rig.values["POS_STW2"] | 0x0002}
    rig.step(3)
    assert (_length(rig), rig.actuals["ZSW1"] & 0x0800) == (1000, 0x0800)
    if late:
        pass_on, waits = rig.stepper.step, [rig.feedback.position_actual]

        def later(setpoints: object, feedback: DriveFeedback, *rest: object, fresh: bool = True) -> Sequence[int]:
            shown = copy(feedback)
            waits.append(feedback.position_actual)
            shown.position_actual = waits.pop(0)
            return pass_on(setpoints, shown, *rest, fresh=fresh)  # type: ignore[arg-type]

        rig.stepper.step = later  # type: ignore[method-assign]
    rig.values["STW1"] |= 0x0800
    shown = set()
    while not rig.step()["ZSW1"] & 0x0800:
        shown.add(_length(rig))
    assert shown == {50_000, 0}, "what the drive counts, from its old zero and from its new one"
    assert _length(rig) == 1000, "with the first ZSW1.11"


@pytest.mark.parametrize("number", [7, 110, 111])
def test_worked_example_block_5(number: int) -> None:
    rig = positioner(number)
    if number != 7:
        home(rig)
    rig.values[{111: "POS_STW1"}.get(number, "SATZANW")] = 5
    rig.values["STW1"] = 0x047F
    rig.step(5)
    assert rig.stepper.command.target_position == 20_480
    assert rig.actuals[{111: "POS_ZSW1"}.get(number, "AKTSATZ")] & 0x3F == 5
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 2000)
    assert rig.feedback.position_actual == 20_480


def test_worked_example_setting_up_backward_and_the_reject() -> None:
    rig = positioner()
    send(rig, "047F C400 0000 0000 4000 0000 0000 0000 2EE0 4000 4000 0000")
    rig.step(120)
    assert rig.feedback.modes_of_operation_display == Mode.VELOCITY
    assert rig.feedback.velocity_actual == -2400
    assert bits(rig, "POS_ZSW1") == {"SETTING_UP"}
    assert "MOVES_BACKWARD" in bits(rig, "POS_ZSW2")
    assert rig.actuals["ZSW1"] & 0x1000
    rig.values["STW1"] &= ~0x10
    rig.step(2)
    assert bits(rig, "POS_ZSW1") == {"SETTING_UP"}, "still the mode that is selected"
    assert not rig.actuals["ZSW1"] & 0x0400
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 400)
    assert rig.feedback.velocity_actual == 0


def test_worked_example_jog_1() -> None:
    rig = positioner(STW1=0x053F)
    rig.step(50)
    assert rig.feedback.velocity_actual == -60, "-300 x 1000 LU/min are -30 rpm"
    assert bits(rig, "POS_ZSW1") == {"JOGGING"}
    rig.values["STW1"] = ON
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 400)


def test_incremental_jog_moves_its_distance_and_returns_from_the_speed_mode() -> None:
    rig = positioner(STW1=0x063F)
    rig.step(30)
    rig.values["STW1"] = ON
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 400)
    before = rig.feedback.position_actual
    rig.values |= {"POS_STW2": 0x0020, "STW1": 0x063F}
    rig.step(5)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 2000)
    assert rig.feedback.position_actual - before == 2048
    assert rig.feedback.modes_of_operation_display == Mode.POSITION


def test_from_setting_up_to_a_position_the_axis_ramps_down_before_the_mode_changes() -> None:
    rig = positioner()
    send(rig, "047F C200 0000 0000 4000 0000 0000 0000 2EE0 4000 4000 0000")
    rig.step(120)
    rig.values["STW1"] &= ~0x40
    rig.step(2)
    send(rig, "047F 8100 0000 0000 4000 0000 0000 0000 2EE0 4000 4000 0000")
    fast = False
    for _ in range(1500):
        rig.step()
        if rig.stepper.command.modes_of_operation != rig.feedback.modes_of_operation_display:
            fast = fast or abs(rig.feedback.velocity_actual) > 60
            assert not rig.stepper.command.controlword & ControlBit.HALT
        if rig.actuals["ZSW1"] & 0x0400:
            break
    assert not fast, "the mode changed while the axis turned"
    assert rig.feedback.position_actual == 0


def test_continuous_update_moves_the_target_with_one_acknowledge() -> None:
    rig = positioner()
    send(rig, "047F 9100 0000 0000 4000 0000 C350 0000 2EE0 4000 4000 0000")
    rig.step(20)
    rig.values["MDI_TARPOS"] = 20_000
    for _ in range(1500):
        rig.step()
        assert rig.actuals["ZSW1"] & 0x1000
        if rig.actuals["ZSW1"] & 0x0400:
            break
    assert rig.actuals["XIST_A"] == 20_000


def test_intermediate_stop_and_resume_of_a_relative_task_end_where_it_was_sent() -> None:
    rig = positioner()
    send(rig, "047F 8000 0000 0000 4000 0000 C350 0000 0BB8 4000 4000 0000")
    for _ in range(3):
        rig.step(40)
        rig.values["STW1"] &= ~0x20
        rig.until(lambda _: rig.feedback.velocity_actual == 0, 400)
        rig.step(10)
        assert rig.stepper.reason is Reason.INTERMEDIATE_STOP
        rig.values["STW1"] |= 0x20
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 3000)
    assert rig.feedback.position_actual == 20_480


def test_a_flying_chain_gives_the_second_block_while_the_first_runs() -> None:
    rig = positioner(POS_STW1=1)
    rig.values["STW1"] = 0x047F
    rig.step(20)
    assert rig.stepper.command.target_position == round(15_000 * 0.4096)
    assert not rig.stepper.command.controlword & ControlBit.CHANGE_IMMEDIATELY
    assert rig.actuals["POS_ZSW1"] & 0x7F == 1
    rig.until(lambda actuals: actuals["POS_ZSW1"] & 0x7F == 2, 1000)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 2000)
    assert rig.actuals["XIST_A"] == 15_000


def test_homing_is_shown_100_ms_and_sets_the_home_position() -> None:
    rig = positioner()
    rig.values["STW1"] |= 0x0800
    shown = 0
    for _ in range(200):
        rig.step()
        shown += "HOMING" in bits(rig, "POS_ZSW1")
    assert shown >= 25
    assert rig.actuals["ZSW1"] & 0x0C00 == 0x0C00
    assert rig.feedback.modes_of_operation_display == Mode.POSITION


def test_a_reference_point_is_set_and_kept_until_the_drive_restarts() -> None:
    rig = positioner(STW1=0x063F)
    rig.step(30)
    rig.values |= {"STW1": ON}
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0400), 400)
    assert rig.actuals["XIST_A"]
    rig.values["POS_STW2"] = 0x0002
    rig.step(2)
    assert (rig.actuals["XIST_A"], rig.actuals["ZSW1"] & 0x0800) == (0, 0x0800)
    rig.restart_drive()
    rig.step(5)
    assert not rig.actuals["ZSW1"] & 0x0800


@pytest.mark.parametrize(
    ("number", "values"), [(7, {}), (110, {"OVERRIDE": 0}), (111, {"POS_STW2": 0x4000, "OVERRIDE": 0})]
)
def test_software_limits_end_jogging_at_the_limit(number: int, values: dict[str, int]) -> None:
    rig = positioner(number)
    home(rig)
    rig.values |= {"STW1": 0x063F, **values}
    rig.step(60)
    assert rig.feedback.modes_of_operation_display == Mode.POSITION
    assert rig.stepper.command.target_position == 409_600


def test_an_unknown_block_moves_nothing_and_warns_until_the_reject() -> None:
    rig = positioner(POS_STW1=77)
    rig.values["STW1"] = 0x047F
    rig.step(20)
    assert rig.stepper.reason is Reason.TASK_BLOCK_UNKNOWN
    assert rig.actuals["ZSW1"] & 0x0080
    assert rig.stepper.numbers == [FaultNumber.POSITIONER]
    assert not rig.actuals["ZSW1"] & 0x1000
    rig.values["STW1"] = 0x042F
    rig.step(2)
    assert not rig.actuals["ZSW1"] & 0x0080


def test_plc_loss_drops_the_task_and_the_active_bit_starts_nothing() -> None:
    rig = positioner()
    send(rig, "047F 8100 0000 0000 4000 0000 C350 0000 2EE0 4000 4000 0000")
    rig.step(40)
    rig.step(400, plc=False)
    assert rig.feedback.velocity_actual == 0
    rig.values["STW1"] = OFF | 0x40
    rig.step(6)
    rig.values["STW1"] = ON | 0x40
    rig.step(100)
    assert rig.feedback.velocity_actual == 0
    assert not rig.actuals["ZSW1"] & 0x1000


def test_off1_ramps_down_and_the_next_on_resumes_nothing() -> None:
    rig = positioner()
    send(rig, "047F C200 0000 0000 4000 0000 0000 0000 2EE0 4000 4000 0000")
    rig.step(120)
    rig.values["STW1"] &= ~1
    rig.until(lambda _: rig.feedback.velocity_actual == 0, 400)
    rig.step(10)
    rig.values["STW1"] |= 1
    rig.step(100)
    assert rig.feedback.velocity_actual == 0


@pytest.mark.parametrize("lost", [False, True])
def test_off1_and_plc_loss_halt_a_task_in_its_mode(lost: bool) -> None:
    rig = positioner(on_plc_loss=PlcLossReaction.RAMP)
    send(rig, "047F 8100 0000 0000 4000 0000 C350 0000 2EE0 4000 4000 0000")
    rig.step(40)
    assert rig.feedback.velocity_actual
    rig.values["STW1"] &= ~1
    rig.step(1, plc=not lost)
    while rig.state is State.OPERATION_ENABLED and rig.feedback.velocity_actual:
        assert rig.stepper.command.controlword & (ControlBit.HALT | ControlBit.NEW_SETPOINT) == ControlBit.HALT
        assert rig.stepper.command.modes_of_operation == Mode.POSITION
        rig.step(1, plc=not lost)
    rig.step(10, plc=not lost)
    assert rig.state is not State.OPERATION_ENABLED
    assert rig.feedback.position_actual < 15_000, "not to its target, 20480"


def test_telegram_7_has_no_mdi() -> None:
    rig = positioner(7, SATZANW=0x8005)
    rig.values["STW1"] = 0x047F
    rig.step(20)
    assert rig.stepper.reason is Reason.TASK_SPEED_ZERO
    assert rig.feedback.velocity_actual == 0


def test_positioner_without_its_keys_is_rejected() -> None:
    with pytest.raises(GatewayError, match=r"\[axis.positioner\] is missing: a telegram of the positioner needs it"):
        AxisMachine(telegram(111), AxisSettings(), Rig(1).feedback)


def test_a_drive_whose_units_are_not_known_does_not_operate() -> None:
    rig = Rig(111, positioner=CHOICES)
    drive = engel(REFERENCES)
    rig.stepper.set_drive(replace(drive, scaling=replace(drive.scaling, counts_per_revolution=None)))
    rig.step(3)
    assert rig.stepper.events[0].number == FaultNumber.REFERENCE
    assert "counts_per_revolution" in rig.stepper.events[0].text
    rig.values["STW1"] = OFF
    rig.step(3)
    rig.values["STW1"] = ON
    rig.step(10)
    assert rig.actuals["ZSW1"] & 0x0008
    assert not rig.actuals["ZSW1"] & 0x0004


# -- fixed stop -------------------------------------------------------------------------------------------------------------

_STOP = Machine(positive_stop=3000.0)
_PRESSING = replace(
    CHOICES,
    clamping_torque=400,
    blocks=(
        Block(1, 50_000, 3000, task=BlockTask.FIXED_STOP, value=250),
        Block(2, 50_000, 3000, task=BlockTask.FIXED_STOP, value=250, next=BlockNext.CONTINUE_WITH_STOP),
        Block(3, 0, 3000),
    ),
)
OWN_TORQUE = 3000


def press(rig: Rig, **values: int) -> None:
    rig.values |= {"STW1": ON, **values}
    rig.step(5)
    rig.values["STW1"] = ON | 0x40
    rig.until(lambda actuals: "FIXED_STOP_REACHED" in bits(rig, "POS_ZSW2"), 2000)


def test_a_block_presses_on_its_fixed_stop_with_its_torque_until_the_reject() -> None:
    rig = positioner(choices=_PRESSING, machine=_STOP)
    torques: list[int] = []
    rig.values |= {"STW1": ON, "POS_STW1": 1}
    rig.step(5)
    rig.values["STW1"] = ON | 0x40
    for _ in range(2000):
        rig.step()
        if rig.node.model.ramp.speed:
            torques.append(rig.node.model.max_torque)
        if "FIXED_STOP_REACHED" in bits(rig, "POS_ZSW2"):
            break
    assert set(torques) == {250}, "it never moves with another limit"
    assert {"FIXED_STOP_REACHED", "CLAMPING_TORQUE_REACHED", "TO_FIXED_STOP"} <= bits(rig, "POS_ZSW2")
    assert rig.node.model.position == 3000
    rig.step(300)
    assert rig.node.model.max_torque == 250, "it presses on"
    rig.values["STW1"] = ON & ~0x10
    rig.step(20)
    assert rig.node.model.max_torque == OWN_TORQUE
    assert "FIXED_STOP_REACHED" not in bits(rig, "POS_ZSW2")


def test_block_after_a_fixed_stop_has_the_drives_own_torque() -> None:
    rig = positioner(choices=_PRESSING, machine=_STOP)
    press(rig, POS_STW1=2)
    rig.until(lambda actuals: rig.node.model.ramp.speed < 0, 500)
    assert rig.node.model.max_torque == OWN_TORQUE
    rig.until(lambda actuals: actuals["XIST_A"] == 0, 2000)


def test_stw2_8_presses_with_the_clamping_torque() -> None:
    rig = positioner(choices=_PRESSING, machine=_STOP)
    press(rig, POS_STW1=0x8100, STW2=0x0100, MDI_TARPOS=50_000, MDI_VELOCITY=3000)
    assert rig.node.model.max_torque == 400
    assert rig.actuals["ZSW2"] & 0x0100


def test_leaving_operation_gives_the_drive_its_own_torque_back() -> None:
    rig = positioner(choices=_PRESSING, machine=_STOP)
    press(rig, POS_STW1=1)
    rig.step(50, plc=False)
    assert rig.node.model.max_torque == OWN_TORQUE


def test_rejected_torque_limit_moves_nothing_and_is_reported() -> None:
    rig = positioner(choices=_PRESSING, machine=_STOP)
    rig.sdo_error = "refused"
    rig.values |= {"STW1": ON, "POS_STW1": 1}
    rig.step(5)
    rig.values["STW1"] = ON | 0x40
    rig.step(100)
    assert rig.node.model.position == 0
    assert rig.stepper.reason is Reason.TORQUE_LIMIT
    assert any("6072h = 250: refused" in event.text for event in rig.stepper.events)


def test_a_drive_without_a_torque_limit_refuses_a_fixed_stop() -> None:
    rig = Rig(111, positioner=_PRESSING)
    rig.stepper.set_references(replace(REFERENCES, max_torque=0))
    rig.step()
    assert any("Max Torque 6072h" in event.text for event in rig.stepper.events)


@pytest.mark.parametrize("sign", [1, -1])
def test_greatest_length_unit_fits_the_object(sign: int) -> None:
    rig = Rig(111, positioner=replace(CHOICES, lu_per_revolution=100, software_limits=None, blocks=()))
    drive = engel(REFERENCES)
    rig.stepper.set_drive(replace(drive, scaling=replace(drive.scaling, position_range=None)))
    rig.enable(OFF)
    rig.values |= {"OVERRIDE": 0x4000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000, "POS_STW1": 0x8100, "STW1": ON}
    rig.values |= {"MDI_TARPOS": sign * (1 << 31) // 4096 * 100, "MDI_VELOCITY": 3}
    rig.step(2)
    rig.values["STW1"] = ON | 0x40
    rig.step(2)
    assert rig.stepper.command.target_position == ((1 << 31) - 1 if sign > 0 else -(1 << 31))


def test_a_ramp_that_is_less_than_a_unit_of_the_drive_refuses_operation() -> None:
    rig = positioner()
    drive = engel(REFERENCES)
    known = {**drive.scaling.references, Quantity.DECELERATION: Reference(Fraction(1, 2), "")}
    rig.stepper.set_drive(replace(drive, scaling=replace(drive.scaling, references=known)))
    rig.step()
    (event,) = rig.stepper.events
    assert event.number == FaultNumber.REFERENCE
    assert "100 % of the deceleration: 0" in event.text


def test_reference_values_are_limited_to_the_objects() -> None:
    rig = Rig(111, positioner=replace(CHOICES, max_velocity=(1 << 31) - 1, software_limits=None))
    drive = engel(REFERENCES)
    known = dict(drive.scaling.references)
    for quantity in (Quantity.PROFILE_VELOCITY, Quantity.ACCELERATION, Quantity.DECELERATION):
        known[quantity] = Reference(Fraction(10**12), "")
    scaling = replace(drive.scaling, references=known, velocity_per_rpm=Fraction(10**6))
    rig.stepper.set_drive(replace(drive, scaling=replace(scaling, acceleration_per_rpm_s=Fraction(10**6))))
    rig.enable(OFF)
    rig.values |= {"OVERRIDE": 0x4000, "MDI_ACC": 0x7FFF, "MDI_DEC": 0x7FFF, "POS_STW1": 0x8100, "STW1": ON}
    rig.values |= {"MDI_TARPOS": 5000, "MDI_VELOCITY": (1 << 31) - 1}
    rig.step(2)
    rig.values["STW1"] = ON | 0x40
    rig.step(2)
    command = rig.stepper.command
    assert command.profile_velocity == min(drive.limits("profile_velocity")[1], drive.limits("target_velocity")[1])
    assert command.profile_acceleration <= drive.limits("profile_acceleration")[1]
    assert command.profile_deceleration <= drive.limits("profile_deceleration")[1]
