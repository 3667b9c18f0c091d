"""Telegrams 1, 2 and 20: the rules of docs/translation.md, row by row."""

from __future__ import annotations

import pytest

from pdgw.base.durations import MS
from pdgw.dsp402.drive_type import VL_RAMP
from pdgw.dsp402.states import STATUS_OF, Command, State, StatusBit
from pdgw.gateway.axis.power_states import Action
from pdgw.gateway.axis.settings import AxisSettings, ControlLost, PlcLossReaction, SetpointEnable
from pdgw.gateway.base.reasons import Reason
from tests.support.axis.stepper import Stepper
from tests.support.drives.drive_types import References, described
from tests.support.drives.plain_drive import PlainDrive

OFF, ON, CONTROL = 0x047E, 0x047F, 0x0400


class Bench:
    """A stepper of telegram ``number`` on a plain drive, stepped by hand."""

    def __init__(self, number: int = 1, references: References | None = None, **settings: object) -> None:
        self.stepper = Stepper(number, AxisSettings(**settings))  # type: ignore[arg-type]
        self.stepper.set_references(references or References())
        self.drive = PlainDrive()
        self.now = 0
        self.drive_ok = True

    def step(self, word: int | None, speed: int = 0, cycles: int = 1) -> int:
        """Cycles with this STW1 (None: no PLC); returns the last ZSW1."""
        zsw1 = 0
        for _ in range(cycles):
            self.now += 4 * MS
            half = self.stepper.telegram.setpoints
            values = None
            if word is not None:
                name = next(n for n in half.names if n.startswith("NSOLL"))
                values = half.from_dict({"STW1": word, name: speed})
            zsw1 = self.stepper.step(values, self.drive.feedback, self.drive_ok, self.now)[0]
            self.drive.step(self.stepper.command)
        return zsw1

    def operate(self, speed: int = 0x2000) -> None:
        self.step(OFF, cycles=3)
        self.step(ON, speed, cycles=10)
        assert self.drive.state is State.OPERATION_ENABLED

    @property
    def controlword(self) -> int:
        return self.stepper.command.controlword


def test_published_example_1500_of_3000_rpm_reaches_the_drive_as_3000_units() -> None:
    bench = Bench()
    bench.operate(0x2000)
    assert bench.stepper.command.target_velocity == 3000


def test_published_example_300_of_3000_rpm_is_shown_as_0666h() -> None:
    bench = Bench()
    bench.drive.feedback.velocity_actual = 600
    actuals = bench.stepper.step((OFF, 0), bench.drive.feedback, True, 1)
    assert actuals[1] == 0x0666


def test_telegram_2_carries_the_speed_as_n4() -> None:
    bench = Bench(2)
    bench.operate(0x2000_0000)
    assert bench.stepper.command.target_velocity == 3000


def test_start_uses_one_transition_at_a_time() -> None:
    bench = Bench()
    words = []
    for word in (OFF, OFF, ON, ON, ON, ON):
        bench.step(word)
        words.append(bench.controlword & 0xF)
    assert words == [0x6, 0x6, 0x7, 0xF, 0xF, 0xF]


STATE_ROWS = {
    State.NOT_READY_TO_SWITCH_ON: 0b0000_0000,
    State.SWITCH_ON_DISABLED: 0b0100_0000,
    State.READY_TO_SWITCH_ON: 0b0000_0001,
    State.SWITCHED_ON: 0b0000_0011,
    State.OPERATION_ENABLED: 0b0000_0111,
    State.QUICK_STOP_ACTIVE: 0b0000_0011,
    State.FAULT_REACTION_ACTIVE: 0b0000_1111,
    State.FAULT: 0b0000_1000,
}


@pytest.mark.parametrize("state", list(State))
def test_state_table_zsw1_bits_0_to_3_and_6(state: State) -> None:
    bench = Bench()
    bench.operate(0)  # operation is shown only where it is commanded
    bench.drive.feedback.statusword = STATUS_OF[state]
    zsw1 = bench.stepper.step((ON, 0), bench.drive.feedback, True, bench.now)[0]
    assert zsw1 & 0x4F == STATE_ROWS[state]


