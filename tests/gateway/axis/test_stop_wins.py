"""Stops that must win: a telegram of zeros, a PLC that accepts its control away, OFF2 and OFF3 the drive did not get."""

from __future__ import annotations

import pytest

from pdgw.dsp402.states import STATUS_OF, ControlBit, State, StatusBit
from pdgw.gateway.axis.settings import ControlLost, PlcLossReaction, SetpointEnable
from pdgw.gateway.axis.values import Configured
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from tests.gateway.axis.test_positioning import axis, position, reached
from tests.gateway.axis.test_velocity import CONTROL, OFF, ON, Bench
from tests.support.axis.rig import Rig
from tests.support.axis.tasks import ACTIVATE, INTERMEDIATE, POSITION, REJECT

COAST, QUICK_STOP = ON & ~0x2, ON & ~0x4
OPERATION_ENABLED, NO_OFF2, NO_OFF3 = 0x4, 0x10, 0x20


def turning(**settings: object) -> Bench:
    bench = Bench(**settings)  # type: ignore[arg-type]
    bench.operate(0x2000)
    bench.drive.ramp = 100
    bench.step(ON, 0x2000, cycles=40)
    assert bench.drive.feedback.velocity_actual == 3000
    return bench


# -- STW1.10 = 0 ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("control_lost", list(ControlLost))
def test_a_telegram_of_zeros_stops_the_drive(control_lost: ControlLost) -> None:
    bench = turning(control_lost=control_lost)
    bench.step(0, 0)
    assert bench.controlword & 0xF == 0
    assert bench.stepper.command.target_velocity == 0
    bench.step(0, 0, cycles=3)
    assert bench.drive.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("control_lost", list(ControlLost))
@pytest.mark.parametrize(("bits", "controlword"), [(0x6, 0xF), (0x5, 0x0), (0x3, 0x2)], ids=["OFF1", "OFF2", "OFF3"])
def test_off1_off2_and_off3_act_without_control(control_lost: ControlLost, bits: int, controlword: int) -> None:
    bench = turning(control_lost=control_lost)
    bench.step(0x78 | bits, 0x2000)
    assert bench.controlword & 0xF == controlword
    assert bench.stepper.command.target_velocity == 0
    bench.step(0x78 | bits, 0x2000, cycles=60)
    assert bench.drive.feedback.velocity_actual == 0
    assert bench.drive.state not in {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE}


@pytest.mark.parametrize(
    ("reaction", "word", "controlword"),
    [
        (PlcLossReaction.RAMP, 0x7D, 0x0),
        (PlcLossReaction.RAMP, 0x00, 0x0),
        (PlcLossReaction.RAMP, 0x7B, 0x2),
        (PlcLossReaction.RAMP, 0x73, 0x2),
        (PlcLossReaction.RAMP, 0x7E, 0xF),
        (PlcLossReaction.QUICK_STOP, 0x7D, 0x0),
        (PlcLossReaction.COAST, 0x7B, 0x0),
    ],
)
def test_off2_and_off3_without_control_stop_faster_than_the_loss_reaction(
    reaction: PlcLossReaction, word: int, controlword: int
) -> None:
    bench = turning(on_plc_loss=reaction)
    bench.step(None, cycles=2)
    bench.step(word, 0x2000)
    assert bench.controlword & 0xF == controlword
    bench.step(None)
    assert bench.controlword & 0xF == controlword, "the stop stays in force when the frames end again"
    bench.step(word, 0x2000, cycles=60)
    assert bench.drive.feedback.velocity_actual == 0
    assert bench.drive.state not in {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE}
    bench.step(ON, 0x2000, cycles=10)
    assert bench.drive.state is not State.OPERATION_ENABLED, "the stop without control released nothing"


def test_removed_control_in_operation_is_an_off1_with_a_warning() -> None:
    bench = turning()
    zsw1 = bench.step(ON & ~CONTROL, 0x2000)
    assert bench.controlword & 0xF == 0xF, "power stays on for the ramp"
    assert bench.stepper.command.target_velocity == 0
    assert zsw1 & OPERATION_ENABLED == 0
    assert zsw1 & StatusBit.WARNING
    assert bench.stepper.numbers == [FaultNumber.CONTROL_LOST]
    assert bench.stepper.reason is Reason.NO_CONTROL
    bench.step(ON & ~CONTROL, 0x2000, cycles=60)
    assert bench.drive.feedback.velocity_actual == 0
    assert bench.drive.state not in {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE}
    assert len(bench.stepper.events) == 1
    zsw1 = bench.step(ON, 0x2000, cycles=5)
    assert bench.drive.state is not State.OPERATION_ENABLED, "the ON that is still 1 starts nothing"
    assert not zsw1 & StatusBit.WARNING
    bench.operate()


