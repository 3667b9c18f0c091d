"""The simulated drive in virtual time: state table, ramps, positions, homing, limits, faults, CANopen behaviour."""

from __future__ import annotations

import struct

import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.ds301.aborts import Abort
from pdgw.ds301.eds import write_eds
from pdgw.ds301.errors import CanopenError
from pdgw.ds301.nmt import NmtState
from pdgw.dsp402.images import COMMAND_NAMES, FEEDBACK_NAMES
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.pdo import LAYOUTS, Operation, with_second_position
from pdgw.dsp402.states import COMMAND_TRANSITIONS, Command, ControlBit, State, StatusBit, state_of
from pdgw.peers.drive import LINEAR, Machine, SimulatedDriveNode
from pdgw.peers.drive.device import EDS_PATH, INFO, OBJECTS, drive_objects
from pdgw.peers.drive.family import CURRENT_CONTROL, DRIVE_FAULTS, HOMING_METHODS, SPEED_CONTROL, TURNTABLE

MS = 1_000_000
NODE = 1
SMALL = Machine(negative_limit=-20_000, positive_limit=20_000, negative_stop=-30_000, positive_stop=30_000)


class Bench:
    """A drive on a desk: SDOs and time by hand."""

    def __init__(self, machine: Machine | None = None, mode: int = Mode.VELOCITY) -> None:
        self.frames: list[tuple[int, bytes]] = []
        self.node = SimulatedDriveNode(
            NODE, lambda can_id, data: self.frames.append((can_id, data)), machine=machine or LINEAR
        )
        self.model = self.node.model
        self.now = 0
        self.node.start(0)
        self.run(2)
        self.write(0x6060, 0, mode)
        self.node.receive(0, bytes((1, NODE)), self.now)
        self.run(1)

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now += MS
            self.node.poll(self.now)

    def write(self, index: int, subindex: int, value: int) -> int:
        """An SDO download; returns 0 or the abort code the node answered."""
        entry = self.node.entries[index, subindex]
        data = struct.pack("<" + entry.type.char, value)
        return self.download(index, subindex, data)

    def download(self, index: int, subindex: int, data: bytes) -> int:
        self.frames.clear()
        command = 0x23 | (4 - len(data)) << 2
        self.node.receive(0x601, struct.pack("<BHB", command, index, subindex) + data.ljust(4, b"\0"), self.now)
        answer = next(data for can_id, data in self.frames if can_id == 0x581)
        return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0

    def control(self, word: int, milliseconds: int = 1) -> None:
        self.write(0x6040, 0, word)
        self.run(milliseconds)

    def enable(self) -> None:
        for word in (0x06, 0x07, 0x0F):
            self.control(word)
        assert self.model.state is State.OPERATION_ENABLED

    def until(self, mask: int, limit: int = 60_000) -> int:
        """Milliseconds until a Statusword bit of the mask is set."""
        for elapsed in range(limit):
            if self.model.statusword & mask:
                return elapsed
            self.run(1)
        raise AssertionError(f"Statusword {self.model.statusword:04X}h, position {self.model.position_actual}")


def drive_in(state: State) -> Bench:
    bench = Bench()
    ways = {
        State.SWITCH_ON_DISABLED: (),
        State.READY_TO_SWITCH_ON: (0x06,),
        State.SWITCHED_ON: (0x06, 0x07),
        State.OPERATION_ENABLED: (0x06, 0x07, 0x0F),
        State.QUICK_STOP_ACTIVE: (0x06, 0x07, 0x0F),
    }
    for word in ways.get(state, (0x06, 0x07, 0x0F)):
        bench.control(word)
    if state in {State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}:
        bench.write(0x60FF, 0, 6000)
        bench.run(500)
    if state is State.QUICK_STOP_ACTIVE:
        bench.write(0x6040, 0, 0x02)
    elif state in {State.FAULT, State.FAULT_REACTION_ACTIVE}:
        bench.model.inject(7)
        bench.model.clear()
        if state is State.FAULT:
            bench.run(5)
    assert bench.model.state is state
    return bench


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


def test_halt_stops_and_a_setpoint_in_the_word_that_clears_halt_is_not_taken() -> None:
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
    emcy = next(data for can_id, data in bench.frames if can_id == 0x81)
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
    with pytest.raises(CanopenError, match="fault number"):
        Bench().model.inject(number)


ABORTS = [
    (0x5000, 0, b"\0", Abort.NO_SUCH_OBJECT),
    (0x6040, 1, b"\0\0", Abort.NO_SUCH_SUBINDEX),
    (0x6041, 0, b"\0\0", Abort.READ_ONLY),
    (0x6040, 0, b"\0", Abort.LENGTH_TOO_LOW),
    (0x6040, 0, b"\0\0\0\0", Abort.LENGTH_TOO_HIGH),
    (0x6094, 1, bytes(4), Abort.VALUE_TOO_LOW),
    (0x6083, 0, b"\xff\xff\0\0", Abort.VALUE_TOO_HIGH),
    (0x1010, 1, b"evas", Abort.CANNOT_STORE),
    (0x1600, 0, b"\1", Abort.UNSUPPORTED_ACCESS),
]


@pytest.mark.parametrize(("index", "subindex", "data", "abort"), ABORTS)
def test_sdo_aborts_are_those_of_the_standard(index: int, subindex: int, data: bytes, abort: Abort) -> None:
    assert Bench().download(index, subindex, data) == abort


