"""The simulated drive in virtual time: state table, ramps, positions, homing, limits, faults."""

from __future__ import annotations

import struct

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.aborts import CanopenError
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import COMMAND_TRANSITIONS, Command, ControlBit, State, StatusBit, state_of
from pdgw.peers.drive import Machine, SimulatedDriveNode
from pdgw.peers.drive.objects import CURRENT_CONTROL, DRIVE_FAULTS, HOMING_METHODS, SPEED_CONTROL, TURNTABLE
from tests.support.drives.drive_bench import NODE, SMALL, Bench, drive_in

STATES = [state for state in State if state is not State.NOT_READY_TO_SWITCH_ON]


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("command", list(Command))
def test_every_command_in_every_state_follows_the_table(state: State, command: Command) -> None:
    bench = drive_in(state)
    bench.write(0x6040, 0, command.word)
    if command is Command.FAULT_RESET and state is not State.FAULT:
        command = Command.DISABLE_VOLTAGE  # what else 0080h says
    rows = [t for t in COMMAND_TRANSITIONS if t.source is state and t.command is command]
    expected = rows[0].target if rows else state
    if state is State.READY_TO_SWITCH_ON and command is Command.ENABLE_OPERATION:
        expected = State.OPERATION_ENABLED  # 3 and 4 in one
    assert bench.model.state is expected
    assert state_of(bench.model.statusword) is expected


def test_power_on_goes_to_switch_on_disabled_by_itself() -> None:
    frames: list[tuple[int, bytes]] = []
    node = SimulatedDriveNode(NODE, lambda can_id, data: frames.append((can_id, data)))
    node.start(0)
    assert frames == [(0x701, b"\0")], "boot-up message"
    node.poll(MS)
    assert node.model.state is State.SWITCH_ON_DISABLED


def test_operation_needs_the_enable_input_and_ends_with_it() -> None:
    bench = Bench()
    bench.model.set_enable_input(False)
    for word in (0x06, 0x07, 0x0F):
        bench.control(word)
    assert bench.model.state is State.SWITCHED_ON
    bench.model.set_enable_input(True)
    bench.control(0x0F)
    assert bench.model.state is State.OPERATION_ENABLED
    bench.model.set_enable_input(False)
    assert bench.model.state is State.SWITCHED_ON


def test_0_to_3000_rpm_takes_one_second_with_the_built_in_ramp() -> None:
    bench = Bench()
    bench.enable()
    bench.write(0x60FF, 0, 6000)
    bench.run(999)
    assert bench.model.velocity_actual < 6000
    bench.run(1)
    assert bench.model.velocity_actual == 6000
    assert bench.model.statusword & StatusBit.TARGET_REACHED


def test_sine_squared_ramp_takes_its_time_in_milliseconds_and_is_half_way_at_half_time() -> None:
    bench = Bench()
    bench.write(0x6086, 0, 1)
    bench.write(0x6083, 0, 400)
    bench.enable()
    bench.write(0x60FF, 0, 4000)
    speeds = []
    for _ in range(401):
        bench.run(1)
        speeds.append(bench.model.velocity_actual)
    assert speeds[199] == pytest.approx(2000, abs=20)
    assert speeds[49] < 4000 / 8, "starts gently"
    assert speeds[-1] == 4000
    assert speeds == sorted(speeds)


@pytest.mark.parametrize("profile", [0, 1], ids=["trapezoidal", "sine-squared"])
@pytest.mark.parametrize("distance", [1, 7, 500, 4096, 100_000, -33_333])
def test_absolute_position_is_reached_exactly_with_either_ramp(profile: int, distance: int) -> None:
    bench = Bench(mode=Mode.POSITION)
    bench.write(0x6086, 0, profile)
    if profile:
        bench.write(0x6083, 0, 200)
        bench.write(0x6084, 0, 200)
    bench.enable()
    bench.write(0x607A, 0, distance)
    bench.control(0x1F | ControlBit.CHANGE_IMMEDIATELY)
    assert bench.model.statusword & StatusBit.MODE_12
    bench.until(StatusBit.TARGET_REACHED)
    assert bench.model.position_actual == distance
    assert bench.model.velocity_actual == 0