def test_quick_stop_printed_as_0011_in_the_guides_diagram_is_accepted() -> None:
    bench = Bench()
    bench.drive.feedback.statusword = 0x0003
    assert bench.stepper.step((OFF, 0), bench.drive.feedback, True, 1)[0] & 0x4F == 0x03


COMMANDS = {
    "off": (OFF, Command.SHUTDOWN),
    "on": (0x0477, Command.SWITCH_ON),
    "coast stop": (0x047C, Command.DISABLE_VOLTAGE),
    "quick stop": (0x047A, Command.QUICK_STOP),
}


@pytest.mark.parametrize("state", [State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON])
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_in_every_unpowered_state(state: State, name: str) -> None:
    bench = Bench()
    bench.step(OFF, cycles=2)
    if state is State.SWITCHED_ON:
        bench.step(0x0477, cycles=2)
    if state is State.SWITCH_ON_DISABLED:
        bench.drive.restart()
        bench.stepper.drive_restarted()
        bench.step(OFF)
        bench.drive.restart()
    assert bench.drive.state is state
    word, command = COMMANDS[name]
    bench.stepper.step((word, 0), bench.drive.feedback, True, bench.now)
    if name == "on" and state is State.SWITCH_ON_DISABLED:
        command = Command.SHUTDOWN  # transition 2 first; the OFF that allows it has been seen
    assert command.matches(bench.controlword)


def test_control_by_plc_0_before_the_first_1_keeps_the_controlword_0() -> None:
    bench = Bench()
    bench.step(ON & ~0x400, 0x2000, cycles=5)
    assert bench.controlword == 0
    assert bench.stepper.reason is Reason.NO_CONTROL


def test_control_lost_hold_keeps_the_last_valid_words() -> None:
    bench = Bench(control_lost=ControlLost.HOLD)
    bench.operate(0x2000)
    bench.step(ON & ~CONTROL, 0x1000, cycles=5)
    assert bench.drive.state is State.OPERATION_ENABLED
    assert bench.stepper.command.target_velocity == 3000
    assert bench.stepper.reason is Reason.CONTROL_HELD
    assert not bench.stepper.events


@pytest.mark.parametrize("bit", [4, 5, 6])
def test_setpoint_enable_hold_keeps_the_last_target(bit: int) -> None:
    bench = Bench(setpoint_enable=SetpointEnable.HOLD)
    bench.operate(0x2000)
    bench.step(ON & ~(1 << bit), 0x1000, cycles=3)
    assert bench.stepper.command.target_velocity == 3000
    assert bench.stepper.reason is Reason.SETPOINT_DISABLED


@pytest.mark.parametrize(("bit", "target"), [(4, 0), (5, 3000), (6, 0)])
def test_setpoint_enable_profidrive(bit: int, target: int) -> None:
    bench = Bench(setpoint_enable=SetpointEnable.PROFIDRIVE)
    bench.operate(0x2000)
    bench.step(ON & ~(1 << bit), 0x1000, cycles=3)
    assert bench.stepper.command.target_velocity == target


def test_off1_ramps_down_with_power_on_and_shuts_down_at_standstill() -> None:
    bench = Bench()
    bench.drive.ramp = 500
    bench.operate(0x2000)
    zsw1 = bench.step(OFF, 0x2000)
    assert bench.drive.state is State.OPERATION_ENABLED
    assert zsw1 & 0x4F == 0x03
    assert bench.stepper.command.target_velocity == 0
    bench.step(OFF, 0x2000, cycles=20)
    assert bench.drive.state is State.READY_TO_SWITCH_ON


def test_on_during_the_ramp_stop_does_not_resume_and_needs_a_new_off() -> None:
    bench = Bench()
    bench.drive.ramp = 500
    bench.operate(0x2000)
    bench.step(OFF, 0x2000)
    zsw1 = bench.step(ON, 0x2000, cycles=30)
    assert bench.drive.state is not State.OPERATION_ENABLED
    assert not zsw1 & 0x04
    assert bench.stepper.reason is Reason.NEEDS_OFF
    bench.operate()