@pytest.mark.parametrize("control_lost", list(ControlLost))
@pytest.mark.parametrize("bits", range(16))
def test_without_control_nothing_starts_and_no_off_counts(control_lost: ControlLost, bits: int) -> None:
    bench = Bench(control_lost=control_lost)
    bench.step(ON)
    bench.step(0x70 | (bits & 0xE), cycles=3)
    bench.step(0x70 | bits, 0x2000, cycles=10)
    assert not bench.controlword & ControlBit.SWITCH_ON
    bench.step(ON, 0x2000, cycles=10)
    assert bench.drive.state is not State.OPERATION_ENABLED, "an OFF without control released nothing"
    bench.operate()


@pytest.mark.parametrize("control_lost", list(ControlLost))
def test_loss_of_control_ends_an_active_start(control_lost: ControlLost) -> None:
    bench = Bench(control_lost=control_lost)
    bench.step(OFF, cycles=3)
    bench.step(ON, 0x2000)
    assert bench.drive.state is State.SWITCHED_ON
    bench.step(ON & ~CONTROL, 0x2000, cycles=10)
    assert bench.drive.state is not State.OPERATION_ENABLED


def test_positioning_without_control_halts_and_drops_the_task() -> None:
    rig = axis()
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(300_000), "STW1": 0x043F | ACTIVATE}
    rig.step(60)
    assert rig.node.model.velocity_actual
    rig.values["STW1"] &= ~CONTROL
    rig.step(1)
    assert rig.stepper.command.controlword & (ControlBit.HALT | 0xF) == ControlBit.HALT | 0xF
    rig.until(lambda _: rig.state is not State.OPERATION_ENABLED)
    assert rig.node.model.velocity_actual == 0
    stood = position(rig)
    rig.enable()
    rig.step(200)
    assert position(rig) == stood


def test_the_defaults_are_the_profiles() -> None:
    bench = turning()
    bench.step(ON & ~0x10, 0x2000)
    assert bench.stepper.command.target_velocity == 0
    assert bench.stepper.settings.setpoint_enable is SetpointEnable.PROFIDRIVE
    assert bench.stepper.settings.control_lost is ControlLost.STOP


# -- ZSW1 ---------------------------------------------------------------------------------------------------------------


def test_zsw1_never_shows_operation_again_in_the_middle_of_a_stop() -> None:
    """OFF1, then OFF3, while the Statusword is cycles old."""
    bench = turning()
    bench.step(OFF, 0x2000)
    old = bench.drive.feedback.statusword
    shown = []
    for _ in range(3):
        shown.append(bench.step(OFF & ~0x4, 0x2000))
        bench.drive.feedback.statusword = old
    assert [word & OPERATION_ENABLED for word in shown] == [0, 0, 0]
    assert [word & 0x3 for word in shown] == [3, 3, 3]


@pytest.mark.parametrize("reaction", [PlcLossReaction.RAMP, PlcLossReaction.QUICK_STOP, PlcLossReaction.COAST])
def test_zsw1_does_not_show_operation_during_the_reaction_to_a_plc_loss(reaction: PlcLossReaction) -> None:
    bench = turning(on_plc_loss=reaction)
    assert not bench.step(None) & OPERATION_ENABLED


@pytest.mark.parametrize(("word", "hidden"), [(COAST, NO_OFF2), (QUICK_STOP, NO_OFF3), (ON & ~0x6, NO_OFF2 | NO_OFF3)])
def test_zsw1_4_and_5_are_0_during_off2_and_off3_in_every_drive_state(word: int, hidden: int) -> None:
    bench = turning()
    assert bench.step(ON, 0x2000) & (NO_OFF2 | NO_OFF3) == NO_OFF2 | NO_OFF3
    statusword = bench.drive.feedback.statusword
    assert statusword & (StatusBit.VOLTAGE_ENABLED | StatusBit.NO_QUICK_STOP)
    assert bench.step(word, 0x2000) & (NO_OFF2 | NO_OFF3) == (NO_OFF2 | NO_OFF3) & ~hidden


