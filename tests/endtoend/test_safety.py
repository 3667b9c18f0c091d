"""What happens to the drive when a process dies: processes on a bus that crosses them."""

from __future__ import annotations

import re
import subprocess
from contextlib import ExitStack
from pathlib import Path

import pytest

from pdgw.gateway.trace.place import rings, run_directory
from pdgw.peers.bus import INTERFACE, ServedBus
from tests.support.buses import PATIENCE_S, wait_for
from tests.support.cli import pdgw
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


def drive_status(port: int) -> str:
    return pdgw("sim", "inject", "--port", str(port), "status").stdout


def is_stopped_and_off(port: int) -> bool:
    """False also while a busy simulator does not answer."""
    status = drive_status(port)
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
            plc.until(lambda: plc.signal(0, "ZSW1") & 0x4F == 0x40, what)
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
        plc.until(lambda: plc.signal(0, "NIST_A") > 0x1F00, "1500 rpm")
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
