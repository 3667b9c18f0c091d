"""The table of habits, and what each does on the bus and to the drive, in virtual time; the gateway is not involved."""

from __future__ import annotations

import struct

import pytest

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.communication import NmtCommand, NmtState
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State, StatusBit, state_of
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.peers.drive.drive_behaviours import DRIVE_HABITS
from pdgw.peers.habits import HABITS, Habit
from pdgw.peers.node.node import SimulatedNode
from pdgw.peers.node.node_behaviours import NODE_HABITS
from tests.support.drives.drive_bench import DriveBench

NODE = 5
SDO_REQUEST, SDO_ANSWER, TPDO, RPDO, HEARTBEAT, EMCY = 0x605, 0x585, 0x185, 0x205, 0x705, 0x85


class Bench(DriveBench):
    """A drive with telegram 1's PDOs."""

    def __init__(self) -> None:
        super().__init__(lambda send: SimulatedDriveNode(NODE, send))

    def operate(self, speed: int = 2000) -> None:
        """Telegram 1's PDOs are the default mapping; speed in 0.5 rpm."""
        self.write(0x1800, 5, 20)
        self.write(0x6060, 0, Mode.VELOCITY)
        self.nmt(NmtCommand.START)
        for word in (0x06, 0x07, 0x0F):
            self.command(word, speed)
        assert self.model.state is State.OPERATION_ENABLED
        self.frames.clear()

    def command(self, word: int, speed: int = 0) -> None:
        self.frame(RPDO, struct.pack("<Hi", word, speed))
        self.run(1)


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.run(2)
    return bench


@pytest.mark.parametrize("habit", HABITS.values(), ids=lambda habit: habit.name)
def test_every_habit_is_described_and_its_values_are_within_their_limits(habit: Habit) -> None:
    assert len(habit.text) > 20
    assert len(habit.source) > 5
    for item in habit.parameters.values():
        assert item.low <= item.default <= item.high
        assert item.meaning
    for name, (low, high) in habit.legal.items():
        assert habit.parameters[name].low <= low <= high <= habit.parameters[name].high
    assert not habit.legal_for or habit.legal.keys() == habit.parameters.keys()


@pytest.mark.parametrize("habit", HABITS.values(), ids=lambda habit: habit.name)
def test_every_habit_is_legal_or_has_a_case_for_each_of_its_devices(habit: Habit) -> None:
    devices = ("drive", "encoder") if habit.device == "node" else (habit.device,)
    assert {*habit.legal_for, *(key for case in habit.cases for key in case)} >= set(devices)
    assert all("within_ms" in case for case in habit.cases if case.get("faults"))


def test_table_has_the_numbers_of_rows_that_the_document_promises() -> None:
    assert sum(bool(habit.legal_for) for habit in HABITS.values()) >= 60


@pytest.mark.parametrize("name", DRIVE_HABITS)
def test_removed_fault_leaves_a_normal_drive(bench: Bench, name: str) -> None:
    bench.node.start_fault(name)
    bench.run(50)
    bench.node.end_fault(name)
    bench.run(50)
    assert not bench.node.behaviours
    bench.frame(0, bytes((NmtCommand.RESET_NODE, NODE)))
    bench.run(5)
    bench.command(0x80)
    bench.operate()
    bench.run(1000)
    assert state_of(bench.model.statusword) is State.OPERATION_ENABLED
    assert bench.model.velocity_actual == 2000
    assert bench.model.modes_of_operation_display == Mode.VELOCITY


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("slow", {}, "fault: 'slow' is not allowed, expected one of slow-sdo, "),
        ("slow-sdo", {"delay": 3}, "fault slow-sdo parameter: 'delay'.*delay_ms"),
        ("reboot-in-motion", {"speed": 0}, r"fault reboot-in-motion speed: 0 .*1 rpm to 100000 rpm"),
        ("slow-sdo", {"delay_ms": "3"}, "fault slow-sdo delay_ms: '3'"),
        ("slow-sdo", {"delay_ms": True}, "fault slow-sdo delay_ms: True"),
        ("heartbeat-stops", {"x": 1}, "no parameter"),
    ],
)
def test_a_wrong_choice_is_named_and_changes_nothing(
    bench: Bench, name: str, values: dict[str, object], message: str
) -> None:
    bench.node.start_fault("slow-sdo", delay_ms=7)
    with pytest.raises(CanopenError, match=message):
        bench.node.start_fault(name, **values)
    assert [fault.values for fault in bench.node.behaviours.values()] == [{"delay_ms": 7}]


