"""Simulated devices from a file, their faults at run time, and their console against long lines and callers that disconnect."""

from __future__ import annotations

import errno
import os
import shlex
import signal
import socket
import socketserver
import sys
import threading
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.aborts import CanopenError
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.peers.bus import INTERFACE, ServedBus
from pdgw.peers.drive.drive_behaviours import DRIVE_HABITS
from pdgw.peers.node.node_behaviours import NODE_HABITS
from pdgw.peers.simulation import console as console_module
from pdgw.peers.simulation.config import ControlConfig, bus_file, example, load_bus, parse_bus, simulated_devices
from pdgw.peers.simulation.console import Console, PatientServer, serve
from pdgw.peers.simulation.devices import DEVICE_TYPES, Simulation
from pdgw.peers.world import World
from tests.peers.test_bus import serial_number_over
from tests.support import buses
from tests.support.buses import PATIENCE_S
from tests.support.cli import pdgw
from tests.support.gateways.daemon import axis, configuration
from tests.support.processes import free_tcp_port, running, wait_for_text

CAN = '[can]\ninterface = "virtual"\nchannel = "x"\n'


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    world = World()
    simulation = Simulation(world.loop)
    for node in (3, 4):
        simulation.add("drive", world.bus("a").join(f"node {node}"), node, node)
    simulation.start()
    yield simulation
    simulation.stop()


# -- the file -------------------------------------------------------------------------------------------------------------


def test_the_example_is_valid_and_names_its_devices_and_faults() -> None:
    config = parse_bus(example())
    assert [(device.type, device.node_id) for device in config.device] == [
        ("drive", 1),
        ("drive", 2),
        ("encoder", 10),
    ]
    assert [(fault.name, fault.values) for fault in config.device[1].fault] == [
        ("slow-sdo", {"delay_ms": 40}),
        ("reboot-in-motion", {"speed": 500}),
    ]
    assert config.device[2].options == {"model": "multi-sensor", "channels": 2, "motion": ("speed=1.5", "sine=2,10")}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"\[device\]: is missing"),
        (CAN, r"\[device\]: is missing"),
        (CAN + '[[device]]\nnode_id = 1\ntype = "pump"\n', ':4: .*type = "pump" cannot be simulated, allowed: .*drive'),
        (CAN + "[[device]]\nnode_id = 128\n", r":5: \[\[device\]\] number 1 node_id = 128"),
        (CAN + "[[device]]\nnode_id = 1\nnode = 2\n", "unknown key; did you mean node_id"),
        (CAN + "[[device]]\nnode_id = 1\n" * 2, "node_id: 1 is used twice"),
        (CAN + '[[device]]\nnode_id = 1\n[[device.fault]]\nname = "slow"\n', ":4: .*fault: 'slow' .* slow-sdo"),
        (CAN + '[[device]]\nnode_id = 1\n[[device.fault]]\nname = "slow-sdo"\ndelay_ms = 0\n', "delay_ms: 0 .* ms"),
        (CAN + '[[device]]\nnode_id = 1\n[[device.fault]]\nname = "slow-sdo"\ndelay = 1\n', "'delay' .*delay_ms"),
        (CAN + '[[device]]\nnode_id = 1\nfault = [{name = "reboot"}, {name = "reboot"}]\n', "reboot is given twice"),
        (CAN + '[[device]]\nnode_id = 1\nmotion = "still"\n', 'motion: allowed only with type = "encoder"'),
        (CAN + '[[device]]\nnode_id = 1\ntype = "encoder"\nmodel = "x"\n', "'x' .* rotary, linear, multi-sensor"),
        (CAN + '[[device]]\nnode_id = 1\ntype = "encoder"\nchannels = 2\n', r"channels of the rotary .* 1\.\.1"),
        (CAN + '[[device]]\nnode_id = 1\ntype = "encoder"\nmotion = "fly"\n', "'fly' .* speed=PER_SECOND"),
        (
            CAN + '[[device]]\nnode_id = 1\ntype = "encoder"\nmotion = ["still", "still"]\n',
            "2 values, allowed at most 1",
        ),
        (CAN + "[control]\nport = 65536\n[[device]]\nnode_id = 1\n", r":5: \[control\] port = 65536"),
        ("[", "not valid TOML"),
    ],
)
def test_a_wrong_file_is_explained_with_its_line(text: str, message: str) -> None:
    with pytest.raises(GatewayError, match=f"(?s){message}"):
        parse_bus(text, "bus.toml")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(GatewayError, match=r"none\.toml: cannot be read"):
        load_bus(tmp_path / "none.toml")


