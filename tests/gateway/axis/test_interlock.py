"""The interlock where two things happen at once: losses, refusals and acknowledges that must not start the drive."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.base.durations import MS
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.states import STATUS_OF, ControlBit, State
from pdgw.gateway.axis.demand_report import PowerWish
from pdgw.gateway.axis.interlock import QUICK_STOP_STANDING_NS, Interlock
from pdgw.gateway.axis.power_states import Phase
from pdgw.gateway.axis.settings import AxisSettings, PlcLossReaction
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from pdgw.gateway.base.reasons import Reason
from tests.gateway.axis.test_velocity import OFF, ON, Bench
from tests.support.axis.stepper import Stepper, step_interlock
from tests.support.drives.drive_types import References

COMMANDS = range(16)
POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
FAULTS = (State.FAULT, State.FAULT_REACTION_ACTIVE)

DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE = 0x0, 0x2, 0x6, 0x7, 0xF


def power(state: State, *, after_off: bool, settings: AxisSettings | None = None) -> Interlock:
    """Power control of a connected PLC whose drive is in a state, before or after the OFF that unlocks it."""
    control = Interlock(settings or AxisSettings())
    step(control, 0x400, State.SWITCH_ON_DISABLED)
    if after_off:
        step(control, OFF, State.SWITCH_ON_DISABLED)
        if state not in FAULTS and state is not State.SWITCH_ON_DISABLED:
            step(control, ON, State.READY_TO_SWITCH_ON)
            if state in POWERED or state is State.SWITCHED_ON:
                step(control, ON, State.SWITCHED_ON)
            if state in POWERED:
                step(control, ON, State.OPERATION_ENABLED)
    return control


def step(control: Interlock, word: int, state: State, now: int = MS) -> int:
    return step_interlock(control, word, STATUS_OF[state], now)


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("command", COMMANDS)
def test_before_an_off_no_command_reaches_any_state(state: State, command: int) -> None:
    control = power(state, after_off=False)
    word = step(control, 0x470 | command, state)
    is_off = command & 0x7 == 0x6
    if is_off and state not in POWERED and state not in FAULTS:
        assert word == SHUTDOWN
    elif state is State.QUICK_STOP_ACTIVE and command & 0x2:
        assert word == QUICK_STOP, "a quick stop that runs is not cut short"
    elif command & 0x6 == 0x2 and state not in FAULTS:
        assert word == QUICK_STOP, "as it is asked, also of a drive that nobody here enabled"
    else:
        assert word == DISABLE_VOLTAGE
    assert not word & ControlBit.SWITCH_ON


def expected_controlword(state: State, command: int) -> int:
    """The command table of docs/translation.md, read in the order of its priorities."""
    if state in FAULTS:
        return 0
    if not command & 0x2:
        return DISABLE_VOLTAGE
    if not command & 0x4 or state is State.QUICK_STOP_ACTIVE:
        return QUICK_STOP
    if state is State.OPERATION_ENABLED:
        if not command & 0x1:
            return ENABLE  # OFF1: ramp stop with power on
        return ENABLE if command & 0x8 else SWITCH_ON
    if not command & 0x1 or state in {State.SWITCH_ON_DISABLED, State.NOT_READY_TO_SWITCH_ON}:
        return SHUTDOWN
    return ENABLE if command & 0x8 and state is State.SWITCHED_ON else SWITCH_ON


@pytest.mark.parametrize("state", [s for s in State if s is not State.NOT_READY_TO_SWITCH_ON])
@pytest.mark.parametrize("command", COMMANDS)
def test_after_an_off_every_command_in_every_state(state: State, command: int) -> None:
    control = power(state, after_off=True)
    assert step(control, 0x470 | command, state) == expected_controlword(state, command)


@pytest.mark.parametrize("resume", [False, True])
def test_active_on_of_a_new_connection_does_not_resume_a_ramp_stop(resume: bool) -> None:
    bench = Bench(on_plc_loss=PlcLossReaction.RAMP, ramp_stop_resume=resume)
    bench.operate(0x2000)
    bench.drive.ramp = 100
    bench.step(ON, 0x2000, cycles=40)
    bench.step(None, cycles=2)
    assert bench.drive.feedback.velocity_actual > 60
    bench.step(ON, 0x2000, cycles=200)
    assert bench.drive.state is not State.OPERATION_ENABLED
    assert bench.drive.feedback.velocity_actual == 0
    assert bench.stepper.reason is Reason.NEEDS_OFF


def test_an_off_of_the_new_connection_allows_the_configured_resume() -> None:
    bench = Bench(on_plc_loss=PlcLossReaction.RAMP, ramp_stop_resume=True)
    bench.operate(0x2000)
    bench.drive.ramp = 100
    bench.step(ON, 0x2000, cycles=40)
    bench.step(None, cycles=2)
    bench.step(OFF, 0x2000, cycles=2)
    bench.step(ON, 0x2000, cycles=2)
    assert bench.drive.state is State.OPERATION_ENABLED
    assert bench.controlword & 0xF == 0xF
    assert bench.stepper.reason is None


LOSSES = (
    (PlcLossReaction.RAMP, PowerWish.NO_PLC_RAMP, ENABLE),
    (PlcLossReaction.QUICK_STOP, PowerWish.NO_PLC_QUICK_STOP, QUICK_STOP),
    (PlcLossReaction.COAST, PowerWish.NO_PLC_COAST, DISABLE_VOLTAGE),
)
"""Each reaction to a loss, the stop of an uncounted frame that equals it, and its Controlword; the weakest first."""


def lost(reaction: PlcLossReaction, wish: PowerWish, *, acknowledge: bool = False) -> Interlock:
    """An axis in operation whose PLC is lost, with a frame of this ``wish``."""
    control = power(State.OPERATION_ENABLED, after_off=True, settings=AxisSettings(on_plc_loss=reaction))
    control.step(wish, acknowledge, None, STATUS_OF[State.OPERATION_ENABLED], standstill=False, now=2 * MS)
    return control


@pytest.mark.parametrize("configured", range(3))
@pytest.mark.parametrize("asked", range(3))
def test_stronger_one_of_configured_and_requested_stop_wins_after_a_loss(configured: int, asked: int) -> None:
    control = lost(LOSSES[configured][0], LOSSES[asked][1])
    assert control.controlword == LOSSES[max(configured, asked)][2]


@pytest.mark.parametrize(("reaction", "wish", "controlword"), LOSSES)
def test_acknowledge_without_a_plc_does_not_reach_the_drive(
    reaction: PlcLossReaction, wish: PowerWish, controlword: int
) -> None:
    assert lost(reaction, wish, acknowledge=True).controlword == controlword


def test_new_connection_with_stw1_3_off_continues_the_ramp_of_a_loss() -> None:
    """Without a PLC, STW1.3 is not 1: only its fall during a stop disables the drive."""
    control = lost(PlcLossReaction.RAMP, PowerWish.NO_PLC_RAMP)
    assert step(control, OFF & ~0x8, State.OPERATION_ENABLED) == ENABLE


@pytest.mark.parametrize("word", [OFF & ~0x400, 0x0007])
def test_a_ramp_stop_without_control_is_not_resumed_without_an_off(word: int) -> None:
    """STW1.10 = 0 is a loss of the PLC's control: the OFF of before does not count."""
    bench = Bench(ramp_stop_resume=True)
    bench.operate(0x2000)
    bench.drive.ramp = 100
    bench.step(ON, 0x2000, cycles=40)
    bench.step(word, cycles=2)
    assert bench.drive.feedback.velocity_actual > 60
    bench.step(ON, 0x2000, cycles=200)
    assert bench.drive.state is not State.OPERATION_ENABLED
    assert bench.stepper.reason is Reason.NEEDS_OFF


