"""Twenty axes on a slow bus whose interface has a short queue, recorded by candump."""

from __future__ import annotations

import subprocess
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.interfaces import open_bus
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.bus.port import open_port
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.dsp402.drive.client import DriveClient
from pdgw.dsp402.drive.images import DriveCommand
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.states import Command
from pdgw.gateway.axis.telegrams import drive_layout
from pdgw.profidrive.telegrams import telegram
from tests.can import interfaces
from tests.can.interfaces import Wire
from tests.support.axis.mapping import straight_plan
from tests.support.buses import PATIENCE_S, wait_for

AXES = 20
CYCLES = 50
CYCLE = 50 * MS
FASTEST = 9999
QUEUES = {
    "txqueuelen": ["netem", "rate", "100kbit", "limit", "10"],
    "socket buffer": ["tbf", "rate", "100kbit", "burst", "64", "limit", "16000"],
}
"""A frame is 16 bytes to the kernel, 1.28 ms. The first one refuses frames with ENOBUFS, the other one with EAGAIN."""
_LISTENERS = Path("/proc/net/can/rcvlist_all")


@contextmanager
def recorded(interface: str, path: Path) -> Iterator[None]:
    """What candump sees on an interface: also what it sent itself, when that is on the wire."""
    with path.open("w") as log, subprocess.Popen(["candump", "-L", interface], stdout=log) as candump:
        wait_for(lambda: interface in _LISTENERS.read_text(), "candump listens")
        yield
        candump.terminate()


class Axes:
    """Drive clients in operation; their drives are not simulated."""

    def __init__(self, interface: str) -> None:
        self.loop = SystemLoop()
        self.network = CanNetwork(self.loop, lambda: open_port(self.loop, open_bus("socketcan", interface)))
        self.network.start()
        self.commands = [DriveCommand() for _ in range(AXES)]
        self.clients: list[DriveClient] = []
        layout = drive_layout(telegram(1))
        available = {pdo.communication_index for pdo in layout.rpdos}
        for node_id in range(1, AXES + 1):
            client = DriveClient(self.network, DriveSettings(node_id), layout, lambda _: None)
            plan = straight_plan(layout, node_id, available)
            client.rpdos.use_plan(plan, SECOND, client.settings.rpdo_refresh_ms * MS)
            client.operation.sends = True
            self.clients.append(client)

    def send(self, node_id: int, word: int, speed: int, *, stop: bool = False) -> None:
        command = self.commands[node_id - 1]
        command.controlword, command.target_velocity = word, speed
        self.clients[node_id - 1].send(command, self.loop.now(), stop=stop)

    def send_all(self, speed: int) -> None:
        for node_id in range(1, AXES + 1):
            self.send(node_id, Command.ENABLE_OPERATION.word, speed)

    def run(self, duration: int) -> None:
        self.loop.call_later(duration, self.loop.stop)
        self.loop.run()


def frames(path: Path) -> list[tuple[int, int, int]]:
    """Node-ID, target velocity and Controlword of each frame in a log of candump."""
    found = []
    for line in path.read_text().splitlines():
        identifier, text = line.split()[2].split("#")
        data = bytes.fromhex(text)
        found.append((int(identifier, 16) - 0x200, *(int.from_bytes(part, "little") for part in (data[:4], data[4:]))))
    return found


@pytest.mark.parametrize("queue", QUEUES)
def test_twenty_axes_get_their_setpoints_and_a_stop_has_priority(line: Wire, tmp_path: Path, queue: str) -> None:
    interfaces.ip("set", line.near, "txqueuelen", "10")
    slow = ["tc", "qdisc", "replace", "dev", line.near, "root", *QUEUES[queue]]
    subprocess.run(slow, check=True, timeout=PATIENCE_S)
    axes = Axes(line.near)
    log = tmp_path / "candump.log"
    try:
        with recorded(line.near, log):
            for count in range(1, CYCLES + 1):
                axes.send_all(count)
                axes.run(CYCLE)
            # The whole cycle waits, then an axis stops and the others get another speed.
            axes.send_all(CYCLES + 1)
            taken = axes.network.sent
            axes.send(AXES, Command.QUICK_STOP.word, FASTEST, stop=True)
            for node_id in range(1, AXES):
                axes.send(node_id, Command.ENABLE_OPERATION.word, FASTEST)
            axes.run(4 * CYCLE)
        assert axes.network.waits > 0, "the queue was never full"
        assert axes.network.send_errors == 0
    finally:
        axes.network.close()
        axes.loop.close()
        subprocess.run(["tc", "qdisc", "del", "dev", line.near, "root"], check=True, timeout=PATIENCE_S)
    seen = frames(log)
    counts = Counter(node_id for node_id, speed, _ in seen if speed <= CYCLES)
    print(f"{queue}: RPDOs of each axis in {CYCLES} cycles: {dict(sorted(counts.items()))}, waits {axes.network.waits}")
    assert set(counts) == set(range(1, AXES + 1))
    assert min(counts.values()) >= CYCLES // 2, "a machine that is slow sends the newest only"
    assert max(counts.values()) - min(counts.values()) <= 2
    stop = next(place for place, (*_, word) in enumerate(seen) if word == Command.QUICK_STOP.word)
    print(f"{queue}: {stop} frames recorded before the stop, the interface had taken {taken}")
    assert stop <= taken, "what the kernel had already, and nothing else"
    assert FASTEST not in [speed for _, speed, _ in seen[:stop]]
    assert [speed for node_id, speed, _ in seen if node_id < AXES][-1] == FASTEST