def test_faults_of_the_file_are_in_force_from_the_boot_up_message_on() -> None:
    world = World()
    simulation = Simulation(world.loop)
    heard: list[tuple[int, bytes]] = []
    world.bus("a").taps.append(lambda now, sender, can_id, data: heard.append((can_id, data)))
    world.bus("a").join("listener")
    simulation.add("drive", world.bus("a").join("node 3"), 3, 3)
    simulation.start_fault(3, "bus-off", {"recovery_ms": 0})
    simulation.start_fault(3, "emcy-burst", {"count": 3})
    simulation.start()
    world.loop.run_for(SECOND)
    assert heard == []
    simulation.end_fault(3, "bus-off")
    world.loop.run_for(SECOND)
    simulation.stop()
    assert (heard[0][0], heard[0][1][:2]) == (0x83, b"\x40\x81"), "recovered; nothing before it"


@pytest.mark.parametrize("kind", DEVICE_TYPES)
@pytest.mark.parametrize("name", NODE_HABITS)
def test_every_kind_of_device_has_the_faults_of_a_node(kind: str, name: str) -> None:
    """By this the encoder gets them with its entry in DEVICE_TYPES."""
    world = World()
    simulation = Simulation(world.loop)
    simulation.add(kind, world.bus("a").join("node 3"), 3, 3)
    simulation.start_fault(3, name, {})
    simulation.start()
    device = simulation.device(3)
    assert list(simulation.status(3)["faults"]) == [name]  # type: ignore[call-overload]
    simulation.end_fault(3)
    world.loop.run_for(SECOND)
    assert device.node.running
    simulation.stop()


def _gateway(simulate: str) -> GatewayConfig:
    return configuration(axis(7, more=f"simulate = {simulate}"))


def test_configuration_of_a_gateway_gives_its_simulated_drive_habits(tmp_path: Path) -> None:
    config = _gateway('["slow-sdo delay_ms=30", "sdo-segmented"]')
    world = World()
    world.simulate(config)
    node = world.simulations["can"].device(7).node
    assert {name: item.values for name, item in node.behaviours.items()} == {
        "slow-sdo": {"delay_ms": 30},
        "sdo-segmented": {},
    }
    (device,) = parse_bus(bus_file(config.can[0], simulated_devices(config, config.can[0]))).device
    assert [(fault.name, fault.values) for fault in device.fault] == [
        ("slow-sdo", {"delay_ms": 30}),
        ("sdo-segmented", {}),
    ]


@pytest.mark.parametrize(
    ("habit", "message"),
    [
        ("slow", r"\[\[axis\]\] do_id = 7: .*'slow' .* slow-sdo"),
        ("slow-sdo delay_ms=0", "slow-sdo delay_ms: 0 .*1 ms to 10000 ms"),
        ("slow-sdo delay_ms", r"\[\[axis\]\] do_id = 7: .*name=number"),
    ],
)
def test_wrong_habit_in_the_configuration_of_a_gateway_is_named(habit: str, message: str) -> None:
    with pytest.raises(GatewayError, match=message):
        World().simulate(_gateway(f'["{habit}"]'))


def test_clear_ends_no_habit_that_a_device_was_made_with() -> None:
    world = World()
    drive = world.drive("a", 3, habits={"sdo-segmented": {}})
    drive.do(lambda node: node.start_fault("slow-sdo"))
    assert drive.node.faults == ["slow-sdo"]
    drive.do(lambda node: node.end_fault())
    assert list(drive.node.behaviours) == ["sdo-segmented"]


# -- console --------------------------------------------------------------------------------------------------------------


