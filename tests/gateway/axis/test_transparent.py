"""Telegram 100: unchanged values, the range check and the interlock of a connection."""

from __future__ import annotations

import pytest
from hypothesis import given

from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import STATE_BITS, Command, ControlBit, State, state_of
from pdgw.gateway.axis.adapters.transparent import ACTUAL_ATTRIBUTES, SETPOINT_ATTRIBUTES
from pdgw.gateway.axis.settings import AxisSettings, PlcLossReaction
from pdgw.gateway.base.reasons import Reason
from pdgw.peers.drive.objects import OBJECTS, TURNTABLE
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.rig import Rig
from tests.support.axis.stepper import Stepper
from tests.support.axis.strategies import half_values
from tests.support.drives.drive_types import References

HALF = telegram(100).setpoints


def axis(**settings: object) -> Rig:
    rig = Rig(100, **settings)
    rig.values |= {"Modes of Operation": 3, "Profile Acceleration": 1000, "Profile Deceleration": 1000}
    return rig


def operating(**settings: object) -> Rig:
    """An axis that the PLC's own Controlwords have switched on."""
    rig = axis(**settings)
    for word in (0x06, 0x07, 0x0F):
        rig.values["Controlword"] = word
        rig.step(2)
    assert rig.stepper.reason is None
    return rig


def test_attributes_match_the_telegrams_signals() -> None:
    for names, half in ((SETPOINT_ATTRIBUTES, HALF), (ACTUAL_ATTRIBUTES, telegram(100).actuals)):
        for attribute, item in list(zip(names, half.signals, strict=True))[2:]:
            entry = OBJECTS.attribute(attribute)
            assert entry.type.bits == item.type.size * 8, item.name
            assert entry.type.char.upper() == item.type.char.upper(), item.name


@given(values=half_values(HALF))
def test_values_pass_unchanged_or_limited_to_the_object(values: tuple[int, ...]) -> None:
    stepper = Stepper(100, AxisSettings())
    stepper.set_references(References())
    feedback = DriveFeedback()
    feedback.statusword = 0x0240
    off = (0x0006, *values[1:])
    stepper.step(off, feedback, True, 1)
    stepper.step(values, feedback, True, 2)
    # OFF2 and OFF3 lock, everything else passes.
    word = values[0]
    stopped = (word & ControlBit.FAULT_RESET) | (word & ControlBit.ENABLE_VOLTAGE)
    assert stepper.command.controlword == (word if word & 0x6 == 0x6 else stopped)
    for attribute, value in list(zip(SETPOINT_ATTRIBUTES, values, strict=True))[2:]:
        low, high = OBJECTS.attribute(attribute).limits
        assert getattr(stepper.command, attribute) == min(max(value, low), high)


def test_actual_values_pass_unchanged() -> None:
    stepper = Stepper(100, AxisSettings())
    stepper.set_references(References())
    feedback = DriveFeedback()
    for number, name in enumerate(ACTUAL_ATTRIBUTES):
        setattr(feedback, name, number + 1)
    feedback.modes_of_operation_display = TURNTABLE.mode
    assert list(stepper.step(None, feedback, True, 1)) == [1, 0xFB, *range(3, 13)]


def test_enable_and_run_by_the_plcs_own_controlwords() -> None:
    rig = operating()
    rig.values["Target Velocity"] = 1000
    rig.until(lambda actuals: actuals["Velocity Actual Value"] == 1000)
    assert rig.actuals["Modes of Operation Display"] == 3


@pytest.mark.parametrize("mode", [2, 7, 0x80, 0x7F])
def test_an_unknown_mode_is_not_passed_on(mode: int) -> None:
    rig = axis()
    rig.step(2)
    rig.values["Modes of Operation"] = mode
    rig.step(1)
    assert rig.stepper.command.modes_of_operation == Mode.VELOCITY


def test_a_standing_on_of_a_new_connection_is_not_passed() -> None:
    rig = axis()
    rig.values["Controlword"] = 0x0F
    rig.step(5)
    assert rig.stepper.command.controlword == 0
    assert rig.stepper.reason is Reason.NEEDS_OFF


