"""Ideal drives in a process of their own: they answer each RPDO of telegram 1 at once with a prepared TPDO.

``python -m tests.long.bench.drives AXES PER_BUS`` prints the channels of its loopback buses; the end of its input ends it.
Simulated drives handle everything but RPDOs and the position of the turning shaft.
"""

from __future__ import annotations

import os
import selectors
import struct
import sys
import time

from pdgw.ds301.bus.can_frame import CAN_FRAME, pack_frame, unpack_frame
from pdgw.ds301.connection_set import NMT, SDO_REQUEST, SDO_RESPONSE
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback
from pdgw.dsp402.indices import POSITION_ACTUAL
from pdgw.durations import MS, SECOND
from pdgw.peers.bus import Hub
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.peers.drive.model.motion import increments_per_second

_STATUS_OF_COMMAND = {0x06: 0x0231, 0x07: 0x0233, 0x0F: 0x0637}
_SWITCH_ON_DISABLED = 0x0250
_COMMAND = 0xFF
_ENABLE_OPERATION = 0x0F
_SERVICE, _NODE = 0x780, 0x7F
_TPDO, _RPDO = 0x180, 0x200
_POLL_NS = 20 * MS
_POSITION_QUERY, _POSITION_ANSWER = struct.Struct("<BHB"), struct.Struct("<BHBi")
_POSITION_REQUEST = _POSITION_QUERY.pack(0x40, POSITION_ACTUAL, 0)
_POSITION_RESPONSE = 0x43
_UNITS_PER_RPM = 2
"""Units of 60FFh per rpm."""


class IdealDrives:
    """The drives of one bus, node-IDs 1 to ``count``."""

    def __init__(self, bus: Hub, count: int) -> None:
        self._send = bus.attach(self._receive)
        self._nodes = [SimulatedDriveNode(node, self._from_node) for node in range(1, count + 1)]
        self._ideal: dict[int, tuple[Pdo, Pdo]] = {}
        """RPDO and TPDO by node-ID, of drives that answer. The other drives send their first TPDO by themselves."""
        self._command, self._feedback = DriveCommand(), DriveFeedback()
        self._shafts = [(0, 0.0, 0.0)] * (count + 1)
        """By node-ID: a time, the position at this time and the speed since then, in increments."""
        for node in self._nodes:
            node.start(time.monotonic_ns())

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
            now = time.monotonic_ns()
            node, command, feedback = can_id & _NODE, self._command, self._feedback
            rpdo, tpdo = self._ideal.get(node) or self._begin(node)
            rpdo.unpack_into(data, command)
            word, velocity = command.controlword & _COMMAND, command.target_velocity
            feedback.statusword = _STATUS_OF_COMMAND.get(word, _SWITCH_ON_DISABLED)
            feedback.velocity_actual = velocity if word == _ENABLE_OPERATION else 0
            self._send(CAN_FRAME.pack(_TPDO + node, tpdo.size, tpdo.pack(feedback)))
            speed = increments_per_second(feedback.velocity_actual / _UNITS_PER_RPM)
            self._shafts[node] = now, self._position(node, now), speed
            return
        node = can_id & _NODE
        asks = can_id & _SERVICE == SDO_REQUEST
        if asks and node in self._ideal and data[: _POSITION_QUERY.size] == _POSITION_REQUEST:
            position = round(self._position(node, time.monotonic_ns()))
            answer = _POSITION_ANSWER.pack(_POSITION_RESPONSE, POSITION_ACTUAL, 0, position)
            self._send(pack_frame(SDO_RESPONSE + node, answer))
            return
        if can_id == NMT:
            self._ideal.pop(data[1], None)
        identifier, content = unpack_frame(frame)
        for drive in [self._nodes[node - 1]] if asks else self._nodes:
            drive.receive(identifier, content, time.monotonic_ns())

    def _position(self, node: int, now: int) -> float:
        """Position of the shaft. It turns with the speed of 606Ch, because the gateway compares both."""
        since, position, speed = self._shafts[node]
        return position + speed * (now - since) / SECOND

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
