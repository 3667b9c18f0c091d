"""A Statusword that is late or wrong: a stop switches nothing on and is not weakened, and every command is safe."""

from __future__ import annotations

from itertools import product

import pytest

from pdgw.base.durations import MS
from pdgw.dsp402.states import STATUS_OF, ControlBit, State, StatusBit
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.settings import AxisSettings, ControlLost, PlcLossReaction
from pdgw.gateway.base.reasons import Reason
from tests.support.axis.rig import Rig
from tests.support.axis.stepper import Stepper, step_interlock
from tests.support.drives.drive_types import References

# -- a Statusword older than the last command ---------------------------------------------------------------------


OFF, ON, NO_OPERATION, NO_CONTROL = 0x047E, 0x047F, 0x0477, 0x007F
OFF2, OFF3 = 0x047D, 0x047B
DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE = 0x0, 0x2, 0x6, 0x7, 0xF
LATE = State.OPERATION_ENABLED
NO_STATE = 0x2C


class Control:
    """The interlock of an axis in operation, given one word and one Statusword after another."""

    def __init__(self, reaction: PlcLossReaction = PlcLossReaction.QUICK_STOP) -> None:
        self.power = Interlock(AxisSettings(on_plc_loss=reaction))
        self.now = 0
        for word, state in ((OFF, State.READY_TO_SWITCH_ON), (ON, State.READY_TO_SWITCH_ON), (ON, State.SWITCHED_ON)):
            self.step(word, state)

    def step(self, word: int | None, shown: State | int, *, drive_ok: bool = True) -> int:
        self.now += 4 * MS
        statusword = STATUS_OF[shown] if isinstance(shown, State) else shown
        connected = word is not None
        return step_interlock(self.power, word or 0, statusword, self.now, connected=connected, drive_ok=drive_ok)


def in_operation(reaction: PlcLossReaction = PlcLossReaction.QUICK_STOP) -> Control:
    control = Control(reaction)
    for _ in range(3):
        assert control.step(ON, LATE) == ENABLE
    return control


def test_off_after_disable_operation_sends_shutdown_and_no_ramp() -> None:
    control = in_operation()
    for _ in range(3):
        assert control.step(NO_OPERATION, LATE) == SWITCH_ON
    for _ in range(20):
        assert control.step(OFF, LATE) == SHUTDOWN
    for _ in range(5):
        assert control.step(OFF, State.READY_TO_SWITCH_ON) == SHUTDOWN


def test_short_on_pulse_is_not_ramped_when_operation_shows_later() -> None:
    control = Control()
    assert control.step(OFF, State.SWITCHED_ON) == SHUTDOWN
    for _ in range(5):
        assert control.step(OFF, LATE) == SHUTDOWN, "the answer to the pulse is late"


def test_plc_loss_with_ramp_after_disable_operation_never_enables() -> None:
    control = in_operation(PlcLossReaction.RAMP)
    control.step(NO_OPERATION, LATE)
    for _ in range(10):
        assert control.step(None, LATE) == SHUTDOWN


def test_loss_of_control_after_disable_operation_never_enables() -> None:
    for choice in ControlLost:
        stepper = Stepper(1, AxisSettings(cycle_ns=4 * MS, control_lost=choice))
        stepper.set_references(References())
        feedback, words = stepper.feedback, []
        way = (
            (OFF, State.READY_TO_SWITCH_ON),
            (ON, State.READY_TO_SWITCH_ON),
            (ON, State.SWITCHED_ON),
            (ON, LATE),
            (NO_OPERATION, LATE),
            *((NO_CONTROL, LATE),) * 5,
        )
        for cycle, (word, state) in enumerate(way):
            feedback.statusword = STATUS_OF[state]
            stepper.step((word, 0x2000), feedback, True, (cycle + 1) * 4 * MS)
            words.append(stepper.command.controlword & 0xF)
        assert words == [SHUTDOWN, SWITCH_ON, ENABLE, ENABLE, SWITCH_ON, *(SHUTDOWN,) * 5], choice


def test_operation_long_after_the_last_enable_is_an_unknown_state() -> None:
    control = Control()
    control.step(OFF, State.SWITCHED_ON)
    control.now += AxisSettings().latency_ns
    assert control.step(OFF, LATE) == QUICK_STOP
    assert control.power.reason is Reason.DRIVE_UNKNOWN_STATE