def test_zsw1_5_stays_0_until_the_quick_stop_is_over() -> None:
    bench = turning()
    bench.step(QUICK_STOP, 0x2000)
    statusword = STATUS_OF[State.QUICK_STOP_ACTIVE] | StatusBit.NO_QUICK_STOP
    bench.drive.feedback.statusword = statusword
    assert not bench.stepper.step((ON, 0x2000), bench.drive.feedback, True, bench.now)[0] & NO_OFF3


# -- OFF2 and OFF3 lock in the gateway -----------------------------------------------------------------------------------


@pytest.mark.parametrize("word", [COAST, QUICK_STOP])
@pytest.mark.parametrize("state", [State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED])
@pytest.mark.parametrize("cycles", [1, 5])
def test_on_without_off_does_not_start_a_drive_that_missed_the_stop(word: int, state: State, cycles: int) -> None:
    """Its PDOs are lost, so it keeps showing its last state."""
    bench = Bench()
    bench.step(OFF, cycles=3)
    if state is State.OPERATION_ENABLED:
        bench.step(ON, cycles=10)
    elif state is State.SWITCHED_ON:
        bench.step(ON & ~0x8, cycles=2)
    assert bench.drive.state is state
    statusword = bench.drive.feedback.statusword
    for asked in [word] * cycles + [ON] * 20:
        bench.now += 4_000_000
        bench.drive.feedback.statusword = statusword
        bench.stepper.step((asked, 0x2000), bench.drive.feedback, True, bench.now)
        assert not bench.controlword & ControlBit.SWITCH_ON
    assert bench.stepper.reason in {Reason.NEEDS_OFF, Reason.QUICK_STOP}


@pytest.mark.parametrize("word", [0x0000, 0x0002, 0x000B, 0x000D])
def test_telegram_100_stops_without_control_too(word: int) -> None:
    rig = Rig(100)
    rig.values["Controlword"] = 0x06
    rig.step(4)
    assert rig.state is State.READY_TO_SWITCH_ON
    rig.node.start_fault("lost-pdos", every=1)
    statusword = rig.feedback.statusword
    for asked in (word, 0x0F, 0x07, 0x0F):
        rig.values["Controlword"] = asked
        rig.feedback.statusword = statusword
        rig.step(3)
        assert not rig.stepper.command.controlword & ControlBit.SWITCH_ON
    rig.values["Controlword"] = 0x06
    rig.step(1)
    rig.values["Controlword"] = 0x07
    rig.step(1)
    assert rig.stepper.command.controlword == 0x07, "after an OFF it passes again"


def test_lost_drive_gets_a_stop_in_every_cycle_until_it_is_off() -> None:
    bench = turning()
    for _ in range(50):
        bench.drive_ok = False
        bench.step(ON, 0x2000)
        assert bench.controlword & 0xF == 0x2
    machine = bench.stepper.machine
    assert not machine.outputs.known_off
    # The drive was configured again meanwhile and still turns.
    bench.drive_ok = True
    bench.drive.state = State.OPERATION_ENABLED
    bench.drive.show()
    machine.inputs.news.append(Configured(bench.stepper.drive_type))
    bench.stepper.step((ON, 0x2000), bench.drive.feedback, True, bench.now)
    assert bench.controlword & 0xF == 0x2
    assert not machine.outputs.known_off
    bench.step(ON, 0x2000, cycles=60)
    assert machine.outputs.known_off


def test_drive_lost_before_it_shows_operation_may_have_power() -> None:
    bench = Bench()
    bench.step(OFF, cycles=3)
    bench.step(ON & ~0x8, cycles=2)
    assert bench.drive.state is State.SWITCHED_ON
    bench.step(ON)
    assert bench.controlword & 0xF == 0xF
    machine = bench.stepper.machine
    assert machine.outputs.known_off, "the last Statusword is that of Switched On"
    bench.drive_ok = False
    bench.step(ON)
    assert not machine.outputs.known_off


@pytest.mark.parametrize(("word", "controlword"), [(ON, 0x2), (COAST, 0x0)])
def test_a_drive_in_operation_whose_references_become_invalid_is_stopped(word: int, controlword: int) -> None:
    bench = turning()
    bench.stepper.set_references(None)
    bench.step(word, 0x2000)
    assert bench.controlword & 0xF == controlword
    assert bench.stepper.command.target_velocity == 0
    bench.step(word, 0x2000, cycles=60)
    assert bench.drive.state not in {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE}