def test_any_simulated_node_has_the_faults_of_a_node() -> None:
    assert SimulatedNode.catalogue is NODE_HABITS
    assert set(NODE_HABITS) < set(DRIVE_HABITS)


def test_slow_sdo_answers_after_its_delay(bench: Bench) -> None:
    bench.node.start_fault("slow-sdo", delay_ms=30)
    assert bench.read(0x1000) is None
    bench.run(29)
    assert not bench.sent(SDO_ANSWER)
    bench.run(1)
    assert bench.sent(SDO_ANSWER) == [struct.pack("<BHBI", 0x43, 0x1000, 0, 0x0002_0192)]


def test_sdo_timeout_leaves_each_nth_request_without_an_answer(bench: Bench) -> None:
    bench.node.start_fault("sdo-timeout", every=3)
    assert [bench.read(0x1000) is None for _ in range(6)] == [False, False, True] * 2


@pytest.mark.parametrize("name", ["sdo-answers-of-object-missing", "sdo-answers-of-object-late"])
def test_sdo_answers_of_one_object_are_missing_or_late_while_the_others_come(bench: Bench, name: str) -> None:
    bench.operate()
    bench.node.start_fault(name, index=0x606C)
    assert bench.read(0x606C) is None
    assert bench.read(0x606B) is not None
    bench.run(400)
    late = [data for data in bench.sent(SDO_ANSWER) if data[1:3] == b"\x6c\x60"]
    assert len(late) == name.endswith("late")
    bench.node.end_fault(name)
    assert bench.read(0x606C) is not None


def test_two_pdos_has_no_parameters_for_the_third(bench: Bench) -> None:
    bench.node.start_fault("two-pdos")
    for base in (0x1400, 0x1600, 0x1800, 0x1A00):
        assert bench.read(base + 1, 1)[0] == 0x43  # type: ignore[index]
        assert bench.read(base + 2, 1)[4:] == b"\0\0\x02\x06"  # type: ignore[index]


def test_duplicated_pdos_come_again_at_once(bench: Bench) -> None:
    bench.operate(0)
    bench.run(100)
    once = len(bench.sent(TPDO))
    bench.frames.clear()
    bench.node.start_fault("duplicated-pdos", copies=2)
    bench.run(100)
    assert len(bench.sent(TPDO)) == 3 * once


def test_late_pdos_keep_their_order(bench: Bench) -> None:
    bench.operate()
    bench.node.start_fault("late-pdos", delay_ms=30)
    bench.command(0x02)
    bench.run(28)
    assert bench.model.state is State.OPERATION_ENABLED
    bench.run(2)
    assert bench.model.state is State.QUICK_STOP_ACTIVE
    bench.run(1000)
    speeds = [struct.unpack_from("<i", data, 2)[0] for data in bench.sent(TPDO)]
    assert speeds[: speeds.index(max(speeds))] == sorted(speeds[: speeds.index(max(speeds))])


def test_heartbeat_stops_but_the_boot_up_message_does_not(bench: Bench) -> None:
    bench.write(0x1017, 0, 10)
    bench.node.start_fault("heartbeat-stops")
    bench.frames.clear()
    bench.run(50)
    assert not bench.sent(HEARTBEAT)
    bench.frame(0, bytes((NmtCommand.RESET_COMMUNICATION, NODE)))
    assert bench.sent(HEARTBEAT) == [b"\0"]


def test_an_emcy_burst_has_its_count_and_its_content(bench: Bench) -> None:
    bench.frames.clear()
    bench.node.start_fault("emcy-burst", code=0x2310, register=3, count=5, period_ms=4)
    bench.run(100)
    assert [time for time, _, _ in bench.frames] == [3, 6, 10, 14, 18]
    assert set(bench.sent(EMCY)) == {b"\x10\x23\x03" + bytes(5)}