@pytest.mark.parametrize("word", [OFF3, None])
def test_quick_stop_right_after_the_first_enable_lasts_until_the_drive_is_off(word: int | None) -> None:
    control = Control()
    assert control.step(word, State.SWITCHED_ON) == QUICK_STOP, "it may be in operation already"
    for _ in range(3):
        assert control.step(word, State.SWITCHED_ON) == QUICK_STOP
        assert control.step(word, LATE) == QUICK_STOP
    assert control.step(word, State.SWITCH_ON_DISABLED) in {DISABLE_VOLTAGE, QUICK_STOP}


@pytest.mark.parametrize("word", [OFF2, None])
@pytest.mark.parametrize("seen", ["lost", "no state"])
def test_off2_of_a_lost_or_unknown_drive_takes_power_off_and_stays(word: int | None, seen: str) -> None:
    control = in_operation(PlcLossReaction.COAST)
    shown: State | int = NO_STATE if seen == "no state" else LATE
    drive_ok = seen != "lost"
    assert control.step(word, shown, drive_ok=drive_ok) == DISABLE_VOLTAGE
    for later in (ON, OFF3, OFF):
        assert control.step(later, shown, drive_ok=drive_ok) == DISABLE_VOLTAGE, "OFF2 stays"
    assert control.step(OFF, LATE) == DISABLE_VOLTAGE, "until the drive shows that it is off"
    assert control.step(OFF, State.SWITCH_ON_DISABLED) == SHUTDOWN


@pytest.mark.parametrize(("shown", "word"), [(State.FAULT, DISABLE_VOLTAGE), (NO_STATE, QUICK_STOP)])
def test_fault_or_unknown_state_right_after_the_first_enable_locks(shown: State | int, word: int) -> None:
    control = Control()
    assert control.step(ON, shown) == word
    for state in (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON):
        assert control.step(ON, state) in {DISABLE_VOLTAGE, QUICK_STOP}
    assert control.power.reason is Reason.NEEDS_OFF


def test_off3_brakes_a_drive_that_was_enabled_elsewhere() -> None:
    power = Interlock(AxisSettings())
    assert step_interlock(power, OFF3, STATUS_OF[LATE], MS) == QUICK_STOP
    assert step_interlock(power, ON, STATUS_OF[LATE], 2 * MS) == QUICK_STOP, "latched"


@pytest.mark.parametrize("word", [NO_OPERATION, 0x0476])
def test_disable_operation_in_a_ramp_stop_takes_power_off(word: int) -> None:
    control = in_operation()
    assert control.step(OFF, LATE) == ENABLE
    assert control.step(word, LATE) == SHUTDOWN
    assert control.step(OFF, LATE) == SHUTDOWN, "it is not begun again"


@pytest.mark.parametrize("word", [NO_OPERATION, 0x0476, 0x0473])
def test_disable_operation_in_a_quick_stop_takes_power_off(word: int) -> None:
    control = in_operation()
    assert control.step(OFF3, LATE) == QUICK_STOP
    assert control.step(word, State.QUICK_STOP_ACTIVE) == DISABLE_VOLTAGE
    assert control.step(OFF3, State.QUICK_STOP_ACTIVE) == DISABLE_VOLTAGE, "it is not begun again"


@pytest.mark.parametrize(("word", "stop"), [(0x0476, ENABLE), (0x0402, QUICK_STOP), (0x0473, QUICK_STOP)])
def test_stop_that_starts_with_stw1_3_at_0_brakes(word: int, stop: int) -> None:
    control = in_operation()
    for _ in range(5):
        assert control.step(word, LATE) == stop
    assert control.step(word | 0x8, LATE) == stop
    assert control.step(word, LATE) in {DISABLE_VOLTAGE, SHUTDOWN}, "STW1.3 falls during the stop"


def test_a_quick_stop_that_begins_with_stw1_3_at_0_during_a_ramp_stop_brakes() -> None:
    control = in_operation()
    assert control.step(OFF, LATE) == ENABLE
    for _ in range(5):
        assert control.step(0x0473, LATE) == QUICK_STOP
    assert control.step(OFF3, LATE) == QUICK_STOP
    assert control.step(0x0473, LATE) == DISABLE_VOLTAGE, "STW1.3 falls during the quick stop"