def test_the_console_sets_and_removes_faults_with_parameters(simulation: Simulation) -> None:
    console = Console(simulation, threading.Event())
    assert (
        console.execute("@3 fault bouncing-status bits=0x0004 period_ms=7") == "ok: bouncing-status bits=4 period_ms=7"
    )
    assert console.execute("@3 status").endswith("misbehaves: bouncing-status")
    assert "misbehaves" not in console.execute("@4 status")
    assert console.execute("clear bouncing-status") == "ok"
    assert "misbehaves" not in console.execute("status")
    assert console.execute("@4 faults") == "node 4: " + ", ".join(DRIVE_HABITS)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("fault slow", "one of slow-sdo"),
        ("fault slow-sdo delay_ms", "name=number"),
        ("fault slow-sdo delay_ms=x", "name=number"),
        ("fault slow-sdo delay_ms=0", r"1 ms to 10000 ms"),
        ("clear slow", "one of slow-sdo"),
    ],
)
def test_a_wrong_fault_is_answered_with_what_is_allowed(simulation: Simulation, line: str, message: str) -> None:
    answer = Console(simulation, threading.Event()).execute(line)
    assert answer.startswith("error: ")
    with pytest.raises(CanopenError, match=message):
        raise CanopenError(answer, "", "")


def test_numbered_faults_are_faults_of_the_catalogue(simulation: Simulation) -> None:
    console = Console(simulation, threading.Event())
    for line in ("@3 fault 7", "@3 fault enable-input-dropped"):
        assert console.execute(line).startswith("ok")
    assert set(simulation.device(3).node.behaviours) == {"drive-fault", "enable-input-dropped"}
    assert console.execute("@3 clear enable-input-dropped") == "ok"
    assert console.execute("@3 clear") == "ok"
    assert not simulation.device(3).node.behaviours


def test_a_port_in_use_is_named(simulation: Simulation) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(GatewayError, match=f"control port: 127.0.0.1 port {port} cannot be used"):
            serve(Console(simulation, threading.Event()), port)


# -- the command ----------------------------------------------------------------------------------------------------------


@pytest.mark.e2e
def test_sim_bus_serves_the_devices_of_a_file_and_is_controlled_both_ways(tmp_path: Path) -> None:
    port = free_tcp_port()
    path = tmp_path / "bus.toml"
    path.write_text(example().replace("\nport = 0", f"\nport = {port}"))
    inject = ("sim", "inject", "--port", str(port))
    log = tmp_path / "bus.log"
    with running("sim", "bus", str(path), "--serve", "--port", "0", log=log) as process:
        wait_for_text("drive 1, drive 2, encoder 10 on pdgw-bus", log, process)
        # It prints the [can] table by which another process reaches its devices.
        bus = tomllib.loads(log.read_text().partition("drive 1")[0])["can"]
        assert bus["interface"] == INTERFACE
        assert serial_number_over(bus["channel"], 2) > 0
        drive_1, drive_2, encoder = pdgw(*inject, "status").stdout.rstrip().split("; ")
        assert "misbehaves" not in drive_1
        assert drive_2.endswith("misbehaves: slow-sdo reboot-in-motion")
        assert encoder.endswith("misbehaves: battery")
        assert pdgw(*inject, "@1", "fault", "under-voltage").stdout == "ok: under-voltage voltage=9000\n"
        assert ", fault 6, " in pdgw(*inject, "@1", "status").stdout
        assert ", warnings battery charge, " in pdgw(*inject, "@10", "status").stdout
        assert process.stdin is not None
        process.stdin.write("quit\n")
        process.stdin.flush()
        assert process.wait(buses.PATIENCE_S) == 0
    assert set(DEVICE_TYPES) == {"drive", "encoder"}


def test_signal_ends_the_simulation_in_any_thread(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    ended, hung = threading.Event(), threading.Event()

    def elsewhere(console: Console, at_end: object) -> None:
        """In the place of the console: a thread that gets the signal, while the main one waits."""

        def get() -> None:
            signal.pthread_kill(threading.get_ident(), signal.SIGTERM)
            if not ended.wait(60):
                hung.set()
                signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)

        threading.Timer(0.05, get).start()

    monkeypatch.setattr(console_module, "read_standard_input", elsewhere)
    with signals_put_back():
        try:
            console_module.run(simulation, ControlConfig(), "nothing")
        finally:
            ended.set()
    assert not hung.is_set()


@contextmanager
def signals_put_back() -> Iterator[None]:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        yield
    finally:
        for number, handler in zip((signal.SIGINT, signal.SIGTERM), before, strict=True):
            signal.signal(number, handler)


