"""What happens to the drive when a process dies or hangs: processes on a bus that crosses them, and the page beside a gateway."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from pdgw.gateway.base.run_directory import rings, run_directory
from pdgw.gateway.service.status_client import fetch
from pdgw.peers.bus import INTERFACE, ServedBus
from tests.support.buses import PATIENCE_S, wait_for
from tests.support.cli import pdgw
from tests.support.gateways.fault_display import drive_state
from tests.support.gateways.socket_plc import SocketPlc
from tests.support.processes import PATIENT, free_tcp_port, free_udp_port, running, wait_for_text

pytestmark = pytest.mark.e2e


def config(channel: str, port: int) -> str:
    return (
        f'[can]\ninterface = "{INTERFACE}"\nchannel = "{channel}"\n'
        f"[transport]\ncyclic_port = {port}\nacyclic_port = 0\nstatus_port = 0\ncycle_time_ms = 20\nwatchdog_factor = 250\n"
        '[trace]\nkeep = ["stop"]\n'
        "[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n" + PATIENT
    )


def is_stopped_and_off(port: int) -> bool:
    """What the console of the drive says."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as console:
        console.sendall(b"status\n")
        status = console.makefile().readline()
    return "Switch On Disabled" in status and re.search(r"velocity 0\b", status) is not None


def test_killed_plc_gateway_or_drive_stops_the_axis_without_a_restart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    port = free_udp_port()
    path = tmp_path / "plant.toml"
    with ServedBus() as bus, ExitStack() as at_end:
        path.write_text(config(bus.channel, port))

        def drive(log: str) -> tuple[subprocess.Popen[str], int]:
            control = free_tcp_port()
            place = ("--interface", INTERFACE, "--channel", bus.channel)
            command = ("sim", "drive", *place, "--control-port", str(control))
            return at_end.enter_context(running(*command, log=tmp_path / log)), control

        def gateway(log: str) -> subprocess.Popen[str]:
            return at_end.enter_context(running("run", str(path), log=tmp_path / log))

        def inhibited(what: str) -> None:
            plc.until(lambda: drive_state(plc.value("ZSW1")) == 0x40, what)
            plc.stays_off(0)

        first, _ = drive("drive.log")
        killed = gateway("first.log")
        plc = SocketPlc(("127.0.0.1", port), [1])
        plc.enable(0)
        first.kill()
        plc.until(lambda: plc.endpoint.actuals[0] is None, "IOPS BAD")
        _, control = drive("again.log")
        inhibited("the drive is back")
        wait_for_text("fault 101", tmp_path / "first.log", killed)

        plc.enable(0)
        plc.endpoint.set(0, {"NSOLL_A": 0x2000})
        plc.until(lambda: plc.value("NIST_A") > 0x1F00, "1500 rpm")
        assert [ring.name for ring in rings() if ring.name.startswith("plant")] == ["plant.ring"]
        killed.kill()
        killed.wait(PATIENCE_S)
        wait_for(lambda: is_stopped_and_off(control), "standstill without power")
        what_the_killed_gateway_left(tmp_path)

        gateway("second.log")
        inhibited("the new gateway has the drive")
        plc.enable(0)


def what_the_killed_gateway_left(folder: Path) -> None:
    """Its flight recorder, and what was kept of it."""
    assert "plant.ring: killed" in pdgw("trace", "list").stdout
    saved = pdgw("trace", "save", str(folder / "x.pcapng"), "--ring", "plant")
    assert "packets of plant.ring (killed)" in saved.stdout, saved.stderr
    wait_for(lambda: list((folder / "pdgw/traces").glob("plant-*-killed.pcapng")), "kept")
    directory = run_directory()
    assert directory is not None
    assert {file.stat().st_mode & 0o777 for file in (directory / "plant.ring").iterdir()} == {0o440}


OFF, ON = 0x047E, 0x047F


def page_of(process: int) -> int:
    """The process id of the page a gateway has started."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    (found,) = [int(child) for child in children if b"\0web\0" in Path(f"/proc/{child}/cmdline").read_bytes()]
    return found


@contextmanager
def exchanging(port: int) -> Iterator[SocketPlc]:
    """The PLC sends a frame in each cycle, whatever the test does meanwhile."""
    plc = SocketPlc(("127.0.0.1", port), [1])
    plc.start()
    thread = threading.Thread(target=plc.loop.run, name="PLC", daemon=True)
    thread.start()
    try:
        yield plc
    finally:
        plc.loop.call_threadsafe(plc.loop.stop)
        thread.join()
        plc.stop()


@pytest.mark.e2e
def test_a_page_that_is_frozen_flooded_and_killed_changes_nothing_for_the_plc(tmp_path: Path) -> None:
    cyclic, status, web = free_udp_port(), free_tcp_port(), free_tcp_port()
    config = tmp_path / "gateway.toml"
    config.write_text(
        f'[can]\ninterface = "virtual"\nchannel = "page"\n[web]\nlisten = "127.0.0.1:{web}"\n[transport]\n'
        f"cyclic_port = {cyclic}\nacyclic_port = {free_udp_port()}\nstatus_port = {status}\n"
        "cycle_time_ms = 40\nwatchdog_factor = 255\n"
        "[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\nsimulate = true\n" + PATIENT
    )

    def answers() -> bool:
        with contextlib.suppress(OSError, ValueError):
            with urllib.request.urlopen(f"http://127.0.0.1:{web}/api/v1/status", timeout=PATIENCE_S) as answer:
                document = json.loads(answer.read())
            return bool(document["axes"][0]["state_id"] == "OBEYS" and not document["stale"])
        return False

    def counted(name: str) -> int:
        counters = fetch(status, PATIENCE_S)["counters"]
        return next(item["value"] for item in counters if (item["part"], item["name"]) == ("link", name))

    with running("run", str(config), "--web", log=tmp_path / "log") as gateway, exchanging(cyclic) as plc:
        plc.endpoint.set(0, {"STW1": OFF})
        wait_for(lambda: drive_state(plc.value("ZSW1")) == 0x01, "the drive")
        plc.endpoint.set(0, {"STW1": ON, "NSOLL_A": 0x2000})
        wait_for(lambda: plc.value("NIST_A") == 0x2000, "half speed")
        wait_for(answers, "the page")
        lost, accepted = counted("watchdog_expiries"), counted("accepted")
        page = page_of(gateway.pid)

        os.kill(page, signal.SIGSTOP)
        flood = [socket.create_connection(("127.0.0.1", web), timeout=PATIENCE_S) for _ in range(60)]
        for connection in flood:
            connection.sendall(b"GET /api/v1/objects/1/trace HTTP/1.1\r\nHost: localhost\r\n\r\n" * 10)
        wait_for(lambda: counted("accepted") > accepted + 50, "frames while the page is frozen and flooded")
        os.kill(page, signal.SIGCONT)
        wait_for(lambda: counted("accepted") > accepted + 100, "frames while the page works on the flood")
        for connection in flood:
            connection.close()
        wait_for(answers, "the page after the flood")
        os.kill(page, signal.SIGKILL)
        wait_for(lambda: counted("accepted") > accepted + 150, "frames after the page was killed")

        wait_for(
            lambda: plc.value("NIST_A") == 0x2000, "still half speed: an axis that was stopped would not turn again"
        )
        assert counted("watchdog_expiries") == lost
        assert fetch(status, PATIENCE_S)["axes"][0]["state_id"] == "OBEYS"