@pytest.mark.parametrize(("word", "stop"), [(0x0476, ENABLE), (0x0402, QUICK_STOP), (0x0473, QUICK_STOP)])
def test_a_stop_with_stw1_3_at_0_brakes_after_an_off_with_stw1_3_at_0(word: int, stop: int) -> None:
    control = in_operation()
    assert control.step(ON, State.FAULT) == DISABLE_VOLTAGE
    assert control.step(0x0476, State.SWITCH_ON_DISABLED) == SHUTDOWN
    for state in (State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED):
        control.step(ON, state)
    for _ in range(5):
        assert control.step(word, State.OPERATION_ENABLED) == stop


def zsw1_of(*steps: tuple[int | None, State]) -> tuple[int, int]:
    """ZSW1 and bits 0-3 and 7 of the Controlword after these words and Statuswords."""
    stepper = Stepper(1)
    stepper.set_references(References())
    zsw1 = 0
    for cycle, (word, state) in enumerate(steps):
        stepper.feedback.statusword = STATUS_OF[state] | 0x0400
        setpoints = None if word is None else (word, 0x2000)
        zsw1 = stepper.step(setpoints, stepper.feedback, True, (cycle + 1) * 4 * MS)[0]
    return zsw1, stepper.command.controlword & 0x8F


def test_uncommanded_operation_is_not_shown_to_the_plc() -> None:
    zsw1, controlword = zsw1_of((OFF, State.NOT_READY_TO_SWITCH_ON), (None, State.OPERATION_ENABLED))
    assert controlword == QUICK_STOP
    assert not zsw1 & 0x0404, "neither operation nor speed reached"


def test_acknowledge_without_control_does_not_reach_the_drive() -> None:
    acknowledging = OFF | 0x80
    way = ((OFF, State.SWITCH_ON_DISABLED), (acknowledging, State.QUICK_STOP_ACTIVE))
    _, controlword = zsw1_of(*way, (acknowledging & ~0x400, State.NOT_READY_TO_SWITCH_ON))
    assert not controlword & 0x80


@pytest.mark.parametrize("below", [State.SWITCH_ON_DISABLED, State.NOT_READY_TO_SWITCH_ON])
@pytest.mark.parametrize("wait", [0, 60_000 * MS])
def test_end_of_sto_starts_nothing_while_on_is_kept(below: State, wait: int) -> None:
    control = Control()
    control.step(OFF, below)
    control.now += AxisSettings().latency_ns
    for shown in (below, below):
        assert control.step(ON, shown) == SHUTDOWN
        assert control.power.reason is Reason.INHIBITED, "STO is missing, and an OFF afterwards"
        control.now += wait
    for shown in (State.READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON):
        assert control.step(ON, shown) == DISABLE_VOLTAGE
        assert control.power.reason is Reason.NEEDS_OFF
    assert control.step(OFF, State.READY_TO_SWITCH_ON) == SHUTDOWN
    assert control.step(ON, State.READY_TO_SWITCH_ON) == SWITCH_ON


REMOTE = StatusBit.REMOTE
READY, SWITCHED_ON = STATUS_OF[State.READY_TO_SWITCH_ON], STATUS_OF[State.SWITCHED_ON]


@pytest.mark.parametrize("wait", [0, 60_000 * MS])
@pytest.mark.parametrize("after", [READY, STATUS_OF[State.SWITCH_ON_DISABLED]])
def test_end_of_local_mode_starts_nothing_while_on_is_kept(after: int, wait: int) -> None:
    control = Control()
    for _ in range(2):
        control.step(OFF, READY | REMOTE)
        control.now += AxisSettings().latency_ns
    control.step(OFF, READY)
    for _ in range(3):
        assert control.step(ON, READY) == SHUTDOWN, (
            "a drive that has shown Statusword.9 = 1 without power is in local mode"
        )
        control.now += wait
    control.step(ON, after | REMOTE)
    for shown in (after, READY, READY, SWITCHED_ON):
        assert control.step(ON, shown | REMOTE) in {SHUTDOWN, DISABLE_VOLTAGE}
    assert control.power.reason is Reason.NEEDS_OFF
    assert control.step(OFF, READY | REMOTE) == SHUTDOWN
    assert control.step(ON, READY | REMOTE) == SWITCH_ON


