"""The simulated drive where something goes wrong: resets, a master that leaves, odd values, the console's bad input."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.aborts import Abort
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State, StatusBit
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.peers.simulation.console import Console
from pdgw.peers.simulation.devices import Simulation
from pdgw.peers.world import World
from tests.support.drives.drive_bench import NODE, SMALL, Bench

START, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 128, 129, 130


def nmt(bench: Bench, command: int) -> None:
    bench.node.receive(0, bytes((command, NODE)), bench.now)


def test_reset_communication_keeps_the_parameters_and_stops_the_drive() -> None:
    bench = Bench()
    bench.write(0x6007, 0, 3)
    bench.write(0x6085, 0, 777)
    bench.write(0x1017, 0, 50)
    bench.enable()
    bench.write(0x60FF, 0, 2000)
    bench.run(300)
    nmt(bench, RESET_COMMUNICATION)
    assert bench.model.state is State.QUICK_STOP_ACTIVE
    bench.run(1000)
    assert bench.model.state is State.SWITCH_ON_DISABLED
    assert bench.model.velocity_actual == 0
    assert (bench.node.read(0x6085), bench.node.read(0x1017)) == (777, 0)


def test_reset_node_keeps_position_enable_input_and_fault_causes() -> None:
    bench = Bench()
    bench.model.machine_position = 5000.0
    bench.model.set_enable_input(False)
    bench.model.inject(7)
    bench.run(10)
    nmt(bench, RESET_NODE)
    bench.run(3)
    assert bench.model.state is State.FAULT
    assert bench.model.error_code == 7
    assert not bench.model.digital_inputs & 1 << 16
    assert bench.model.machine_position == 5000.0
    bench.model.clear()
    bench.control(0x80)
    for word in (0x06, 0x07, 0x0F):
        bench.control(word)
    assert bench.model.state is State.SWITCHED_ON


def test_stored_parameters_survive_a_reset_until_the_defaults_are_restored() -> None:
    bench = Bench()
    default = bench.node.read(0x6085)
    bench.write(0x6085, 0, 77)
    assert bench.download(0x1010, 1, b"save") == 0
    bench.write(0x6085, 0, 99)
    nmt(bench, RESET_NODE)
    assert bench.node.read(0x6085) == 77
    assert bench.download(0x1011, 1, b"load") == 0
    assert bench.node.read(0x6085) == 77, "in force after the next reset"
    nmt(bench, RESET_NODE)
    assert bench.node.read(0x6085) == default


@pytest.mark.parametrize(
    ("option", "state"), [(1, State.FAULT), (2, State.SWITCH_ON_DISABLED), (3, State.SWITCH_ON_DISABLED)]
)
def test_an_enable_input_starts_nothing_after_the_master_left(option: int, state: State) -> None:
    bench = Bench()
    bench.write(0x6007, 0, option)
    bench.write(0x60FF, 0, 2000)
    bench.model.set_enable_input(False)
    for word in (0x06, 0x07, 0x0F):
        bench.control(word)
    nmt(bench, PRE_OPERATIONAL)
    bench.run(5)
    bench.model.set_enable_input(True)
    bench.run(500)
    assert bench.model.state is state
    assert bench.model.velocity_actual == 0


def test_a_command_that_waited_for_sync_is_forgotten_when_the_node_leaves_operational() -> None:
    bench = Bench()
    bench.write(0x1400, 2, 1)
    bench.control(0x06)
    bench.control(0x07)
    bench.node.receive(0x201, struct.pack("<Hi", 0x0F, 2000), bench.now)
    assert bench.model.state is State.SWITCHED_ON
    nmt(bench, PRE_OPERATIONAL)
    nmt(bench, START)
    bench.node.receive(0x80, b"", bench.now)
    assert bench.model.state is State.SWITCHED_ON
    bench.node.receive(0x201, struct.pack("<Hi", 0x0F, 0), bench.now)
    bench.node.receive(0x80, b"", bench.now)
    assert bench.model.state is State.OPERATION_ENABLED


def test_a_fault_before_the_drive_has_started_is_not_lost() -> None:
    node = SimulatedDriveNode(NODE, lambda *_: None)
    node.start(0)
    node.model.inject(7)
    for now in (MS, 2 * MS, 3 * MS):
        node.poll(now)
    assert node.model.state is State.FAULT


@pytest.mark.parametrize("profile", [0, 1], ids=["trapezoidal", "sine-squared"])
def test_ramps_of_0_from_a_pdo_are_the_shortest_ramp(profile: int) -> None:
    bench = Bench(mode=Mode.POSITION)
    bench.write(0x6086, 0, profile)
    bench.enable()
    bench.model.profile_acceleration = bench.model.profile_deceleration = 0  # a PDO is not range-checked
    bench.write(0x607A, 0, 5000)
    bench.control(0x3F)
    bench.until(StatusBit.TARGET_REACHED)
    assert bench.model.position_actual == 5000


def test_a_speed_beyond_the_object_is_its_largest_value() -> None:
    bench = Bench(mode=Mode.TORQUE)
    bench.write(0x6094, 2, 0xFFFF_FFFF)
    bench.enable()
    bench.write(0x6071, 0, 500)
    bench.run(500)
    assert bench.model.velocity_actual == (1 << 31) - 1
    bench.write(0x6071, 0, -500)
    bench.run(1500)
    assert bench.model.velocity_actual == -(1 << 31) + 1


def test_homing_keeps_the_speed_limits() -> None:
    bench = Bench(SMALL, Mode.HOMING)
    bench.write(0x6098, 0, -17)
    bench.write(0x6099, 1, 32767)
    bench.write(0x609A, 0, 32767)
    bench.write(0x60C5, 0, 32767)
    bench.enable()
    bench.control(0x1F)
    fastest = 0
    while not bench.model.statusword & StatusBit.MODE_12:
        bench.run(1)
        fastest = max(fastest, abs(bench.model.velocity_actual))
    assert fastest == 6000


@pytest.mark.parametrize("type_", [241, 252, 253])
def test_transmission_types_the_node_does_not_have_are_refused(type_: int) -> None:
    bench = Bench()
    assert bench.write(0x1400, 2, type_) == Abort.VALUE_RANGE
    assert bench.write(0x1800, 2, type_) == Abort.VALUE_RANGE
    assert bench.write(0x1800, 2, 254) == 0


@pytest.mark.parametrize("option", [0, 1, 2])
def test_quick_stop_by_605ah_ends_in_switch_on_disabled(option: int) -> None:
    """0 takes power off at once, 1 brakes from 3000 rpm with 6084h (1500 rpm/s), 2 with 6085h (6000 rpm/s)."""
    bench = Bench()
    bench.write(0x605A, 0, option)
    bench.write(0x6084, 0, 150)
    bench.write(0x6085, 0, 600)
    bench.enable()
    bench.write(0x60FF, 0, 6000)
    bench.run(1000)
    bench.write(0x6040, 0, 0x02)
    elapsed = 0
    while bench.model.state is State.QUICK_STOP_ACTIVE:
        bench.run(1)
        elapsed += 1
    assert bench.model.state is State.SWITCH_ON_DISABLED
    assert elapsed == {0: 0, 1: 2000, 2: 500}[option]


@pytest.mark.parametrize(
    "line",
    [
        "fault ²",
        "²",
        "@² status",
        "@9 status",
        "fault " + "9" * 5000,
        "fault -1",
        "fault",
        "7",
        "probe 1 maybe",
        "\udce9",
    ],
)
def test_bad_console_input_is_answered(line: str) -> None:
    with simulated(3) as simulation:
        console = Console(simulation, threading.Event())
        assert console.execute(line).startswith("error: ")
        assert simulation.status(3)["fault"] == 0


def test_the_console_addresses_one_of_several_drives() -> None:
    quit_ = threading.Event()
    with simulated(3, 4) as simulation:
        console = Console(simulation, quit_)
        assert console.execute("@4 fault 7") == "ok: fault 7, over-current"
        assert [simulation.status(node)["fault"] for node in (3, 4)] == [0, 7]
        assert console.execute("status").count("node ") == 2
        assert console.execute("quit") == "ok"
        assert quit_.is_set()


@contextmanager
def simulated(*nodes: int) -> Iterator[Simulation]:
    """Drives on a bus of their own, powered."""
    world = World()
    simulation = Simulation(world.loop)
    for node in nodes:
        simulation.add("drive", world.bus("a").join(f"node {node}"), node, node)
    simulation.start()
    try:
        yield simulation
    finally:
        simulation.stop()
