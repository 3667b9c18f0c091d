"""A CAN bus whose drives answer at once: what is left of a round trip is the gateway.

RPDO 1 of telegram 1 is answered with TPDO 1 inside ``send``, an SDO upload that was answered in one frame before with that frame;
all other traffic goes to simulated drives.
``python -m tools.bench.instant AXES`` runs a gateway on it, prints its cyclic, status and acyclic port, and ends with its
standard input.
"""

from __future__ import annotations

import queue
import socket
import sys
import threading
import time

import can
from can.interfaces import BACKENDS
from pdgw.gateway.config import GatewayConfig
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.status import StatusServer
from pdgw.gateway.transport.acyclic import AcyclicServer
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.tools.demo.run import free_ports

INTERFACE = "pdgw-instant"
_STATUS_OF_COMMAND = {0x06: b"\x31\x02", 0x07: b"\x33\x02", 0x0F: b"\x37\x06"}
_SDO_REQUEST, _SDO_RESPONSE = 0x600, 0x580
_UPLOAD, _EXPEDITED_UPLOAD = b"\x40", 0x42
_POLL_NS = 20_000_000
_PER_BUS = 3
"""Axes a 1 Mbit/s bus carries at 1 kHz, by the load planner."""


class InstantBus(can.BusABC):
    """Ideal drives: channel ``BUS:COUNT`` has node-IDs 1 to COUNT."""

    def __init__(self, channel: str, **_: object) -> None:
        super().__init__(channel)
        count = int(channel.partition(":")[2])
        self._frames: queue.SimpleQueue[tuple[int, bytes]] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._nodes = [SimulatedDriveNode(node, self._from_node) for node in range(1, count + 1)]
        self._operational = False
        self._poll_due = 0
        self._uploads: dict[tuple[int, bytes], bytes] = {}
        self._asked: tuple[int, bytes] | None = None
        for node in self._nodes:
            node.start(time.monotonic_ns())

    def _from_node(self, can_id: int, data: bytes) -> None:
        if self._asked is not None and can_id & 0x780 == _SDO_RESPONSE and data[0] & 0xE2 == _EXPEDITED_UPLOAD:
            self._uploads[self._asked] = data
        if can_id & 0x780 != 0x180 or not self._operational:
            self._frames.put((can_id, data))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        can_id = msg.arbitration_id
        if 0x200 < can_id < 0x280:
            data = bytes(msg.data)
            status = _STATUS_OF_COMMAND.get(data[0], b"\x50\x02")
            self._operational = True
            self._frames.put((can_id - 0x80, status + data[2:6] if data[0] == 0x0F else status + bytes(4)))
            return
        data = bytes(msg.data)
        if can_id & 0x780 == _SDO_REQUEST and (known := self._uploads.get((can_id, data))) is not None:
            self._frames.put((can_id - 0x80, known))
            return
        if can_id == 0:
            self._operational = False  # a drive that is configured anew shows its first TPDO itself
        with self._lock:
            self._asked = (can_id, data) if can_id & 0x780 == _SDO_REQUEST and data[:1] == _UPLOAD else None
            for node in self._nodes:
                node.receive(can_id, data, time.monotonic_ns())
            self._asked = None

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        now = time.monotonic_ns()
        if now >= self._poll_due:
            self._poll_due = now + _POLL_NS
            with self._lock:
                for node in self._nodes:
                    node.poll(now)
        try:
            can_id, data = self._frames.get(timeout=_POLL_NS / 1e9)
        except queue.Empty:
            return None, False
        return can.Message(arbitration_id=can_id, data=data, is_extended_id=False), False


def main() -> None:
    """Run the gateway of the benchmark."""
    BACKENDS[INTERFACE] = ("pdgw.tools.bench.instant", "InstantBus")
    axes = int(sys.argv[1])
    config = GatewayConfig.model_validate(
        {
            "can": [
                {
                    "interface": INTERFACE,
                    "channel": f"{bus}:{min(_PER_BUS, axes - bus * _PER_BUS)}",
                    "name": f"can{bus}",
                }
                for bus in range(-(-axes // _PER_BUS))
            ],
            "transport": {"cyclic_port": 0, "acyclic_port": 0, "cycle_time_ms": 1, "watchdog_factor": 200},
            "axis": [
                # The ideal drive sends TPDOs only as answers: their supervision would see silence between bursts.
                {
                    "do_id": n + 1,
                    "node_id": n % _PER_BUS + 1,
                    "telegram": 1,
                    "can": f"can{n // _PER_BUS}",
                    "tpdo_event_ms": 10_000,
                    "heartbeat_ms": 1000,
                }
                for n in range(axes)
            ],
        }
    )
    daemon = Daemon(config)
    (status_port,) = free_ports(socket.SOCK_STREAM, 1)
    daemon.services.append(StatusServer(daemon, status_port))
    acyclic = AcyclicServer(daemon)
    daemon.services.append(acyclic)
    print(daemon.socket.address[1], status_port, acyclic.address[1], flush=True)

    def wait_for_end() -> None:
        sys.stdin.read()
        daemon.stop()

    threading.Thread(target=wait_for_end, daemon=True).start()
    daemon.run()


if __name__ == "__main__":
    main()