# -- telegram 9 ---------------------------------------------------------------------------------------------------------


def move(rig: Rig, target: int, **values: int) -> None:
    """An edge of STW1.6 with its data; STW1.6 falls afterwards."""
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(target), **values}
    rig.values["STW1"] |= ACTIVATE
    rig.step(4)
    rig.values["STW1"] &= ~ACTIVATE
    rig.step(2)


def test_an_edge_during_an_intermediate_stop_replaces_the_kept_task() -> None:
    rig = axis()
    move(rig, 300_000)
    rig.step(40)
    rig.values["STW1"] &= ~INTERMEDIATE
    rig.until(lambda _: rig.node.model.velocity_actual == 0)
    move(rig, 10_000)
    stood = position(rig)
    rig.step(50)
    assert position(rig) == stood, "it waits for STW1.5"
    assert rig.stepper.reason is Reason.INTERMEDIATE_STOP
    rig.values["STW1"] |= INTERMEDIATE
    rig.step(2)
    rig.until(reached)
    assert position(rig) == 10_000


def test_a_relative_task_that_replaces_a_kept_one_starts_at_the_actual_position() -> None:
    rig = axis()
    move(rig, 300_000)
    rig.step(40)
    rig.values["STW1"] &= ~INTERMEDIATE
    rig.until(lambda _: rig.node.model.velocity_actual == 0)
    move(rig, -5_000, MDI_MOD=0)
    stood = position(rig)
    rig.values["STW1"] |= INTERMEDIATE
    rig.step(2)
    rig.until(reached)
    assert position(rig) == stood - 5_000


@pytest.mark.parametrize(("bit", "reason"), [(INTERMEDIATE, Reason.INTERMEDIATE_STOP), (REJECT, Reason.REJECTED)])
def test_edge_without_stw1_4_or_5_starts_nothing_and_has_a_reason(bit: int, reason: Reason) -> None:
    rig = axis()
    rig.values["STW1"] &= ~bit
    move(rig, 20_000)
    assert rig.stepper.reason is reason
    rig.values["STW1"] |= bit
    rig.step(100)
    assert position(rig) == 0
    move(rig, 20_000)
    rig.until(reached)
    assert position(rig) == 20_000
    assert rig.stepper.reason is None


@pytest.mark.parametrize("moving", [False, True])
def test_task_with_velocity_0_has_a_reason_until_a_reject_or_new_task(moving: bool) -> None:
    rig = axis()
    if moving:
        move(rig, 300_000)
        rig.step(20)
    move(rig, 20_000, MDI_VELOCITY=0)
    assert rig.stepper.reason is Reason.TASK_SPEED_ZERO
    rig.step(100)
    assert rig.stepper.command.target_position != POSITION.to_value(POSITION.to_wire(20_000))
    assert bool(rig.node.model.velocity_actual) is moving, "what runs goes on"
    rig.values["STW1"] &= ~REJECT
    rig.step(2)
    assert rig.stepper.reason is not Reason.TASK_SPEED_ZERO
    rig.values["STW1"] |= REJECT
    rig.until(lambda _: rig.node.model.velocity_actual == 0)
    rig.step(5)
    assert rig.stepper.reason is None
    move(rig, 20_000, MDI_VELOCITY=1 << 30)
    rig.until(reached)
    assert position(rig) == 20_000


@pytest.mark.parametrize("word", [OFF, ON & ~0x8, None])
@pytest.mark.parametrize("reaction", [PlcLossReaction.RAMP, PlcLossReaction.QUICK_STOP])
def test_uncommanded_operation_in_the_statusword_enables_nothing(word: int | None, reaction: PlcLossReaction) -> None:
    """The ramp of an OFF1 holds power on: on a wrong Statusword it would switch it on."""
    bench = Bench(on_plc_loss=reaction)
    bench.step(OFF, cycles=100)
    assert bench.drive.state is State.READY_TO_SWITCH_ON
    for _ in range(20):
        bench.now += 4_000_000
        bench.drive.feedback.statusword = STATUS_OF[State.OPERATION_ENABLED] | StatusBit.VOLTAGE_ENABLED
        bench.drive.feedback.velocity_actual = 1000
        bench.stepper.step(None if word is None else (word, 0x2000), bench.drive.feedback, True, bench.now)
        assert bench.controlword & 0xF != 0xF