def test_no_word_after_local_mode_starts_a_drive_while_on_is_kept() -> None:
    """Every sequence of five Statuswords after one with Statusword.9 = 0."""
    states = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)
    words = [STATUS_OF[state] | remote for state in states for remote in (0, REMOTE)]
    for shown in product(words, repeat=5):
        control = Control()
        for _ in range(2):
            control.step(OFF, READY | REMOTE)
            control.now += AxisSettings().latency_ns
        control.step(ON, READY)
        assert {control.step(ON, word) for word in shown} <= {DISABLE_VOLTAGE, SHUTDOWN}, shown


@pytest.mark.parametrize("wait", [0, 9_000 * MS])
def test_a_drive_that_never_shows_remote_starts_as_any(wait: int) -> None:
    control = Control()
    for _ in range(2):
        control.step(OFF, READY)
        assert control.step(ON, READY) == SWITCH_ON
        control.now += wait
        assert control.step(ON, SWITCHED_ON) == ENABLE


def test_a_drive_that_shows_remote_with_power_alone_starts_as_any() -> None:
    control = Control()
    for _ in range(3):
        control.step(OFF, READY)
        assert control.step(ON, READY) == SWITCH_ON
        control.now += 9_000 * MS
        assert control.step(ON, READY | REMOTE) == SWITCH_ON, "the bit is shown before the state"
        for shown in (SWITCHED_ON, STATUS_OF[LATE], STATUS_OF[LATE]):
            assert control.step(ON, shown | REMOTE) == ENABLE
        control.step(OFF2, STATUS_OF[LATE] | REMOTE)


def test_a_drive_that_shows_remote_only_from_ready_to_switch_on_starts_as_any() -> None:
    control = Control()
    for _ in range(3):
        control.step(OFF2, STATUS_OF[State.SWITCH_ON_DISABLED])
        for _ in range(3):
            assert control.step(OFF, STATUS_OF[State.SWITCH_ON_DISABLED]) == SHUTDOWN
        for _ in range(3):
            control.now += AxisSettings().latency_ns
            assert control.step(OFF, READY | REMOTE) == SHUTDOWN
        assert control.step(ON, READY | REMOTE) == SWITCH_ON
        assert control.step(ON, SWITCHED_ON | REMOTE) == ENABLE


@pytest.mark.parametrize(("shown", "wait"), [(READY, 10_000 * MS), (READY, 60_000 * MS), (SWITCHED_ON, 10_000 * MS)])
def test_local_mode_from_the_beginning_ends_without_a_start(shown: int, wait: int) -> None:
    """SW.9 that rises when ON has waited longer than any drive needs was local mode."""
    control = Control()
    control.step(OFF, READY)
    assert control.step(ON, READY) == SWITCH_ON
    control.now += wait
    for _ in range(2):
        assert control.step(ON, shown | REMOTE) in {SHUTDOWN, DISABLE_VOLTAGE}
    assert control.step(ON, READY | REMOTE) == DISABLE_VOLTAGE
    assert control.power.reason is Reason.NEEDS_OFF


