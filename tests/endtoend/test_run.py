"""``pdgw run`` as a user starts it: real processes, real sockets, a simulated drive inside."""

from __future__ import annotations

import json
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from pdgw.gateway.status_client import fetch
from pdgw.peers.plc.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram
from tests.endtoend.processes import free_tcp_port, free_udp_port, pdgw, running
from tests.support.buses import wait_for

pytestmark = pytest.mark.e2e
CYCLE = 4_000_000
OFF, ON = 0x047E, 0x047F
PATIENT = ("--cycle-time-ms", "100")
"""So long may the PLC be busy with something else, or not get the processor, before it is lost: three times that."""


class LittlePlc:
    """The least a PLC has to do."""

    def __init__(self, port: int, numbers: list[int]) -> None:
        self.endpoint = PlcEndpoint([telegram(number) for number in numbers], CYCLE)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(CYCLE / 1e9)

    def exchange(self) -> None:
        try:
            self.socket.send(self.endpoint.build(time.monotonic_ns()))
            while True:
                self.endpoint.receive(self.socket.recv(2048))
        except (TimeoutError, ConnectionRefusedError):
            return

    def until(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 30
        while not condition():
            assert time.monotonic() < deadline, f"{what}: {self.endpoint.actuals}"
            self.exchange()

    def signal(self, axis: int, name: str) -> int:
        actuals = self.endpoint.actuals[axis]
        return -1 if actuals is None else actuals[name]

    def enable(self, axis: int) -> None:
        first = next(iter(self.endpoint.setpoints[axis]))
        off = 0x043E if self.endpoint.telegrams[axis].number == 9 else OFF
        self.endpoint.set(axis, {first: off})
        self.until(lambda: self.signal(axis, "ZSW1") & 0x4F == 0x01, "ready")
        self.endpoint.set(axis, {first: off | 1})
        self.until(lambda: self.signal(axis, "ZSW1") & 0x4F == 0x07, "operation")


def test_no_signal_ends_the_gateway_without_the_stop_sequence(tmp_path: Path) -> None:
    log, moved = tmp_path / "gateway.log", tmp_path / "gateway.log.1"
    options = ["--cyclic-port", "0", "--acyclic-port", "0", "--status-port", "0", "--log-file", str(log)]
    with running("run", "--simulate", *options, log=tmp_path / "stderr") as process:
        wait_for(lambda: log.exists() and "cyclic exchange" in log.read_text(), "started", 30)
        process.send_signal(signal.SIGUSR1)
        wait_for(lambda: "signal ignored" in log.read_text(), "SIGUSR1 is told", 10)
        log.rename(moved)
        process.send_signal(signal.SIGHUP)
        wait_for(log.exists, "a new file", 10)
        process.send_signal(signal.SIGQUIT)
        assert process.wait(20) == 0
    assert "stopping the drives" in log.read_text()
    assert "stopping the drives" not in moved.read_text()
    assert "Traceback" not in (tmp_path / "stderr").read_text()


def test_simulated_axis_with_telegram_1_turns_and_stops_on_sigterm(tmp_path: Path) -> None:
    port, status = free_udp_port(), free_tcp_port()
    log = tmp_path / "log"
    options = [*PATIENT, "--cyclic-port", str(port), "--acyclic-port", "0", "--status-port", str(status)]
    with running("run", "--simulate", *options, log=log) as process:
        plc = LittlePlc(port, [1])
        plc.enable(0)
        plc.endpoint.set(0, {"NSOLL_A": 0x2000})
        plc.until(lambda: plc.signal(0, "NIST_A") == 0x2000, "1500 rpm")
        axis = fetch(status)["axes"][0]
        assert (axis["state"], axis["drive_state"]) == ("Obeys the PLC", "Operation Enabled")
        assert axis["velocity"] == 3000
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
    text = log.read_text()
    assert "stopping the drives" in text
    assert text.rstrip().endswith("stopped")
    assert "Traceback" not in text


def test_a_simulated_encoder_turns_with_the_shaft_of_its_axis(tmp_path: Path) -> None:
    port = free_udp_port()
    options = [*PATIENT, "--cyclic-port", str(port), "--acyclic-port", "0", "--status-port", "0", "--encoders", "1"]
    with running("run", "--simulate", "--encoder-telegram", "83", *options, log=tmp_path / "log"):
        plc = LittlePlc(port, [1, 83])
        plc.enable(0)
        plc.endpoint.set(0, {"NSOLL_A": 0x2000})
        plc.until(lambda: plc.signal(0, "NIST_A") == 0x2000, "1500 rpm of the drive")
        plc.until(lambda: abs(plc.signal(1, "NIST_B") - 0x2000_0000) < 0x80_0000, "1500 rpm of the encoder")


def test_two_axes_with_telegram_9_home_and_move(tmp_path: Path) -> None:
    port = free_udp_port()
    options = [*PATIENT, "--cyclic-port", str(port), "--acyclic-port", "0", "--status-port", "0"]
    with running("run", "--simulate", "--telegram", "9", "--axes", "2", *options, log=tmp_path / "log"):
        plc = LittlePlc(port, [9, 9])
        for axis in (0, 1):
            plc.enable(axis)
        target = 0x0100_0000
        plc.endpoint.set(
            1,
            {"SATZANW": 0x8000, "MDI_TARPOS": target, "MDI_VELOCITY": 1 << 30, "MDI_ACC": 1 << 14, "MDI_DEC": 1 << 14}
            | {"MDI_MOD": 1, "STW1": 0x047F},
        )
        plc.until(lambda: bool(plc.signal(1, "ZSW1") & 0x1000), "task acknowledged")
        plc.endpoint.set(1, {"STW1": 0x043F})
        plc.until(lambda: plc.signal(1, "ZSW1") & 0x0400 and abs(plc.signal(1, "XIST_A") - target) < 4000, "target")
        assert plc.signal(0, "XIST_A") == 0, "the other axis stands"


def test_the_gateway_survives_garbage_and_counts_it(tmp_path: Path) -> None:
    port, status = free_udp_port(), free_tcp_port()
    options = [*PATIENT, "--cyclic-port", str(port), "--acyclic-port", "0", "--status-port", str(status)]
    with running("run", "--simulate", *options, log=tmp_path / "log"):
        plc = LittlePlc(port, [1])
        plc.enable(0)
        garbage = (b"", b"x", bytes(46), bytes(1500), b"\xc0\x01")
        intruder = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        # A stranger beside a connected PLC is counted, or dropped by the kernel before it costs anything.
        for data in (*garbage, bytes(plc.endpoint.build())):
            intruder.sendto(data, ("127.0.0.1", port))
        for data in garbage:
            plc.socket.send(data)
        plc.endpoint.set(0, {"NSOLL_A": 0x1000})
        plc.until(lambda: plc.signal(0, "NIST_A") == 0x1000, "still turning")
        document = json.loads(pdgw("status", "--port", str(status), "--json").stdout)
        frames = document["plc"]["frames"]
        assert frames["truncated"] >= 3
        assert frames["oversized"] >= 1
        assert frames["wrong FrameID"] >= 1


def test_log_file_and_can_log_are_complete_at_the_end(tmp_path: Path) -> None:
    port = free_udp_port()
    log, frames = tmp_path / "gateway.log", tmp_path / "can.log"
    options = [*PATIENT, "--cyclic-port", str(port), "--acyclic-port", "0", "--status-port", "0"]
    with running(
        "run", "--simulate", *options, "--log-file", str(log), "--can-log", str(frames), log=tmp_path / "err"
    ) as process:
        LittlePlc(port, [1]).enable(0)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    assert (tmp_path / "err").read_text() == ""
    assert log.read_text().rstrip().endswith("stopped")
    recorded = [(message.arbitration_id, bytes(message.data)) for message in can.CanutilsLogReader(frames)]
    controlwords = [data[-2:].hex() for identifier, data in recorded if identifier == 0x201]
    first = [controlwords.index(word) for word in ("0600", "0700", "0f00")]
    assert first == sorted(first), "Shutdown, Switch On, Enable Operation in this order"
    assert recorded[-1] == (0, bytes((0x80, 1))), "the last frame is NMT pre-operational"


def test_provider_stop_stops_the_drive(tmp_path: Path) -> None:
    port = free_udp_port()
    options = [*PATIENT, "--cyclic-port", str(port), "--acyclic-port", "0", "--status-port", "0"]
    with running("run", "--simulate", *options, log=tmp_path / "log"):
        plc = LittlePlc(port, [1])
        plc.enable(0)
        plc.endpoint.set(0, {"NSOLL_A": 0x2000})
        plc.until(lambda: plc.signal(0, "NIST_A") == 0x2000, "1500 rpm")
        plc.endpoint.run = False
        plc.until(lambda: plc.signal(0, "NIST_A") == 0 and plc.signal(0, "ZSW1") & 0x4F == 0x40, "stopped")
        plc.endpoint.run = True
        for _ in range(20):
            plc.exchange()
        assert plc.signal(0, "ZSW1") & 0x4F == 0x40, "a standing ON does not restart it"


def test_a_scenario_that_reaches_no_gateway_fails_and_says_what_to_start(tmp_path: Path) -> None:
    path = tmp_path / "story.yaml"
    path.write_text("steps: [{speed: 10 %}, {hold: 20 ms}]\n")
    result = pdgw("sim", "plc", str(path), "--gateway", "127.0.0.1:9", "--json", str(tmp_path / "r.json"))
    assert result.returncode == 1
    assert "the scenario has not reached a gateway: no datagram of a gateway came: start one" in result.stderr
    assert json.loads((tmp_path / "r.json").read_text())["passed"] is False


def test_drive_simulator_obeys_its_console_and_inject(tmp_path: Path) -> None:
    control = free_tcp_port()
    log = tmp_path / "log"
    with running("sim", "drive", "--node-id", "3", "--control-port", str(control), log=log) as process:
        wait_for(lambda: "commands:" in log.read_text(), "started")
        assert pdgw("sim", "inject", "--port", str(control), "fault", "7").stdout.strip() == "ok: fault 7, over-current"
        wait_for(lambda: "fault 7" in pdgw("sim", "inject", "--port", str(control), "status").stdout, "fault shown")
        bad = pdgw("sim", "inject", "--port", str(control), "fault", "13")
        assert bad.returncode == 1
        assert "fault number: 13" in bad.stderr
        assert "is no command" in pdgw("sim", "inject", "--port", str(control), "dance").stderr
        assert process.stdin is not None
        process.stdin.write("quit\n")
        process.stdin.flush()
        assert process.wait(10) == 0


def test_interactive_plc_turns_the_drive_from_the_keyboard(tmp_path: Path) -> None:
    port, status = free_udp_port(), free_tcp_port()
    options = [*PATIENT, "--cyclic-port", str(port), "--acyclic-port", "0", "--status-port", str(status)]
    with (
        running("run", "--simulate", *options, log=tmp_path / "gateway.log"),
        running("sim", "plc", "--interactive", "--gateway", f"127.0.0.1:{port}", log=tmp_path / "plc.log") as plc,
    ):
        assert plc.stdin is not None

        def state() -> str:
            result = pdgw("status", "--port", str(status), "--json")
            if result.returncode:
                return ""
            axis = json.loads(result.stdout)["axes"][0]
            return f"{axis['drive_state']} {axis['velocity']}"

        wait_for(lambda: state().startswith("Switch On Disabled"), "online", 30)
        plc.stdin.write("e")
        plc.stdin.flush()
        wait_for(lambda: state().startswith("Operation Enabled"), "enabled", 30)
        plc.stdin.write("+")
        plc.stdin.flush()
        wait_for(lambda: state() == "Operation Enabled 600", "10 %", 30)
        plc.stdin.write("ox")
        plc.stdin.flush()
        assert plc.wait(10) == 0