def test_pdo_mapping_needs_an_invalid_pdo_and_count_0_and_checks_objects_and_length() -> None:
    bench = Bench()
    target = OBJECTS.attribute("target_position")
    assert bench.write(0x1600, 1, target.mapping) == Abort.UNSUPPORTED_ACCESS
    assert bench.write(0x1400, 1, 0x8000_0201) == 0
    assert bench.write(0x1600, 1, target.mapping) == Abort.UNSUPPORTED_ACCESS
    assert bench.write(0x1600, 0, 0) == 0
    assert bench.write(0x1600, 1, 0x5000_0010) == Abort.NO_SUCH_OBJECT
    assert bench.write(0x1600, 1, DRIVE_OBJECTS.attribute("statusword").mapping) == Abort.NOT_MAPPABLE
    assert bench.write(0x1600, 1, target.mapping) == 0
    assert bench.write(0x1600, 2, target.mapping) == 0
    assert bench.write(0x1600, 3, target.mapping) == 0
    assert bench.write(0x1600, 0, 3) == Abort.PDO_LENGTH
    assert bench.write(0x1600, 0, 1) == 0
    assert bench.write(0x1400, 1, 0x201) == 0
    bench.node.receive(0x201, struct.pack("<i", -77), bench.now)
    assert bench.model.target_position == -77


def test_a_pdo_that_is_too_short_is_not_used_and_raises_8210h() -> None:
    bench = Bench()
    bench.frames.clear()
    bench.node.receive(0x201, b"\x06", bench.now)
    assert bench.model.state is State.SWITCH_ON_DISABLED
    assert any(can_id == 0x81 and data[:2] == b"\x10\x82" for can_id, data in bench.frames)


def test_sync_tpdos_are_sent_on_every_nth_sync_and_event_timer_repeats() -> None:
    bench = Bench()
    bench.write(0x1800, 2, 2)
    bench.frames.clear()
    for _ in range(6):
        bench.node.receive(0x80, b"", bench.now)
        bench.run(1)
    assert sum(can_id == 0x181 for can_id, _ in bench.frames) == 3
    bench.write(0x1800, 2, 255)
    bench.write(0x1800, 5, 10)
    bench.run(5)
    bench.frames.clear()
    bench.run(100)
    assert sum(can_id == 0x181 for can_id, _ in bench.frames) == 10


def test_inhibit_time_bounds_the_rate_of_a_changing_tpdo() -> None:
    bench = Bench()
    bench.write(0x1800, 3, 50)  # 5 ms
    bench.enable()
    bench.write(0x60FF, 0, 6000)
    bench.frames.clear()
    bench.run(100)
    assert sum(can_id == 0x181 for can_id, _ in bench.frames) == 20


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, State.OPERATION_ENABLED),
        (1, State.FAULT),
        (2, State.SWITCH_ON_DISABLED),
        (3, State.SWITCH_ON_DISABLED),
    ],
)
def test_a_lost_gateway_heartbeat_is_answered_by_6007h(option: int, state: State) -> None:
    bench = Bench()
    bench.write(0x1016, 1, 127 << 16 | 100)
    bench.write(0x6007, 0, option)
    bench.enable()
    bench.write(0x60FF, 0, 2000)
    for _ in range(10):
        bench.node.receive(0x700 + 127, b"\x05", bench.now)
        bench.run(50)
    assert bench.model.state is State.OPERATION_ENABLED
    bench.run(1000)
    assert bench.model.state is state


def test_leaving_nmt_operational_stops_the_drive() -> None:
    bench = Bench()
    bench.write(0x6007, 0, 3)
    bench.enable()
    bench.node.receive(0, bytes((0x80, NODE)), bench.now)
    bench.run(10)
    assert bench.model.state is State.SWITCH_ON_DISABLED
    assert bench.node.state is NmtState.PRE_OPERATIONAL


def test_heartbeat_shows_the_nmt_state_at_its_period() -> None:
    bench = Bench()
    bench.write(0x1017, 0, 20)
    bench.frames.clear()
    bench.run(100)
    assert [data for can_id, data in bench.frames if can_id == 0x701] == [b"\x05"] * 5


@given(can_id=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_arbitrary_frames_never_upset_the_node(can_id: int, data: bytes) -> None:
    bench = Bench()
    bench.node.receive(can_id, data, bench.now)
    bench.run(2)
    assert state_of(bench.model.statusword) is not None


def test_the_eds_in_the_package_is_the_declared_device_and_canopen_reads_it() -> None:
    assert EDS_PATH.read_text(encoding="ascii") == write_eds(INFO, drive_objects()), "run: make docs"
    dictionary = canopen.import_od(str(EDS_PATH), 5)
    assert dictionary[0x1800][1].default == 0x185
    for spec in drive_objects():
        for entry in spec.entries:
            item = dictionary[entry.index]
            variable = item if len(spec.entries) == 1 else item[entry.subindex]
            assert (variable.data_type, variable.access_type) == (entry.type.code, entry.access.value), str(entry)
            assert bool(variable.pdo_mappable) == entry.pdo
            assert (variable.min, variable.max) == (entry.low, entry.high)


def test_images_hold_exactly_the_objects_of_the_layouts() -> None:
    commands = {a for layout in LAYOUTS.values() for pdo in layout.rpdos for a in pdo.attributes}
    feedback = {a for layout in LAYOUTS.values() for pdo in layout.tpdos for a in pdo.attributes}
    assert commands == set(COMMAND_NAMES)
    last = with_second_position(LAYOUTS[Operation.VELOCITY_WITH_POSITION]).tpdos[-1]
    assert feedback | set(last.attributes) == set(FEEDBACK_NAMES)