def test_trapezoid_keeps_acceleration_speed_and_does_not_overshoot() -> None:
    bench = Bench(mode=Mode.POSITION)
    bench.enable()
    bench.write(0x607A, 0, 200_000)
    bench.write(0x6081, 0, 4000)
    bench.control(0x1F)
    highest = position = 0
    previous = bench.model.velocity_actual
    while not bench.model.statusword & StatusBit.TARGET_REACHED:
        bench.run(1)
        # 3000 rpm/s is 6 units/ms; the last step onto the target may be three times that.
        assert abs(bench.model.velocity_actual - previous) <= 18
        previous = bench.model.velocity_actual
        highest = max(highest, previous)
        position = max(position, bench.model.position_actual)
    assert highest == 4000
    assert position == 200_000


def test_relative_and_buffered_setpoints() -> None:
    bench = Bench(mode=Mode.POSITION)
    bench.enable()
    bench.write(0x607A, 0, 5000)
    bench.control(0x1F)
    bench.control(0x0F)
    bench.write(0x607A, 0, 3000)
    bench.control(0x5F)  # relative, after the running one
    assert bench.model.statusword & StatusBit.MODE_12
    bench.control(0x0F)
    assert bench.model.statusword & StatusBit.MODE_12, "the buffer is full until the first is finished"
    bench.until(StatusBit.TARGET_REACHED)
    assert bench.model.position_actual == pytest.approx(3000, abs=50)


def test_halt_stops_and_the_word_that_clears_it_starts_no_setpoint() -> None:
    bench = Bench(mode=Mode.POSITION)
    bench.enable()
    bench.write(0x607A, 0, 300_000)
    bench.control(0x3F, 300)
    bench.control(0x010F, 1500)
    assert bench.model.velocity_actual == 0
    assert bench.model.statusword & StatusBit.TARGET_REACHED
    stopped = bench.model.position_actual
    bench.control(0x3F, 500)
    assert bench.model.position_actual == stopped
    bench.control(0x0F)
    bench.control(0x3F)
    bench.until(StatusBit.TARGET_REACHED)
    assert bench.model.position_actual == 300_000


def test_mode_change_is_refused_while_halt_is_set() -> None:
    bench = Bench(mode=Mode.POSITION)
    bench.control(0x0100)
    bench.write(0x6060, 0, Mode.VELOCITY)
    bench.run(1)
    assert bench.model.modes_of_operation_display == Mode.POSITION
    bench.control(0)
    assert bench.model.modes_of_operation_display == Mode.VELOCITY


@pytest.mark.parametrize("method", sorted(HOMING_METHODS))
def test_homing_methods_of_the_guide(method: int) -> None:
    bench = Bench(SMALL, Mode.HOMING)
    bench.write(0x6098, 0, method)
    bench.write(0x6099, 1, 3000)
    bench.enable()
    bench.control(0x1F)
    bench.until(StatusBit.MODE_12)
    assert bench.model.position_actual == 0
    assert bench.model.statusword & StatusBit.TARGET_REACHED
    where = bench.model.machine_position
    expected = {17: -20_000, 18: 20_000, 1: -16_384, 2: 16_384, -17: -30_000, -18: 30_000, 35: 0}[method]
    assert where == pytest.approx(expected, abs=20)


def test_a_missing_limit_switch_is_a_homing_error() -> None:
    bench = Bench(Machine(None, None, -5000, 5000), Mode.HOMING)
    bench.write(0x6098, 0, 17)
    bench.enable()
    bench.control(0x1F)
    bench.until(StatusBit.MODE_13)
    assert not bench.model.statusword & StatusBit.MODE_12