def test_on_during_the_ramp_stop_resumes_where_configured() -> None:
    bench = Bench(ramp_stop_resume=True)
    bench.drive.ramp = 500
    bench.operate(0x2000)
    bench.step(OFF, 0x2000)
    bench.step(ON, 0x2000, cycles=10)
    assert bench.drive.feedback.velocity_actual == 3000


@pytest.mark.parametrize(("word", "controlword"), [(0x047A, 0x02), (0x047C, 0x00)])
def test_off2_and_off3_replace_a_ramp_stop_at_once(word: int, controlword: int) -> None:
    bench = Bench()
    bench.drive.ramp = 100
    bench.operate(0x2000)
    bench.step(OFF, 0x2000)
    bench.step(word, 0x2000)
    assert bench.controlword & 0x0F == controlword


def test_disable_operation_takes_power_off_without_off1() -> None:
    bench = Bench()
    bench.operate()
    bench.step(0x0477, 0x2000, cycles=2)
    assert bench.drive.state is State.SWITCHED_ON
    bench.step(ON, 0x2000, cycles=3)
    assert bench.drive.state is State.OPERATION_ENABLED


def test_a_withdrawn_quick_stop_still_ends_in_switching_on_inhibited() -> None:
    bench = Bench()
    bench.drive.ramp = 500
    bench.operate()
    bench.step(0x047B, 0x2000)
    bench.step(ON, 0x2000, cycles=20)
    assert bench.drive.state is State.SWITCH_ON_DISABLED
    assert bench.stepper.reason is Reason.NEEDS_OFF


@pytest.mark.parametrize("word", [0x0477, 0x047D])
def test_quick_stop_ends_by_disable_operation_or_coast_stop(word: int) -> None:
    bench = Bench()
    bench.drive.ramp = 10
    bench.operate()
    bench.step(0x047B, 0x2000, cycles=2)
    assert bench.drive.state is State.QUICK_STOP_ACTIVE
    bench.step(word, 0x2000, cycles=2)
    assert bench.drive.state is State.SWITCH_ON_DISABLED


def test_a_standing_on_does_not_start_after_a_fault_is_acknowledged() -> None:
    bench = Bench()
    bench.operate()
    bench.drive.fault()
    bench.step(ON, 0x2000)
    bench.step(ON | 0x80, 0x2000, cycles=2)
    bench.step(ON, 0x2000, cycles=10)
    assert bench.drive.state is State.SWITCH_ON_DISABLED
    assert bench.stepper.reason is Reason.NEEDS_OFF
    bench.operate()


def test_an_acknowledge_set_at_a_new_connection_is_not_an_edge() -> None:
    bench = Bench()
    bench.drive.fault()
    bench.step(OFF | 0x80, cycles=5)
    assert bench.drive.state is State.FAULT
    bench.step(OFF)
    bench.step(OFF | 0x80, cycles=2)
    assert bench.drive.state is not State.FAULT


def test_acknowledge_set_at_reconnect_is_not_an_edge() -> None:
    bench = Bench()
    bench.drive.fault()
    bench.step(OFF, cycles=2)
    bench.step(None, cycles=2)
    bench.step(OFF | 0x80, cycles=5)
    assert bench.drive.state is State.FAULT


@pytest.mark.parametrize(
    "without", [None, OFF & ~0x400, OFF & ~0x400 | 0x80], ids=["no PLC", "no control", "only acknowledge"]
)
def test_an_acknowledge_needs_a_0_since_the_plc_has_control(without: int | None) -> None:
    bench = Bench()
    bench.drive.fault()
    bench.step(OFF, cycles=2)
    acknowledged = []
    for word in (without, OFF | 0x80, OFF | 0x80):
        bench.step(word)
        acknowledged.append(bench.stepper.machine.outputs.happened().acknowledged)
    assert bench.drive.state is State.FAULT
    bench.drive.state = State.SWITCH_ON_DISABLED  # the fault is gone by itself
    for word in (OFF | 0x80, without, OFF | 0x80):
        bench.step(word)
        acknowledged.append(bench.stepper.machine.outputs.happened().acknowledged)
    assert not any(acknowledged)
    bench.step(OFF)
    bench.step(OFF | 0x80)
    assert bench.stepper.machine.outputs.happened().acknowledged


