"""Runs in a network namespace: a controller on one end of a veth pair, ``pdgw run`` on the other; prints what it saw as JSON."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from ipaddress import IPv4Interface
from pathlib import Path

from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.links.profinet.station import profinet_model
from pdgw.peers.controller.controller import Phase
from pdgw.peers.controller.plc import RunningController
from pdgw.peers.controller.project import Project
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.model import API_PROFIDRIVE, INTERFACE_SUBSLOT
from pdgw.profinet.rpc.client import RecordResult
from pdgw.tools.demo.namespaces import VethPair

AXIS = (1, 2)
PATIENCE_S = 60.0
"""Longest time of any step, also on a busy machine."""
OFF, ON = bytes.fromhex("047e0000"), bytes.fromhex("047f2000")
IP_ADDRESS_LOST = "CF 81 FD 1F"
TRIES = 10
P965 = bytes.fromhex("02010001100003c50000")


def pair() -> subprocess.Popen[bytes]:
    """A veth pair: ``plc`` here, ``eth1`` in a namespace of its own, which lives as long as the process."""
    holder = subprocess.Popen(["unshare", "-n", "sleep", "3600"])
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


def connected(runner: RunningController) -> bool:
    plc = runner.controller
    plc.start(time.monotonic_ns())
    runner.run(PATIENCE_S, lambda: plc.phase in {Phase.DATA, Phase.ENDED})
    return plc.phase is Phase.DATA


def moves(runner: RunningController, seen: dict[str, object]) -> bool:
    """Connect, turn the drive, read records and release; False if a step failed, such as when the relationship ended.

    No data hold time is longer than 1.92 s: on a busy machine a relationship may time out.
    """
    plc = runner.controller
    results: list[RecordResult] = []

    def comes(name: str, condition: Callable[[], object]) -> bool:
        came = runner.run(PATIENCE_S, lambda: condition() or plc.phase is Phase.ENDED) and plc.phase is Phase.DATA
        seen[name] = came
        return came

    def answered(record: tuple[int, int, int], index: int) -> RecordResult | None:
        results.clear()
        plc.read(record, index, results.append)
        comes(f"answer {index:X}", lambda: results)
        return results[0] if results else None

    seen["connected"] = connected(runner)
    plc.set_output(AXIS, OFF)
    if not (seen["connected"] and comes("drive ready", lambda: (plc.input(AXIS) or b"\0\0")[1] & 1)):
        return False
    plc.set_output(AXIS, ON)
    if not comes("drive runs", lambda: (plc.input(AXIS) or b"\0\0")[1] & 4):
        return False
    seen["alarms"] = sorted({(item.alarm_type, item.slot) for item in plc.learned.alarms})
    plc.write((API_PROFIDRIVE, 1, 1), 0xB02E, P965, results.append)
    comes("P965 asked", lambda: results)
    for _ in range(1000):
        answer = answered((API_PROFIDRIVE, 1, 1), 0xB02E)
        if answer is None or not answer.status.value:
            break
        runner.run(0.02)
    seen["P965"] = answer.data.hex() if answer is not None else ""
    answer = answered((0, 0, INTERFACE_SUBSLOT), 0x8080)
    seen["interface"] = answer.status.value if answer is not None else None
    plc.set_output(AXIS, OFF)
    before = runner.fresh
    if not comes("more frames", lambda: runner.fresh > before + 20):
        return False
    plc.release(time.monotonic_ns())
    runner.run(PATIENCE_S, lambda: plc.phase is Phase.ENDED)
    seen["ended"] = plc.learned.ended
    return seen["ended"] == "released"


def ends_without_its_address(runner: RunningController, flush: list[str]) -> bool:
    """The gateway whose interface loses its address ends the relationship and says why; False when something else ended it."""
    if not connected(runner):
        return False
    subprocess.run(flush, check=True)
    runner.run(PATIENCE_S, lambda: runner.controller.phase is Phase.ENDED)
    return IP_ADDRESS_LOST in runner.controller.learned.ended


def main(config: Path, pdgw: str) -> None:
    seen: dict[str, object] = {}
    for _ in range(5):  # the next virtual pair can be made at once
        with VethPair():
            pass
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
    try:
        seen["moved"] = any(moves(runner, seen) for _ in range(TRIES))
        flush = ["nsenter", "-t", str(holder.pid), "-n", "ip", "addr", "flush", "dev", "eth1"]
        seen["address taken"] = any(ends_without_its_address(runner, flush) for _ in range(TRIES))
    finally:
        runner.close()
        gateway.send_signal(signal.SIGTERM)
        seen["exit status"] = gateway.wait(PATIENCE_S)
        holder.kill()
        holder.wait()
        print(json.dumps(seen))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