def raw_step(number: int, stepper: object, feedback: DriveFeedback, word: int | None, now: int) -> int:
    half = stepper.telegram.setpoints
    values = None if word is None else half.from_dict({half.names[0]: word})
    stepper.step(values, feedback, True, now)
    return int(stepper.command.controlword)


@pytest.mark.parametrize("number", [1, 2, 3, 9, 20])
@pytest.mark.parametrize("returns_with_control", [True, False])
def test_a_connection_that_changed_while_the_references_were_invalid_needs_its_own_off(
    number: int, returns_with_control: bool
) -> None:
    stepper = Stepper(number, AxisSettings())
    stepper.set_references(References())
    feedback = DriveFeedback()
    feedback.statusword = STATUS_OF[State.READY_TO_SWITCH_ON]
    raw_step(number, stepper, feedback, OFF, 1)
    stepper.set_references(replace(References(), max_motor_speed=0))
    assert raw_step(number, stepper, feedback, ON, 2) == 0
    assert stepper.numbers == [104]
    assert stepper.reason is Reason.REFERENCE_INVALID
    raw_step(number, stepper, feedback, None, 3)
    raw_step(number, stepper, feedback, ON if returns_with_control else 0x007F, 4)
    stepper.set_references(References())
    if not returns_with_control:
        raw_step(number, stepper, feedback, 0x007F, 5)
    for now in range(6, 10):
        assert not raw_step(number, stepper, feedback, ON, now) & ControlBit.SWITCH_ON
    assert stepper.reason is Reason.NEEDS_OFF


