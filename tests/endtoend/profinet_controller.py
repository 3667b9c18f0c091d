"""Runs in a network namespace: a controller on one end of a veth pair, ``pdgw run`` on the other; prints what it saw as JSON."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from ipaddress import IPv4Interface
from pathlib import Path

from pdgw.gateway.config_file import load_config
from pdgw.gateway.profinet_identity import profinet_model
from pdgw.peers.controller.controller import Phase
from pdgw.peers.controller.project import Project
from pdgw.peers.controller.running import RunningController
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.model import API_PROFIDRIVE, INTERFACE_SUBSLOT
from pdgw.profinet.rpc.client import RecordResult

AXIS = (1, 2)
PATIENCE_S = 60.0
"""Nothing that works needs so long, on a machine however busy."""
OFF, ON = bytes.fromhex("047e0000"), bytes.fromhex("047f2000")
P965 = bytes.fromhex("02010001100003c50000")


def pair() -> subprocess.Popen[bytes]:
    """A veth pair: ``plc`` here, ``eth1`` in a namespace of its own, which lives as long as the process."""
    holder = subprocess.Popen(["unshare", "-n", "sleep", "600"])
    own = os.readlink("/proc/self/ns/net")
    while os.readlink(f"/proc/{holder.pid}/ns/net") == own:
        time.sleep(0.01)
    device = ["nsenter", "-t", str(holder.pid), "-n"]
    for command in (
        ["ip", "link", "add", "plc", "type", "veth", "peer", "name", "eth1"],
        ["ip", "link", "set", "eth1", "netns", str(holder.pid)],
        ["ip", "addr", "add", "192.168.0.1/24", "dev", "plc"],
        ["ip", "link", "set", "plc", "up"],
        [*device, "ip", "link", "set", "eth1", "up"],
        [*device, "ip", "link", "set", "lo", "up"],
    ):
        subprocess.run(command, check=True)
    return holder


def main(config: Path, pdgw: str) -> None:
    seen: dict[str, object] = {}
    holder = pair()
    gateway = subprocess.Popen(
        ["nsenter", "-t", str(holder.pid), "-n", pdgw, "run", str(config), "--record", str(config.parent)]
    )
    loaded = load_config(config)
    model = profinet_model(
        loaded.transport, bytes(6), loaded.objects, [telegram(item.telegram) for item in loaded.objects]
    )
    runner = RunningController(
        "plc", Project("press-1", model.modules, reduction_ratio=16, data_hold=100), IPv4Interface("192.168.0.2/24")
    )
    plc = runner.controller
    results: list[RecordResult] = []
    try:
        for _ in range(10):
            plc.start(time.monotonic_ns())
            if (
                runner.run(PATIENCE_S, lambda: plc.phase is Phase.DATA or plc.phase is Phase.ENDED)
                and plc.phase is Phase.DATA
            ):
                break
        seen["connected"] = plc.phase is Phase.DATA
        seen["ended"] = plc.learned.ended
        plc.set_output(AXIS, OFF)
        seen["drive ready"] = runner.run(PATIENCE_S, lambda: (plc.input(AXIS) or b"\0\0")[1] & 1)
        runner.run(0.1)
        plc.set_output(AXIS, ON)
        seen["drive runs"] = runner.run(PATIENCE_S, lambda: (plc.input(AXIS) or b"\0\0")[1] & 4)
        seen["alarms"] = sorted({(item.alarm_type, item.slot) for item in plc.learned.alarms})
        plc.write((API_PROFIDRIVE, 1, 1), 0xB02E, P965, results.append)
        runner.run(PATIENCE_S, lambda: results)
        for _ in range(1000):
            results.clear()
            plc.read((API_PROFIDRIVE, 1, 1), 0xB02E, results.append)
            runner.run(PATIENCE_S, lambda: results)
            if results and not results[0].status.value:
                break
            runner.run(0.02)
        seen["P965"] = results[0].data.hex() if results else ""
        results.clear()
        plc.read((0, 0, INTERFACE_SUBSLOT), 0x8080, results.append)
        runner.run(PATIENCE_S, lambda: results)
        seen["interface"] = results[0].status.value if results else None
        plc.set_output(AXIS, OFF)
        runner.run(0.3)
        before = runner.fresh
        seen["more frames"] = runner.run(PATIENCE_S, lambda: runner.fresh > before + 20)
        plc.release(time.monotonic_ns())
        runner.run(PATIENCE_S, lambda: plc.phase is Phase.ENDED)
        seen["released"] = plc.learned.ended
        for _ in range(10):
            plc.start(time.monotonic_ns())
            if runner.run(5, lambda: plc.phase is Phase.DATA or plc.phase is Phase.ENDED) and plc.phase is Phase.DATA:
                break
        subprocess.run(["nsenter", "-t", str(holder.pid), "-n", "ip", "addr", "flush", "dev", "eth1"], check=True)
        runner.run(5, lambda: plc.phase is Phase.ENDED)
        seen["address taken"] = plc.learned.ended
    finally:
        runner.close()
        gateway.send_signal(signal.SIGTERM)
        seen["exit status"] = gateway.wait(PATIENCE_S)
        holder.kill()
        holder.wait()
        print(json.dumps(seen))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