def test_a_standing_on_does_not_start_after_a_restart_of_the_drive() -> None:
    bench = Bench()
    bench.operate()
    bench.drive.restart()
    bench.stepper.drive_restarted()
    bench.step(ON, 0x2000, cycles=10)
    assert bench.drive.state is State.SWITCH_ON_DISABLED


def test_active_on_does_not_count_for_a_restarted_drive_in_operation() -> None:
    bench = Bench()
    bench.operate()
    bench.step(ON, 0x2000, cycles=5)
    bench.stepper.drive_restarted()
    for _ in range(5):
        bench.stepper.step((ON, 0x2000), bench.drive.feedback, True, bench.now)
        assert not bench.controlword & 0x1
    assert bench.stepper.reason is Reason.NEEDS_OFF


def test_active_on_does_not_restore_an_enable_removed_by_the_drive() -> None:
    bench = Bench()
    bench.operate()
    bench.drive.state = State.SWITCHED_ON  # enable input DI1 fell
    bench.drive.show()
    bench.step(ON, 0x2000, cycles=10)
    assert bench.drive.state is not State.OPERATION_ENABLED
    assert bench.stepper.reason is Reason.NEEDS_OFF


def test_loss_of_a_plc_without_control_is_reported() -> None:
    bench = Bench()
    bench.step(None)
    assert bench.stepper.reason is Reason.NO_PLC
    bench.step(0x0000)
    assert bench.stepper.reason is Reason.NO_CONTROL
    bench.step(None)
    assert bench.stepper.reason is Reason.PLC_LOST


@pytest.mark.parametrize(
    ("reaction", "first"),
    [(PlcLossReaction.RAMP, 0x0F), (PlcLossReaction.QUICK_STOP, 0x02), (PlcLossReaction.COAST, 0x00)],
)
def test_plc_loss_reaction(reaction: PlcLossReaction, first: int) -> None:
    bench = Bench(on_plc_loss=reaction)
    bench.drive.ramp = 500
    bench.operate()
    bench.step(None)
    assert bench.controlword & 0x0F == first
    assert bench.stepper.command.target_velocity == 0
    bench.step(None, cycles=30)
    assert bench.drive.feedback.velocity_actual == 0
    assert bench.drive.state not in {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE}
    assert bench.stepper.reason is Reason.PLC_LOST
    bench.step(ON, 0x2000, cycles=10)
    assert bench.drive.state is not State.OPERATION_ENABLED
    bench.operate()


def test_a_lost_drive_shows_a_fault_and_needs_an_off_afterwards() -> None:
    bench = Bench()
    bench.operate()
    bench.drive_ok = False
    assert bench.step(ON, 0x2000) & 0x4F == 0x08
    assert bench.stepper.reason is Reason.DRIVE_OFFLINE
    assert bench.controlword & 0x0F == 0x02
    bench.drive.restart()
    bench.drive_ok = True
    bench.step(ON, 0x2000, cycles=10)
    assert bench.drive.state is State.SWITCH_ON_DISABLED


def test_invalid_statusword_stops_the_drive() -> None:
    bench = Bench()
    bench.operate()
    bench.drive.feedback.statusword = 0x0002
    zsw1 = bench.stepper.step((ON, 0x2000), bench.drive.feedback, True, bench.now)[0]
    assert bench.controlword & 0x0F == 0x02
    assert zsw1 & 0x4F == 0x08
    assert bench.stepper.reason is Reason.DRIVE_UNKNOWN_STATE


def test_transparent_bits_of_zsw1_and_device_bits_of_stw1() -> None:
    bench = Bench()
    bench.step(OFF | 0xF000)
    assert bench.controlword & 0xF000 == 0xF000
    bench.drive.feedback.statusword = STATUS_OF[State.READY_TO_SWITCH_ON] | 0xC690 | 0x3900
    zsw1 = bench.stepper.step((OFF, 0), bench.drive.feedback, True, 1)[0]
    assert zsw1 == 0xC2B1, "bits 4, 5, 7, 9, 14, 15 pass; 8 and 11-13 do not; 10 needs operation"