def test_short_disable_operation_is_kept_until_the_drive_confirms_it() -> None:
    """Disable Operation for one cycle of the PLC; long after it the enable input of the drive drops."""
    control = power(State.OPERATION_ENABLED, after_off=True)
    assert step(control, 0x477, State.OPERATION_ENABLED, 1 * MS) == SWITCH_ON
    for cycle in range(2, 50):
        assert step(control, ON, State.OPERATION_ENABLED, cycle * MS) == SWITCH_ON, "it may have left already"
    assert step(control, ON, State.SWITCHED_ON, 50 * MS) == ENABLE
    for cycle in range(51, 2000):
        assert step(control, ON, State.OPERATION_ENABLED, cycle * MS) == ENABLE
    word = step(control, ON, State.SWITCHED_ON, 2000 * MS)
    assert control.phase is Phase.UNCONFIRMED
    assert not word & ControlBit.SWITCH_ON
    assert control.reason is Reason.NEEDS_OFF


def test_late_confirmation_of_a_short_disable_operation_is_not_a_fault() -> None:
    control = power(State.OPERATION_ENABLED, after_off=True)
    step(control, 0x477, State.OPERATION_ENABLED, 1 * MS)
    step(control, ON, State.OPERATION_ENABLED, 5 * MS)
    assert step(control, ON, State.SWITCHED_ON, 9 * MS) == ENABLE
    assert control.phase is Phase.FOLLOW


def test_acknowledge_in_operation_reaches_the_drive_while_it_is_set() -> None:
    control = power(State.OPERATION_ENABLED, after_off=True)
    words = [step(control, word, State.OPERATION_ENABLED) for word in (ON, ON, ON | 0x80, ON | 0x80, ON, ON)]
    assert words == [ENABLE, ENABLE, *[ENABLE | ControlBit.FAULT_RESET] * 2, ENABLE, ENABLE]


def test_acknowledge_set_since_the_start_needs_a_new_edge() -> None:
    control = Interlock(AxisSettings())
    words = [
        step(control, word | 0x80, state)
        for word, state in (
            (OFF, State.SWITCH_ON_DISABLED),
            (ON, State.READY_TO_SWITCH_ON),
            (ON, State.SWITCHED_ON),
            (ON, State.OPERATION_ENABLED),
            (ON, State.OPERATION_ENABLED),
        )
    ]
    assert words == [SHUTDOWN, SWITCH_ON, ENABLE, ENABLE, ENABLE]
    for _ in range(3):
        assert step(control, ON, State.OPERATION_ENABLED) == ENABLE
    assert step(control, ON | 0x80, State.OPERATION_ENABLED) == ENABLE | ControlBit.FAULT_RESET


def test_enable_confirmed_within_a_long_cycle_counts_as_commanded() -> None:
    control = power(State.SWITCHED_ON, after_off=True)
    long_after = MS + 2 * AxisSettings().latency_ns
    assert step(control, OFF, State.OPERATION_ENABLED, long_after) == ENABLE, "OFF1: it ramps down"
    assert control.phase is Phase.RAMP_STOP


def test_quick_stop_ends_after_the_standstill_time_and_not_at_a_zero_crossing() -> None:
    control, began = power(State.OPERATION_ENABLED, after_off=True), 10**10

    def stopping(standstill: bool, now: int) -> int:
        control.step(PowerWish.QUICK_STOP, False, None, STATUS_OF[State.QUICK_STOP_ACTIVE], standstill, now)
        return control.controlword

    step(control, ON & ~0x4, State.OPERATION_ENABLED, began)
    half = QUICK_STOP_STANDING_NS // 2
    for part, standstill in enumerate((False, True, False, True, True)):
        assert stopping(standstill, began + part * half) == QUICK_STOP
    assert stopping(True, began + 5 * half) == DISABLE_VOLTAGE


def test_standstill_of_a_quick_stop_begins_again_after_operation() -> None:
    control, began = power(State.OPERATION_ENABLED, after_off=True), 10**10
    stopping = State.QUICK_STOP_ACTIVE
    for part, state in enumerate((stopping, stopping, State.OPERATION_ENABLED, stopping)):
        control.step(PowerWish.QUICK_STOP, False, None, STATUS_OF[state], True, began + part * QUICK_STOP_STANDING_NS)
        assert control.controlword == QUICK_STOP