def test_bus_off_receives_and_sends_nothing_until_recovery(bench: Bench) -> None:
    bench.node.start_fault("bus-off", recovery_ms=50)
    assert bench.read(0x1000) is None
    bench.run(49)
    assert not bench.frames
    bench.run(1)
    assert bench.sent(EMCY) == [b"\x40\x81\0" + bytes(5)]
    assert bench.read(0x1000) is not None


def test_error_passive_reports_and_is_late(bench: Bench) -> None:
    bench.frames.clear()
    bench.node.start_fault("error-passive", delay_ms=9)
    bench.run(100)
    assert bench.sent(EMCY) == [b"\x20\x81\x11" + bytes(5)]
    assert bench.read(0x1000) is None
    bench.run(9)
    assert bench.sent(SDO_ANSWER)
    bench.node.end_fault("error-passive")
    assert bench.sent(EMCY) == [bytes(8)]


def test_reboot_is_silent_then_boots_with_power_on_values(bench: Bench) -> None:
    bench.operate()
    bench.node.start_fault("reboot", off_ms=30)
    bench.run(29)
    assert not bench.frames
    bench.run(1)
    assert bench.sent(HEARTBEAT) == [b"\0"]
    assert bench.node.state is NmtState.PRE_OPERATIONAL
    bench.run(2)
    assert bench.model.state is State.SWITCH_ON_DISABLED


def test_reboot_in_motion_waits_for_the_motion(bench: Bench) -> None:
    bench.node.start_fault("reboot-in-motion", speed=500)
    bench.operate(900)
    bench.run(1000)
    assert bench.node.state is NmtState.OPERATIONAL
    bench.command(0x0F, 2000)
    bench.run(1000)
    assert bench.sent(HEARTBEAT) == [b"\0"]
    assert bench.node.state is NmtState.PRE_OPERATIONAL


def test_late_status_is_as_old_as_it_says(bench: Bench) -> None:
    bench.operate()
    bench.run(100)
    bench.node.start_fault("late-status", delay_ms=40)
    bench.run(50)
    bench.command(0x02)
    bench.run(38)
    assert state_of(bench.model.statusword) is State.OPERATION_ENABLED
    bench.run(3)
    assert state_of(bench.model.statusword) is State.QUICK_STOP_ACTIVE


def test_bouncing_bits_change_all_the_time(bench: Bench) -> None:
    bench.operate(0)
    bench.node.start_fault("bouncing-status", bits=StatusBit.OPERATION_ENABLED, period_ms=5)
    seen = []
    for _ in range(20):
        bench.run(1)
        seen.append(state_of(bench.model.statusword))
    assert {seen.count(state) for state in (State.OPERATION_ENABLED, State.SWITCHED_ON)} == {10}


@pytest.mark.parametrize(("positive", "speed"), [(1, 2000), (0, -2000)])
def test_limit_switch_stops_only_motion_towards_it(bench: Bench, positive: int, speed: int) -> None:
    bench.operate(speed)
    bench.run(300)
    bench.node.start_fault("limit-switch", positive=positive)
    bench.run(1000)
    assert bench.model.velocity_actual == 0
    assert bench.model.statusword & StatusBit.INTERNAL_LIMIT
    bench.command(0x0F, -speed)
    bench.run(50)
    assert bench.model.velocity_actual * speed < 0


@pytest.mark.parametrize(
    ("name", "values", "number"),
    [("under-voltage", {}, 6), ("drive-fault", {"number": 7}, 7)],
)
def test_drive_fault_stays_until_it_is_removed(bench: Bench, name: str, values: dict[str, int], number: int) -> None:
    bench.operate()
    bench.node.start_fault(name, **values)
    bench.run(1000)
    assert (bench.model.state, bench.model.error_code) == (State.FAULT, number)
    assert (bench.model.dc_link_voltage < 20_000) is (name == "under-voltage")
    bench.command(0x80)
    assert bench.model.state is State.FAULT
    bench.node.end_fault(name)
    bench.command(0)
    bench.command(0x80)
    assert bench.model.state is State.SWITCH_ON_DISABLED
    assert bench.model.dc_link_voltage == 48_000