def test_speed_saturates_at_the_objects_limit_and_is_counted() -> None:
    bench = Bench(references=References(max_motor_speed=20000))
    bench.operate(0x7FFF)
    assert bench.stepper.command.target_velocity == 32767
    assert bench.stepper.saturations == 1


@pytest.mark.parametrize("name", ["max_motor_speed", "velocity_numerator"])
def test_a_reference_of_0_refuses_operation(name: str) -> None:
    bench = Bench(references=References(**{name: 0}))
    bench.step(OFF, cycles=3)
    assert bench.stepper.numbers == [104]
    zsw1 = bench.step(ON, 0x2000, cycles=5)
    assert bench.controlword == 0
    assert zsw1 & 0x0F == 0x08
    assert bench.stepper.reason is Reason.REFERENCE_INVALID


def test_without_references_no_speed_is_shown_or_commanded() -> None:
    """Nothing is known of what a number of the drive means."""
    bench = Bench()
    bench.operate(0x2000)
    bench.step(ON, 0x2000, cycles=5)
    assert bench.drive.feedback.velocity_actual
    bench.stepper.set_references(None)
    actuals = bench.stepper.step((ON, 0x2000), bench.drive.feedback, True, bench.now)
    assert actuals[1] == 0
    assert bench.stepper.command.target_velocity == 0


def test_the_plcs_device_bits_end_with_the_plc() -> None:
    bench = Bench()
    bench.operate()
    bench.step(ON | 0xF000, 0x2000)
    assert bench.controlword & 0xF000 == 0xF000
    bench.step(None)
    assert bench.controlword & 0xF000 == 0


def test_velocity_mode_passes_the_setpoint_in_operation_and_ramp_stop() -> None:
    bench = Bench()
    bench.stepper.set_drive(described("vl"))
    bench.operate()
    assert bench.controlword & 0x7F == VL_RAMP | 0xF
    bench.drive.feedback.velocity_actual = 100
    bench.step(OFF)
    assert bench.stepper.power.cell.action is Action.RAMP
    assert bench.controlword & 0x7F == VL_RAMP | 0xF
    bench.step(ON & ~0x2)
    assert bench.controlword & 0x7F == 0


# -- limit switches ----------------------------------------------------------------------------------------------------

LIMIT = StatusBit.INTERNAL_LIMIT
HALF_SECOND = 125
"""Cycles."""


def at_limit(bench: Bench, speed: int, *, cycles: int = HALF_SECOND + 1, velocity: int = 0) -> None:
    """The drive reports an internal limit and has this speed, whatever is asked of it."""
    for _ in range(cycles):
        bench.drive.feedback.statusword |= LIMIT
        bench.drive.feedback.velocity_actual = velocity
        bench.step(ON, speed)


@pytest.mark.parametrize("speed", [0x2000, -0x2000])
def test_a_limit_switch_that_is_released_does_not_let_the_axis_move_on(speed: int) -> None:
    bench = Bench(setpoint_enable=SetpointEnable.HOLD, control_lost=ControlLost.HOLD)
    bench.operate(speed)
    at_limit(bench, speed)
    assert bench.stepper.reason is Reason.STOPPED_AT_LIMIT
    assert bench.stepper.warning
    for word, wire in ((ON, speed), (ON, speed * 2), (0x043F, speed), (0x007F, 0), (ON, speed)):
        bench.step(word, wire, cycles=5)
        assert bench.stepper.command.target_velocity == 0
    assert bench.controlword & 0xF == 0xF