def test_short_off_starts_a_drive_that_shows_ready_within_the_latency() -> None:
    control = Control()
    control.step(OFF2, State.SWITCH_ON_DISABLED)
    control.step(OFF, State.SWITCH_ON_DISABLED)
    for _ in range(AxisSettings().latency_ns // (4 * MS) - 1):
        assert control.step(ON, State.SWITCH_ON_DISABLED) == SHUTDOWN
    assert control.step(ON, State.READY_TO_SWITCH_ON) == SWITCH_ON


@pytest.mark.parametrize(("word", "sent"), [(OFF2, DISABLE_VOLTAGE), (OFF3, QUICK_STOP), (None, DISABLE_VOLTAGE)])
def test_stop_of_an_inhibited_drive_locks(word: int | None, sent: int) -> None:
    control = Control()
    control.step(OFF, State.SWITCH_ON_DISABLED)
    control.now += AxisSettings().latency_ns
    control.step(ON, State.SWITCH_ON_DISABLED)
    assert control.step(word, State.SWITCH_ON_DISABLED) == sent
    assert control.step(ON, State.READY_TO_SWITCH_ON) == DISABLE_VOLTAGE


# -- a Statusword that may be wrong -------------------------------------------------------------------------------


def refresh(rig: Rig) -> None:
    """The PDOs are sent again although nothing changed, as the drive client does it every 100 ms."""
    rig._sent.clear()


def test_drive_in_operation_after_an_unknown_state_is_braked() -> None:
    control = in_operation()
    assert control.step(ON, NO_STATE) == QUICK_STOP
    assert control.power.reason is Reason.DRIVE_UNKNOWN_STATE
    for _ in range(5):
        assert control.step(ON, State.OPERATION_ENABLED) == QUICK_STOP
    assert control.power.reason is Reason.NEEDS_OFF
    assert control.step(ON, State.QUICK_STOP_ACTIVE) == QUICK_STOP


def test_drive_in_operation_after_a_short_loss_is_braked() -> None:
    control = in_operation()
    assert control.step(ON, State.OPERATION_ENABLED, drive_ok=False) == QUICK_STOP
    assert control.step(ON, State.OPERATION_ENABLED) == QUICK_STOP
    assert control.step(ON, State.SWITCH_ON_DISABLED) == DISABLE_VOLTAGE


@pytest.mark.parametrize("word", [OFF, ON, OFF3])
def test_quick_stop_continues_after_a_restart_of_the_drive(word: int) -> None:
    control = in_operation()
    assert control.step(OFF3, State.OPERATION_ENABLED) == QUICK_STOP
    control.power.restarted()
    for _ in range(5):
        assert control.step(word, State.OPERATION_ENABLED) == QUICK_STOP
    assert control.step(ON, State.SWITCH_ON_DISABLED) == DISABLE_VOLTAGE


def test_a_statusword_that_leaves_operation_by_itself_may_be_wrong() -> None:
    control = in_operation()
    assert [control.step(ON, s) for s in (State.SWITCHED_ON, State.OPERATION_ENABLED, State.SWITCHED_ON)] == [
        QUICK_STOP
    ] * 3
    assert control.power.reason is Reason.NEEDS_OFF
    assert control.step(OFF, State.SWITCHED_ON) == SHUTDOWN


def test_coast_stop_has_priority_over_an_unknown_state() -> None:
    control = in_operation()
    control.step(ON, NO_STATE)
    assert control.step(OFF2, State.OPERATION_ENABLED) == DISABLE_VOLTAGE


def test_without_a_plc_configured_coast_has_priority_over_an_unknown_state() -> None:
    control = in_operation(PlcLossReaction.COAST)
    control.step(ON, State.OPERATION_ENABLED, drive_ok=False)
    assert control.step(None, State.OPERATION_ENABLED) == DISABLE_VOLTAGE


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
    rig.node.start_fault("lost-pdos", every=1)
    rig.step()
    rig.feedback.statusword = 0x0637
    rig.node.end_fault()
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
    rig.node.start_fault("lost-pdos", every=1)
    rig.step(3)
    rig.node.end_fault()
    rig.connected_drive = True
    refresh(rig)
    rig.step()
    assert rig.state is State.QUICK_STOP_ACTIVE
    assert rig.controlwords[-1] == QUICK_STOP
    rig.step(50)
    assert rig.state is State.SWITCH_ON_DISABLED


def test_homing_without_homing_attained_is_reported_and_aborted() -> None:
    rig = Rig(9)
    rig.node.start_fault("no-homing-attained")
    rig.values |= {"SATZANW": 35, "MDI_VELOCITY": 0x1000}
    rig.enable()
    rig.values["STW1"] |= 0x0800
    rig.until(lambda _: rig.stepper.reason is Reason.HOMING_ERROR)
    rig.step(2)
    assert rig.stepper.numbers == [109]
    assert "standstill without Statusword.12" in rig.stepper.events[0].text
    assert rig.actuals["ZSW1"] & 0x0880 == 0x0080, "warning, no home position"
    assert rig.stepper.reason is Reason.HOMING_ERROR
    rig.node.end_fault()
    rig.values["STW1"] &= ~0x0800
    rig.step(4)
    assert not rig.actuals["ZSW1"] & 0x0880