@pytest.mark.parametrize("reaction", list(PlcLossReaction))
def test_loss_of_the_plc_stops_the_drive_and_a_standing_on_does_not_restart_it(reaction: PlcLossReaction) -> None:
    rig = operating(on_plc_loss=reaction)
    rig.values["Target Velocity"] = 4000
    rig.step(400)
    rig.step(2, plc=False)
    rig.step(800)
    assert rig.node.model.velocity_actual == 0
    assert rig.state is not State.OPERATION_ENABLED
    assert rig.stepper.reason is Reason.NEEDS_OFF


def test_a_standing_on_does_not_start_after_a_fault_reset() -> None:
    rig = operating()
    rig.node.model.inject(7)
    rig.step(5)
    assert rig.state is State.FAULT
    assert rig.actuals["Error Code"] == 7
    rig.node.model.clear()
    rig.values["Controlword"] = 0x0F
    rig.step(2)
    rig.values["Controlword"] = 0x8F
    rig.step(3)
    rig.values["Controlword"] = 0x0F
    rig.step(10)
    assert rig.state is State.SWITCH_ON_DISABLED


def test_ramp_after_plc_loss_removes_torque_in_a_mode_without_halt() -> None:
    rig = operating(on_plc_loss=PlcLossReaction.RAMP)
    rig.values |= {"Target Velocity": 4000, "Target Torque": 400}
    rig.step(100)
    command = rig.stepper.command
    assert command.target_torque == 400
    rig.step(1, plc=False)
    assert (command.target_torque, command.controlword & ControlBit.HALT) == (0, ControlBit.HALT)


def test_ramp_after_plc_loss_sets_halt_and_speed_0_until_the_plc_is_back() -> None:
    rig = operating(on_plc_loss=PlcLossReaction.RAMP)
    rig.values["Target Velocity"] = 4000
    rig.step(100)
    rig.step(1, plc=False)
    command = rig.stepper.command
    assert (command.target_velocity, command.controlword & ControlBit.HALT) == (0, ControlBit.HALT)
    rig.step(800, plc=False)
    rig.values["Controlword"] = 0x06
    rig.step(2)
    assert command.target_velocity == 4000


def test_a_plc_that_returns_during_the_ramp_after_its_loss_changes_no_value_before_the_end() -> None:
    rig = operating(on_plc_loss=PlcLossReaction.RAMP)
    rig.values["Target Velocity"] = 4000
    rig.step(400)
    rig.step(1, plc=False)
    rig.values |= {"Modes of Operation": 1, "Profile Deceleration": 1, "Target Position": 10_000}
    command = rig.stepper.command
    rig.step(20)
    assert command.controlword & ControlBit.HALT
    assert (command.modes_of_operation, command.profile_deceleration, command.target_position) == (3, 1000, 0)
    rig.step(800)
    assert rig.state is not State.OPERATION_ENABLED
    assert (command.modes_of_operation, command.profile_deceleration, command.target_position) == (1, 1, 10_000)


@pytest.mark.parametrize(("mode", "reason"), [(2, Reason.MODE_VALUE), (0, None), (3, None), (1, None)])
def test_unsupported_mode_is_the_reason_and_0_means_no_mode(mode: int, reason: Reason | None) -> None:
    rig = operating()
    rig.values["Modes of Operation"] = mode
    for _ in range(3):
        rig.step(1)
        assert rig.stepper.reason is reason
    assert rig.stepper.command.modes_of_operation == (1 if mode == 1 else 3)
    rig.values["Modes of Operation"] = 3
    rig.step(1)
    assert rig.stepper.reason is None


def test_lost_drive_shows_a_fault_and_its_last_values() -> None:
    rig = operating()
    before = rig.step(1)
    rig.connected_drive = False
    shown = rig.step(1)
    assert state_of(shown["Statusword"]) is State.FAULT
    kept = 0xFFFF & ~STATE_BITS
    assert shown["Statusword"] & kept == before["Statusword"] & kept
    assert shown["Modes of Operation Display"] == 3


def test_without_references_the_plcs_controlword_does_not_pass_and_the_drives_values_do() -> None:
    rig = operating()
    rig.stepper.set_references(None)
    rig.step(1)
    assert rig.stepper.command.controlword == Command.QUICK_STOP.word
    rig.step(50)
    assert state_of(rig.actuals["Statusword"]) is State.SWITCH_ON_DISABLED