def test_limit_at_rest_gives_a_brake_ten_seconds_before_it_stops_the_axis() -> None:
    bench = Bench()
    bench.operate(0)
    at_limit(bench, 0)
    assert (bench.stepper.reason, bench.stepper.warning) == (None, 0)
    at_limit(bench, 0x2000, cycles=20 * HALF_SECOND)
    assert bench.stepper.reason is Reason.INTERNAL_LIMIT
    assert not bench.stepper.warning
    assert bench.stepper.command.target_velocity
    at_limit(bench, 0x2000, cycles=2)
    assert bench.stepper.reason is Reason.STOPPED_AT_LIMIT
    assert bench.stepper.warning


@pytest.mark.parametrize("velocity", [3000, 2980, 3500])
def test_limit_bit_of_an_axis_at_its_speed_is_nothing(velocity: int) -> None:
    bench = Bench()
    bench.operate(0x2000)
    at_limit(bench, 0x2000, velocity=velocity, cycles=4 * HALF_SECOND)
    assert (bench.stepper.reason, bench.stepper.warning) == (None, 0)


def test_limit_that_keeps_the_axis_slower_has_a_reason_and_a_warning() -> None:
    bench = Bench()
    bench.operate(0x2000)
    at_limit(bench, 0x2000, velocity=1500)
    assert bench.stepper.reason is Reason.INTERNAL_LIMIT
    assert bench.stepper.warning
    assert bench.stepper.command.target_velocity == 3000
    at_limit(bench, 0x1000, velocity=1500, cycles=1)
    assert (bench.stepper.reason, bench.stepper.warning) == (None, 0)


def test_limit_bit_while_the_axis_accelerates_is_nothing() -> None:
    bench = Bench()
    bench.operate(0x2000)
    for velocity in range(0, 2900, 10):
        at_limit(bench, 0x2000, velocity=velocity, cycles=1)
        assert (bench.stepper.reason, bench.stepper.warning) == (None, 0)


@pytest.mark.parametrize("speed", [0, -0x0800])
def test_setpoint_through_0_or_off_the_limit_switch_ends_the_limit(speed: int) -> None:
    bench = Bench()
    bench.operate(0x2000)
    at_limit(bench, 0x2000)
    bench.step(ON, speed)
    assert bench.stepper.command.target_velocity == speed * 6000 // 0x4000
    assert bench.stepper.reason is None
    assert not bench.stepper.warning
    bench.step(ON, 0x2000)
    assert bench.stepper.command.target_velocity == 3000


def test_off_and_on_end_the_limit() -> None:
    bench = Bench()
    bench.operate(0x2000)
    at_limit(bench, 0x2000)
    bench.step(OFF, 0x2000, cycles=5)
    bench.step(ON, 0x2000, cycles=5)
    assert bench.stepper.command.target_velocity == 3000


def test_outage_of_references_ends_the_limit() -> None:
    bench = Bench()
    bench.operate(0x2000)
    at_limit(bench, 0x2000)
    bench.stepper.set_references(None)
    bench.step(ON, 0x2000, cycles=3)
    assert not bench.stepper.warning
    assert bench.stepper.command.target_velocity == 0
    bench.stepper.set_references(References())
    bench.step(OFF, 0x2000, cycles=60)
    bench.step(ON, 0x2000, cycles=10)
    assert bench.stepper.command.target_velocity == 3000


@pytest.mark.parametrize(
    ("cycles", "velocity"), [(HALF_SECOND - 2, 0), (4 * HALF_SECOND, 3000)], ids=["a moment", "limited speed"]
)
def test_starting_or_speed_limited_axis_continues(cycles: int, velocity: int) -> None:
    bench = Bench()
    bench.operate(0x2000)
    at_limit(bench, 0x2000, cycles=cycles, velocity=velocity)
    bench.step(ON, 0x2000)
    assert bench.stepper.command.target_velocity == 3000
    at_limit(bench, 0x2000, cycles=HALF_SECOND - 2)
    assert bench.stepper.command.target_velocity == 3000, "not longer than a moment each"


def test_axis_at_a_limit_with_setpoint_0_follows_the_next_setpoint() -> None:
    bench = Bench()
    bench.operate(0)
    at_limit(bench, 0, cycles=2 * HALF_SECOND)
    assert not bench.stepper.warning
    bench.step(ON, -0x2000)
    assert bench.stepper.command.target_velocity == -3000
