"""Ideal drives in a process of their own: they answer each RPDO of telegram 1 at once with a prepared TPDO.

``python -m tests.long.bench.drives AXES PER_BUS`` prints the channels of its loopback buses; the end of its input ends it.
Simulated drives handle everything but RPDOs.
"""

from __future__ import annotations

import os
import selectors
import sys
import time
from collections.abc import Callable
from typing import Protocol

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.can_frame import CAN_FRAME, pack_frame, unpack_frame
from pdgw.ds301.communication import NMT, SDO_REQUEST
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback
from pdgw.peers.bus import Hub
from pdgw.peers.drive import SimulatedDriveNode

_STATUS_OF_COMMAND = {0x06: 0x0231, 0x07: 0x0233, 0x0F: 0x0637}
_SWITCH_ON_DISABLED = 0x0250
_COMMAND = 0xFF
_ENABLE_OPERATION = 0x0F
_SERVICE, _NODE = 0x780, 0x7F
_TPDO, _RPDO = 0x180, 0x200
_POLL_NS = 20 * MS


class Wire(Protocol):
    """Connects drives with their bus, as ``Hub`` does."""

    def attach(self, receive: Callable[[bytes], None]) -> Callable[[bytes], object]: ...


class IdealDrives:
    """The drives of one bus, node-IDs 1 to ``count``."""

    def __init__(self, bus: Wire, count: int, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._clock = clock
        self._send = bus.attach(self._receive)
        self._nodes = [SimulatedDriveNode(node, self._from_node) for node in range(1, count + 1)]
        self._ideal: dict[int, tuple[Pdo, Pdo]] = {}
        """RPDO and TPDO by node-ID, of drives that answer. The other drives send their first TPDO by themselves."""
        self._command, self._feedback = DriveCommand(), DriveFeedback()
        for node in self._nodes:
            node.start(clock())

    def poll(self, now: int) -> None:
        """Send the heartbeats that are due."""
        for node in self._nodes:
            node.poll(now)

    def _from_node(self, can_id: int, data: bytes) -> None:
        if can_id & _SERVICE != _TPDO or can_id & _NODE not in self._ideal:
            self._send(pack_frame(can_id, data))

    def _receive(self, frame: bytes) -> None:
        can_id, _, data = CAN_FRAME.unpack(frame)
        if can_id & _SERVICE == _RPDO:
            node, command, feedback = can_id & _NODE, self._command, self._feedback
            rpdo, tpdo = self._ideal.get(node) or self._begin(node)
            rpdo.unpack_into(data, command)
            word, velocity = command.controlword & _COMMAND, command.target_velocity
            feedback.statusword = _STATUS_OF_COMMAND.get(word, _SWITCH_ON_DISABLED)
            feedback.velocity_actual = velocity if word == _ENABLE_OPERATION else 0
            self._send(CAN_FRAME.pack(_TPDO + node, tpdo.size, tpdo.pack(feedback)))
            return
        if can_id == NMT:
            self._ideal.pop(data[1], None)
        identifier, content = unpack_frame(frame)
        request = can_id & _SERVICE == SDO_REQUEST
        for drive in [self._nodes[(can_id & _NODE) - 1]] if request else self._nodes:
            drive.receive(identifier, content, self._clock())

    def _begin(self, node: int) -> tuple[Pdo, Pdo]:
        """From now on the drive is ideal, with the PDOs it was configured with."""
        drive = self._nodes[node - 1]
        rpdo, tpdo = drive.pdo(_RPDO + node), drive.pdo(_TPDO + node)
        assert rpdo is not None, "the gateway sends what it mapped"
        assert tpdo is not None, "the gateway waited for it"
        self._ideal[node] = rpdo, tpdo
        return rpdo, tpdo


def main(axes: int, per_bus: int) -> None:
    """Serve the buses until the input ends."""
    selector = selectors.DefaultSelector()
    hubs = [Hub(selector) for _ in range(0, axes, per_bus)]
    drives = [IdealDrives(hub, min(per_bus, axes - number * per_bus)) for number, hub in enumerate(hubs)]
    print(*(hub.channel for hub in hubs), flush=True)
    selector.register(sys.stdin.fileno(), selectors.EVENT_READ)
    due, turn = time.monotonic_ns(), 0
    while True:
        for key, _ in selector.select(max(0, due - time.monotonic_ns()) / SECOND):
            if key.data is not None:
                key.data()
            elif not os.read(sys.stdin.fileno(), 1):
                return
        now = time.monotonic_ns()
        if now >= due:
            drives[turn].poll(now)
            turn = (turn + 1) % len(drives)
            due = max(due + _POLL_NS // len(drives), now)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
