"""A drive whose word is not to be trusted: what it is sent is safe whether the word is right or wrong."""

from __future__ import annotations

import pytest

from pdgw.dsp402.states import STATUS_OF, ControlBit, State
from pdgw.durations import MS
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.settings import AxisSettings, PlcLossReaction
from pdgw.gateway.reasons import Reason
from tests.support.axis.rig import Rig
from tests.support.axis.stepper import step_interlock

OFF, ON = 0x047E, 0x047F
COAST, OFF3 = ON & ~0x2, ON & ~0x4
QUICK_STOP, DISABLE_VOLTAGE, SHUTDOWN = 0x2, 0x0, 0x6
NO_STATE = 0x2C


def refresh(rig: Rig) -> None:
    """The PDOs are sent again although nothing changed, as the drive client does it every 100 ms."""
    rig._sent.clear()


class Control:
    """Power control of an axis in operation, given one Statusword after another."""

    def __init__(self, reaction: PlcLossReaction = PlcLossReaction.QUICK_STOP) -> None:
        self.power = Interlock(AxisSettings(on_plc_loss=reaction))
        self.now = 0
        self.step(0x400, State.SWITCH_ON_DISABLED)
        self.step(OFF, State.READY_TO_SWITCH_ON)
        for state in (State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED):
            assert self.step(ON, state) != QUICK_STOP

    def step(self, word: int, shown: State | int, *, connected: bool = True, drive_ok: bool = True) -> int:
        self.now += 4 * MS
        statusword = STATUS_OF[shown] if isinstance(shown, State) else shown
        return step_interlock(self.power, word, statusword, self.now, connected=connected, drive_ok=drive_ok)


def test_drive_in_operation_after_an_unknown_state_is_braked() -> None:
    control = Control()
    assert control.step(ON, NO_STATE) == QUICK_STOP
    assert control.power.reason is Reason.DRIVE_UNKNOWN_STATE
    for _ in range(5):
        assert control.step(ON, State.OPERATION_ENABLED) == QUICK_STOP
    assert control.power.reason is Reason.NEEDS_OFF
    assert control.step(ON, State.QUICK_STOP_ACTIVE) == QUICK_STOP


def test_drive_in_operation_after_a_short_loss_is_braked() -> None:
    control = Control()
    assert control.step(ON, State.OPERATION_ENABLED, drive_ok=False) == QUICK_STOP
    assert control.step(ON, State.OPERATION_ENABLED) == QUICK_STOP
    assert control.step(ON, State.SWITCH_ON_DISABLED) == DISABLE_VOLTAGE


@pytest.mark.parametrize("word", [OFF, ON, OFF3])
def test_quick_stop_continues_after_a_restart_of_the_drive(word: int) -> None:
    control = Control()
    assert control.step(OFF3, State.OPERATION_ENABLED) == QUICK_STOP
    control.power.restarted()
    for _ in range(5):
        assert control.step(word, State.OPERATION_ENABLED) == QUICK_STOP
    assert control.step(ON, State.SWITCH_ON_DISABLED) == DISABLE_VOLTAGE


def test_a_statusword_that_leaves_operation_by_itself_may_be_wrong() -> None:
    control = Control()
    assert [control.step(ON, s) for s in (State.SWITCHED_ON, State.OPERATION_ENABLED, State.SWITCHED_ON)] == [
        QUICK_STOP
    ] * 3
    assert control.power.reason is Reason.NEEDS_OFF
    assert control.step(OFF, State.SWITCHED_ON) == SHUTDOWN


def test_coast_stop_has_priority_over_an_unknown_state() -> None:
    control = Control()
    control.step(ON, NO_STATE)
    assert control.step(COAST, State.OPERATION_ENABLED) == DISABLE_VOLTAGE


def test_without_a_plc_configured_coast_has_priority_over_an_unknown_state() -> None:
    control = Control(PlcLossReaction.COAST)
    control.step(ON, State.OPERATION_ENABLED, drive_ok=False)
    assert control.step(ON, State.OPERATION_ENABLED, connected=False) == DISABLE_VOLTAGE


@pytest.mark.parametrize("number", [1, 9, 100])
def test_every_telegram_answers_an_unknown_state_with_quick_stop(number: int) -> None:
    rig = Rig(number)
    if number == 100:
        rig.values |= {"Modes of Operation": 3, "Controlword": 0x06}
        rig.step(4)
        for word in (0x07, 0x0F):
            rig.values["Controlword"] = word
            rig.step(4)
        assert rig.state is State.OPERATION_ENABLED
    else:
        rig.enable()
    rig.feedback.statusword = NO_STATE
    # The drive misses the first quick stop, as when the frame is lost.
    rig.node.misbehave("lost-pdos", every=1)
    rig.step()
    rig.feedback.statusword = 0x0637
    rig.node.behave()
    refresh(rig)
    rig.step(40)
    assert rig.state is not State.OPERATION_ENABLED
    after = rig.controlwords[rig.controlwords.index(QUICK_STOP) :]
    assert QUICK_STOP in after
    assert not [word for word in after if word & ControlBit.SWITCH_ON]


def test_transparent_axis_in_operation_without_a_command_is_stopped() -> None:
    rig = Rig(100)
    rig.values |= {"Modes of Operation": 3, "Controlword": 0x06}
    rig.step(4)
    for word in (0x07, 0x0F):
        rig.values["Controlword"] = word
        rig.step(4)
    rig.connected_drive = False
    rig.node.misbehave("lost-pdos", every=1)
    rig.step(3)
    rig.node.behave()
    rig.connected_drive = True
    refresh(rig)
    rig.step()
    assert rig.state is State.QUICK_STOP_ACTIVE
    assert rig.controlwords[-1] == QUICK_STOP
    rig.step(50)
    assert rig.state is State.SWITCH_ON_DISABLED


def test_homing_without_homing_attained_is_reported_and_aborted() -> None:
    rig = Rig(9)
    rig.node.misbehave("no-homing-attained")
    rig.values |= {"SATZANW": 35, "MDI_VELOCITY": 0x1000}
    rig.enable()
    rig.values["STW1"] |= 0x0800
    rig.until(lambda _: rig.stepper.reason is Reason.HOMING_ERROR)
    rig.step(2)
    assert [event.number for event in rig.stepper.events] == [109]
    assert "standstill without Statusword.12" in rig.stepper.events[0].text
    assert rig.actuals["ZSW1"] & 0x0880 == 0x0080, "warning, no home position"
    assert rig.stepper.reason is Reason.HOMING_ERROR
    rig.node.behave()
    rig.values["STW1"] &= ~0x0800
    rig.step(4)
    assert not rig.actuals["ZSW1"] & 0x0880