def raw(control: Interlock, wish: PowerWish, state: State, now: int) -> int:
    control.step(wish, False, None, STATUS_OF[state], False, now)
    return control.controlword


def raw_operation() -> Interlock:
    """In operation for 400 ms by the Controlword of telegram 100."""
    control = Interlock(AxisSettings())
    raw(control, PowerWish.RAW_OFF, State.READY_TO_SWITCH_ON, 0)
    for cycle in range(100):
        raw(control, PowerWish.ENABLE, State.OPERATION_ENABLED, cycle * 4 * MS)
        assert control.phase is Phase.PASS
    return control


def test_raw_controlword_is_blocked_after_the_drive_left_operation() -> None:
    control = raw_operation()
    assert raw(control, PowerWish.ENABLE, State.SWITCHED_ON, 400 * MS) == QUICK_STOP
    assert control.phase is Phase.UNCONFIRMED
    assert raw(control, PowerWish.ENABLE, State.OPERATION_ENABLED, 404 * MS) == QUICK_STOP


def test_raw_disable_operation_does_not_lock() -> None:
    control = raw_operation()
    for cycle, (wish, state) in enumerate(
        (
            (PowerWish.ON, State.OPERATION_ENABLED),
            (PowerWish.ON, State.SWITCHED_ON),
            (PowerWish.ENABLE, State.SWITCHED_ON),
            (PowerWish.ENABLE, State.OPERATION_ENABLED),
        )
    ):
        raw(control, wish, state, (400 + 4 * cycle) * MS)
        assert control.phase is Phase.PASS


@pytest.mark.parametrize("number", DRIVE_TELEGRAM_NUMBERS)
def test_acknowledge_set_before_an_outage_of_references_is_not_an_edge(number: int) -> None:
    stepper = Stepper(number)
    feedback = DriveFeedback()
    feedback.statusword = STATUS_OF[State.FAULT]
    stepper.set_references(References())
    ack_free, ack = (0x0000, 0x0080) if number == 100 else (0x0400, 0x0480)
    raw_step(number, stepper, feedback, ack_free, 1)
    stepper.set_references(None)
    raw_step(number, stepper, feedback, None, 2)
    raw_step(number, stepper, feedback, ack, 3)
    stepper.set_references(References())
    assert raw_step(number, stepper, feedback, ack, 4) == 0
    raw_step(number, stepper, feedback, ack_free, 5)
    assert raw_step(number, stepper, feedback, ack, 6) == ControlBit.FAULT_RESET


@pytest.mark.parametrize("number", DRIVE_TELEGRAM_NUMBERS)
def test_axis_without_references_stops_with_every_telegram(number: int) -> None:
    stepper = Stepper(number)
    feedback = DriveFeedback()
    stepper.set_references(References())
    off, on = (0x06, 0x0F) if number == 100 else (OFF, ON)
    for now, (word, state) in enumerate(
        (
            (off, State.READY_TO_SWITCH_ON),
            (on, State.READY_TO_SWITCH_ON),
            (on, State.SWITCHED_ON),
            (on, State.OPERATION_ENABLED),
        )
    ):
        feedback.statusword = STATUS_OF[state]
        commanded = raw_step(number, stepper, feedback, word, now)
    assert commanded & 0xF == ENABLE
    feedback.position_actual, feedback.velocity_actual = 12345, 300
    stepper.set_references(None)
    assert raw_step(number, stepper, feedback, on, 4) & 0xF == QUICK_STOP
    assert stepper.command.target_velocity == stepper.command.velocity_offset == 0
    assert stepper.reason is Reason.REFERENCE_INVALID


def test_telegram_100_reports_an_unsupported_mode_as_long_as_it_is_set() -> None:
    stepper = Stepper(100, AxisSettings())
    stepper.set_references(References())
    feedback = DriveFeedback()
    feedback.statusword = STATUS_OF[State.OPERATION_ENABLED]
    half = stepper.telegram.setpoints
    for word, mode, reason in ((0x06, 3, None), (0x0F, 7, Reason.MODE_VALUE), (0x0F, 3, None)):
        for now in range(3):
            values = half.from_dict({"Controlword": word, "Modes of Operation": mode})
            feedback.statusword = STATUS_OF[State.READY_TO_SWITCH_ON if word == 0x06 else State.OPERATION_ENABLED]
            stepper.step(values, feedback, True, now)
            if word == 0x0F:
                assert stepper.reason is reason
