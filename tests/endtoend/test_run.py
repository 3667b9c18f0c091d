"""``pdgw run`` as a user starts it: real processes, real sockets, a simulated drive inside."""

from __future__ import annotations

import json
import os
import pty
import signal
import socket
import subprocess
import threading
from pathlib import Path

import pytest

from pdgw.gateway.service.status_client import fetch
from pdgw.tools.commands.capture.timeline import replay, timeline
from pdgw.tools.recording.recorder import CAPTURE
from tests.support.buses import PATIENCE_S, wait_for
from tests.support.cli import pdgw
from tests.support.gateways.fault_display import drive_state
from tests.support.gateways.socket_plc import SocketPlc
from tests.support.processes import COMMAND, free_tcp_port, free_udp_port, running, wait_for_text
from tests.support.readers.captures import can_frames

pytestmark = pytest.mark.e2e
LONG_CYCLE = ("--cycle-time-ms", "100")
"""A hundred times this time may pass without a frame of the PLC before it counts as lost: a busy machine delays it."""


def test_axis_and_encoder_turn_until_provider_stop_and_every_signal_completes_the_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port, status = free_udp_port(), free_tcp_port()
    log, moved = tmp_path / "gateway.log", tmp_path / "gateway.log.1"
    options = [*LONG_CYCLE, "--cyclic-port", str(port), "--acyclic-port", "0", "--status-port", str(status)]
    options += ["--encoders", "1", "--encoder-telegram", "83"]
    options += ["--log-file", str(log), "--record", str(tmp_path / "record")]
    with running("run", "--simulate", *options, log=tmp_path / "stderr") as process:
        turn_despite_other_traffic(SocketPlc(("127.0.0.1", port), [1, 83]), port, status)
        process.send_signal(signal.SIGUSR1)
        wait_for_text("signal ignored", log, process)
        log.rename(moved)
        process.send_signal(signal.SIGHUP)
        wait_for(log.exists, "a new file")
        process.send_signal(signal.SIGQUIT)
        assert process.wait(PATIENCE_S) == 0
    assert (tmp_path / "stderr").read_text() == ""
    assert "stopping the drives" in log.read_text()
    assert log.read_text().rstrip().endswith("stopped")
    assert "stopping the drives" not in moved.read_text()
    assert "Traceback" not in moved.read_text()

    capture = tmp_path / "record" / CAPTURE
    recorded = can_frames(capture)
    controlwords = [data[-2:].hex() for identifier, data in recorded if identifier == 0x201]
    first = [controlwords.index(word) for word in ("0600", "0700", "0f00")]
    assert first == sorted(first), "Shutdown, Switch On, Enable Operation in this order"
    of_the_drive = [frame for frame in recorded if frame[0] or frame[1][1] in {0, 1}]
    assert of_the_drive[-1] == (0, bytes((0x80, 1))), "the last frame is NMT pre-operational"

    # Timeline and replay need only what the gateway recorded, and report no false alarms.
    timeline([str(capture)])
    told = capsys.readouterr().out
    assert "+OPERATION_ENABLED" in told
    assert "clocks: one clock" in told
    assert "assumed:" not in told
    assert "differs from the rules of this version" not in told
    replay([str(capture)])
    assert all(line.endswith("all equal") for line in capsys.readouterr().out.splitlines())


def turn_despite_other_traffic(plc: SocketPlc, port: int, status: int) -> None:
    """Until the provider stops; the ON that stays afterwards starts nothing."""
    plc.enable(0)
    plc.endpoint.set(0, {"NSOLL_A": 0x2000})
    plc.until(lambda: plc.value("NIST_A") == 0x2000, "1500 rpm of the drive")
    plc.until(lambda: abs(plc.value("NIST_B", 1) - 0x2000_0000) < 0x80_0000, "1500 rpm of the encoder")
    axis = fetch(status, PATIENCE_S)["axes"][0]
    assert (axis["state"], axis["drive_state"]) == ("In operation", "Operation Enabled")
    assert axis["velocity"] == 3000

    garbage = (b"", b"x", bytes(46), bytes(1500), b"\xc0\x01")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as intruder:
        # Frames of an unknown sender beside a connected PLC are counted, or the kernel drops them at no cost.
        for data in (*garbage, bytes(plc.endpoint.build())):
            intruder.sendto(data, ("127.0.0.1", port))
    for data in garbage:
        plc.port.send(data, plc.gateway)
    plc.endpoint.set(0, {"NSOLL_A": 0x1000})
    plc.until(lambda: plc.value("NIST_A") == 0x1000, "still turning")
    frames = json.loads(pdgw("status", "--port", str(status), "--json").stdout)["plc"]["frames"]
    assert frames["truncated"] >= 3
    assert frames["oversized"] >= 1
    assert frames["wrong FrameID"] >= 1

    plc.endpoint.run = False
    plc.until(lambda: plc.value("NIST_A") == 0 and drive_state(plc.value("ZSW1")) == 0x40, "stopped")
    plc.endpoint.run = True
    plc.stays_off(0)