@pytest.mark.parametrize("kind", DEVICE_TYPES)
def test_devices_report_the_loss_of_their_bus_server_and_end(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    served = ServedBus()
    monkeypatch.setattr(console_module, "read_standard_input", lambda *_: served.stop())
    with signals_put_back():
        result = pdgw("sim", kind, "--interface", INTERFACE, "--channel", served.channel)
    assert (result.returncode, result.stderr.count("\n")) == (1, 1)
    assert f"{kind} 1 on {INTERFACE} {served.channel}: the bus is lost (" in result.stderr


def test_device_on_an_unplugged_interface_has_the_reason() -> None:
    world = World()
    simulation = Simulation(world.loop)
    member = world.bus("a").join("node 3")
    simulation.add("drive", member, 3, 3)
    simulation.start()
    world.loop.run_for(SECOND)
    assert simulation.check_bus() == ""
    member.unplug("unplugged")
    assert simulation.check_bus() == "unplugged"
    simulation.stop()


def test_sim_bus_accepts_its_own_example_and_explains_a_wrong_file(tmp_path: Path) -> None:
    assert pdgw("sim", "bus", "--example").stdout == example()
    path = tmp_path / "bus.toml"
    path.write_text(CAN)
    result = pdgw("sim", "bus", str(path))
    assert (result.returncode, result.stderr.count("\n")) == (1, 1)
    assert "[device]: is missing" in result.stderr


_IN_BACKGROUND = """
import threading
from pdgw.peers.simulation import console

class Clock:
    def sleep(self, seconds):
        paused.set()
        threading.Event().wait()

paused, console.time = threading.Event(), Clock()
console.read_standard_input(None)
paused.wait()
print("not", "stopped", flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="job control")
def test_a_simulator_in_the_background_of_a_terminal_is_not_stopped() -> None:
    import pty  # noqa: PLC0415 (not on Windows)

    job = f"set -m; {shlex.quote(sys.executable)} -c {shlex.quote(_IN_BACKGROUND)} & wait; echo status $?"
    child, terminal = pty.fork()
    if not child:
        os.execvp("bash", ["bash", "-c", job])
    shown = b""
    with suppress(OSError):  # Linux reports the end of a terminal as an error
        while part := os.read(terminal, 4096):
            shown += part
    os.close(terminal)
    os.waitpid(child, 0)
    assert b"not stopped" in shown
    assert b"status 0" in shown


NOTHING = cast(Simulation, SimpleNamespace(nodes=[]))


@pytest.fixture
def console_port() -> Iterator[int]:
    server = serve(Console(NOTHING, threading.Event()), 0)
    yield int(server.server_address[1])
    server.shutdown()
    server.server_close()


def talk(port: int, data: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as connection:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        answer = b""
        try:
            while part := connection.recv(65536):
                answer += part
        except ConnectionResetError:
            pass
        return answer


def test_a_command_of_any_length_is_answered_or_refused(console_port: int) -> None:
    assert talk(console_port, b"\n") == b"ok\n"
    answer = talk(console_port, b"x" * 1001)
    assert answer == b"error: a command has at most 1000 characters\n"
    with socket.create_connection(("127.0.0.1", console_port), timeout=PATIENCE_S) as connection:
        connection.sendall(b"x" * 50_000)
        assert connection.recv(1000).startswith(b"error: a command has at most")


def test_clients_that_disconnect_early_cause_no_messages(console_port: int, capsys: pytest.CaptureFixture[str]) -> None:
    for data in [b"status\n" * 1000, b"s"] * 5:
        connection = socket.create_connection(("127.0.0.1", console_port), timeout=PATIENCE_S)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        connection.sendall(data)
        connection.close()  # with a reset
    assert talk(console_port, b"\n") == b"ok\n"
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(("number", "pauses"), [(errno.EMFILE, 1), (errno.ECONNABORTED, 0)])
def test_a_server_without_descriptors_pauses_where_its_port_would_keep_it_busy(
    number: int, pauses: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []
    monkeypatch.setattr(console_module, "time", SimpleNamespace(sleep=slept.append))

    def accept() -> None:
        raise OSError(number, "not now")

    with PatientServer(("127.0.0.1", 0), socketserver.BaseRequestHandler) as server, server.socket:
        server.socket = cast(socket.socket, SimpleNamespace(accept=accept, close=server.socket.close))
        with pytest.raises(OSError, match="not now"):
            server.get_request()
    assert len(slept) == pauses
