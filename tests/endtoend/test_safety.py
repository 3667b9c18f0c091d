"""What happens to the drive when a process dies: three processes on a bus that crosses them."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import pytest

from pdgw.tools.demo.run import can_server
from tests.endtoend.processes import free_tcp_port, free_udp_port, pdgw, running
from tests.endtoend.test_run import LittlePlc
from tests.support.buses import wait_for

pytestmark = [
    pytest.mark.e2e,
    # The CAN server of python-can-remote finds the killed client gone.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning"),
]


def config(channel: str, port: int) -> str:
    return (
        f'[can]\ninterface = "remote"\nchannel = "{channel}"\n'
        f"[transport]\ncyclic_port = {port}\nacyclic_port = 0\nstatus_port = 0\nwatchdog_factor = 50\n"
        "[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n"
    )


def drive_status(port: int) -> str:
    return pdgw("sim", "inject", "--port", str(port), "status").stdout


def velocity(port: int) -> int:
    match = re.search(r"velocity (-?\d+)", drive_status(port))
    return int(match[1]) if match else -1


def test_a_killed_gateway_leaves_the_drive_stopped_and_a_new_one_does_not_start_it(tmp_path: Path) -> None:
    port, control = free_udp_port(), free_tcp_port()
    path = tmp_path / "g.toml"
    with can_server() as channel:
        path.write_text(config(channel, port))
        simulator = ["sim", "drive", "--interface", "remote", "--channel", channel, "--control-port", str(control)]
        with running(*simulator, log=tmp_path / "drive.log"):
            with running("run", str(path), log=tmp_path / "first.log") as gateway:
                plc = LittlePlc(port, [1])
                plc.enable(0)
                plc.endpoint.set(0, {"NSOLL_A": 0x2000})
                plc.until(lambda: plc.signal(0, "NIST_A") > 0x1F00, "1500 rpm")
                gateway.send_signal(signal.SIGKILL)
                gateway.wait(5)
            wait_for(lambda: velocity(control) == 0, "standstill", 20)
            assert "Switch On Disabled" in drive_status(control)
            with running("run", str(path), log=tmp_path / "second.log"):
                plc.until(lambda: plc.signal(0, "ZSW1") & 0x4F == 0x40, "the new gateway has the drive")
                for _ in range(50):
                    plc.exchange()
                assert plc.signal(0, "ZSW1") & 0x4F == 0x40, "the ON that still stands does not start it"
                plc.enable(0)


def test_a_killed_drive_is_a_fault_with_bad_iops_and_comes_back_inhibited(tmp_path: Path) -> None:
    port, control = free_udp_port(), free_tcp_port()
    path = tmp_path / "g.toml"
    with can_server() as channel:
        path.write_text(config(channel, port))
        simulator = ["sim", "drive", "--interface", "remote", "--channel", channel, "--control-port", str(control)]
        with running("run", str(path), log=tmp_path / "gateway.log"):
            plc = LittlePlc(port, [1])
            with running(*simulator, log=tmp_path / "drive.log") as drive:
                plc.enable(0)
                drive.send_signal(signal.SIGKILL)
                drive.wait(5)
            plc.until(lambda: plc.endpoint.actuals[0] is None, "IOPS BAD")
            simulator[-1] = str(free_tcp_port())
            with running(*simulator, log=tmp_path / "again.log"):
                plc.until(lambda: plc.signal(0, "ZSW1") & 0x4F == 0x40, "inhibited with the ON still standing")
                plc.enable(0)
    assert "fault 101" in (tmp_path / "gateway.log").read_text()