def test_turntable_takes_the_shortest_or_the_given_direction() -> None:
    for word, expected in ((TURNTABLE.shortest, -96), (0, 4000), (TURNTABLE.ccw, -96)):
        bench = Bench(mode=TURNTABLE.mode)
        bench.enable()
        bench.write(0x607A, 0, 4000)
        bench.control(0x3F | word)
        bench.until(StatusBit.TARGET_REACHED)
        assert bench.model.position_actual == expected


def test_torque_mode_accelerates_and_current_control_keeps_its_speed_limit() -> None:
    bench = Bench(mode=CURRENT_CONTROL)
    bench.enable()
    bench.write(0x2003, 0, 800)
    bench.write(0x6071, 0, 500)
    bench.run(2000)
    assert bench.model.velocity_actual == 800
    assert bench.model.current_actual == 500
    bench.write(0x6060, 0, Mode.TORQUE)
    bench.run(2000)
    assert bench.model.velocity_actual == 6000


def test_speed_control_is_slowed_by_its_torque_limit() -> None:
    reached = {}
    for limit in (0, 100, 1000):
        bench = Bench(mode=SPEED_CONTROL)
        bench.write(0x2004, 0, limit)
        bench.enable()
        bench.write(0x60FF, 0, 4000)
        bench.run(500)
        reached[limit] = bench.model.velocity_actual
    assert reached[0] == 0 < reached[100] < reached[1000]


def test_limits_607f_6080_60c5_and_607b_are_honoured() -> None:
    bench = Bench()
    bench.write(0x6080, 0, 1000)
    bench.write(0x60C5, 0, 100)
    bench.enable()
    bench.write(0x60FF, 0, 6000)
    bench.run(500)
    assert bench.model.velocity_actual == pytest.approx(1000, abs=4), "1000 rpm/s for half a second"
    bench.run(2000)
    assert bench.model.velocity_actual == 2000
    position = Bench(mode=Mode.POSITION)
    position.enable()
    position.write(0x607B, 2, 7000)
    position.write(0x607A, 0, 9000)
    position.control(0x1F)
    position.until(StatusBit.TARGET_REACHED)
    assert position.model.position_actual == 7000
    assert position.model.statusword & StatusBit.INTERNAL_LIMIT


def test_a_limit_switch_stops_motion_in_its_direction_only() -> None:
    bench = Bench(SMALL)
    bench.enable()
    bench.write(0x60FF, 0, 2000)
    bench.until(StatusBit.INTERNAL_LIMIT)
    bench.run(1000)
    assert bench.model.velocity_actual == 0
    assert bench.model.digital_inputs & 2
    bench.write(0x60FF, 0, -2000)
    bench.run(300)
    assert bench.model.velocity_actual < 0


@pytest.mark.parametrize("number", sorted(DRIVE_FAULTS))
def test_faults_1_to_12_stop_report_and_need_their_cause_removed(number: int) -> None:
    bench = Bench()
    bench.enable()
    bench.write(0x60FF, 0, 3000)
    bench.run(600)
    bench.frames.clear()
    bench.model.inject(number)
    bench.run(1)
    assert bench.model.state is State.FAULT_REACTION_ACTIVE
    fault = DRIVE_FAULTS[number]
    emcy = bench.sent(0x81)[0]
    assert struct.unpack("<HB5x", emcy) == (fault.error_code, fault.error_register)
    assert (bench.model.error_code, bench.node.read(0x603F), bench.node.read(0x1003, 1)) == (
        number,
        fault.error_code,
        fault.error_code,
    )
    bench.run(1000)
    assert bench.model.state is State.FAULT
    bench.control(0x80)
    assert bench.model.state is State.FAULT, "the cause is still there"
    bench.model.clear()
    bench.control(0x00)
    bench.control(0x80)
    assert bench.model.state is State.SWITCH_ON_DISABLED
    assert bench.model.error_code == 0


@pytest.mark.parametrize("number", [0, 13, -1])
def test_other_fault_numbers_are_refused(number: int) -> None:
    with pytest.raises(CanopenError, match="drive fault"):
        Bench().model.inject(number)