def test_simulated_devices_accept_console_commands_and_faults(tmp_path: Path) -> None:
    control, other = free_tcp_port(), free_tcp_port()
    log, encoder_log = tmp_path / "drive.log", tmp_path / "encoder.log"
    encoder = ["--node-id", "10", "--motion", "still=1.5", "--control-port", str(other)]
    with (
        running("sim", "drive", "--node-id", "3", "--control-port", str(control), log=log) as process,
        running("sim", "encoder", *encoder, log=encoder_log) as turning,
    ):
        wait_for_text("commands:", log, process)
        assert pdgw("sim", "inject", "--port", str(control), "fault", "7").stdout.strip() == "ok: fault 7, over-current"
        wait_for(lambda: "fault 7" in pdgw("sim", "inject", "--port", str(control), "status").stdout, "fault shown")
        bad = pdgw("sim", "inject", "--port", str(control), "fault", "13")
        assert bad.returncode == 1
        assert "fault number: 13" in bad.stderr
        assert "is not a command" in pdgw("sim", "inject", "--port", str(control), "dance").stderr
        assert process.stdin is not None
        process.stdin.write("quit\n")
        process.stdin.flush()
        assert process.wait(PATIENCE_S) == 0

        wait_for_text("rotary encoder 10 on virtual", encoder_log, turning)
        assert pdgw("sim", "inject", "--port", str(other), "fault", "temperature").stdout == "ok: temperature\n"
        answer = pdgw("sim", "inject", "--port", str(other), "status").stdout
        assert "node 10: encoder, NMT PRE_OPERATIONAL, model rotary, position [6144]" in answer
        assert "misbehaves: temperature" in answer


def test_the_keyboard_turns_the_drive_from_a_terminal_which_is_restored(tmp_path: Path) -> None:
    port, status = free_udp_port(), free_tcp_port()
    master, slave = pty.openpty()
    shown = bytearray()

    def read() -> None:
        try:
            while data := os.read(master, 4096):
                shown.extend(data)
        except OSError:  # error of a terminal whose other end is closed
            return

    def until_shown(*texts: bytes) -> bytes:
        wait_for(lambda: any(text in shown for text in texts), str(texts))
        return bytes(shown)

    options = [*LONG_CYCLE, "--cyclic-port", str(port), "--acyclic-port", "0", "--status-port", str(status)]
    with running("run", "--simulate", *options, log=tmp_path / "gateway.log") as gateway:
        before = subprocess.run(["stty", "-g"], stdin=slave, capture_output=True, text=True, check=True).stdout
        environment = {**os.environ, "TERM": "xterm", "COLUMNS": "160", "LINES": "50"}
        with subprocess.Popen(
            [*COMMAND, "sim", "plc", "--interactive", "--gateway", f"127.0.0.1:{port}"],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env=environment,
        ) as plc:
            reader = threading.Thread(target=read, daemon=True)
            reader.start()
            try:
                wait_for(lambda: b"SWITCHING_ON_INHIBITED" in shown, "the drive's first state")
                for key, text in ((b"e", b"OPERATION_ENABLED"), (b"+", b"9.998 %")):
                    shown.clear()
                    os.write(master, key)
                    while b"not met" in until_shown(
                        text, b"not met"
                    ):  # the PLC gave up waiting for a drive that was held up
                        shown.clear()
                        os.write(master, key)
                wait_for(lambda: fetch(status, PATIENCE_S)["axes"][0]["velocity"] == 600, "10 %")
                shown.clear()
                os.write(master, b"q")
                wait_for(lambda: b"SWITCHING_ON_INHIBITED" in shown, "quick stop")
                os.write(master, b"x")
                assert plc.wait(PATIENCE_S) == 0
            finally:
                plc.kill()
        after = subprocess.run(["stty", "-g"], stdin=slave, capture_output=True, text=True, check=True).stdout
        gateway.send_signal(signal.SIGINT)
        assert gateway.wait(PATIENCE_S) == 0
    os.close(slave)
    reader.join(PATIENCE_S)
    os.close(master)
    assert after == before
    assert b"Traceback" not in shown
