"""Datagrams of the measuring client: to a plain echo, and as a PLC to a gateway with telegram 1 on every axis."""

from __future__ import annotations

import struct
import time

from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.frame import COUNTER_UNIT_NS, STATUS_NORMAL, TRAILER, CSduLayout
from pdgw.profidrive.telegrams import Direction, telegram
from tests.long.bench.measuring.schedule import Peer, run

_OFF, _ON = 0x047E, 0x047F
_ZSW1_STATE, _READY_TO_SWITCH_ON, _OPERATION = 0x4F, 0x01, 0x07
_INHIBITED = 0x40
SPEEDS = 64
"""Number of different setpoints, used in turn. In any scaling they are far enough apart to be distinguished."""
_SPEED_STEP = 128
_CYCLES_PER_LOOK = 10
_READY_S = 30.0
_NUMBER = struct.Struct("<Q")


class EchoDialogue:
    """Datagrams of a given size that contain their cycle number."""

    def __init__(self, size: int) -> None:
        self._rest = bytes(max(0, size - _NUMBER.size))

    def datagram(self, cycle: int, newest: bytes = b"") -> bytes:
        return _NUMBER.pack(cycle) + self._rest

    def answers(self, data: bytes, cycle: int) -> bool:
        return data[: _NUMBER.size] == _NUMBER.pack(cycle)


def speed(cycle: int) -> int:
    """NSOLL_A of a cycle."""
    return cycle % SPEEDS * _SPEED_STEP


class PlcDialogue:
    """Frames with a new speed for every axis in each cycle, prepared in advance."""

    def __init__(self, axes: int, period_ns: int) -> None:
        self.axes = axes
        self._endpoint = PlcEndpoint([telegram(1)] * axes, period_ns)
        self._provider = CSduLayout([telegram(1)] * axes, Direction.SETPOINT)
        self._consumer = CSduLayout([telegram(1)] * axes, Direction.ACTUAL)
        self.words = [_OFF] * axes
        self._frames: list[bytearray] = []
        self._prepare()

    def _prepare(self) -> None:
        self._frames = []
        for number in range(SPEEDS):
            for axis, word in zip(self._endpoint.setpoints, self.words, strict=True):
                axis["STW1"], axis["NSOLL_A"] = word, speed(number)
            self._frames.append(bytearray(self._endpoint.build()))

    @property
    def size(self) -> int:
        """Bytes of a frame."""
        return len(self._frames[0])

    def datagram(self, cycle: int, newest: bytes = b"") -> bytearray:
        """A frame with the tick of the gateway's newest frame."""
        frame = self._frames[cycle % SPEEDS]
        # The gateway compares the counter with the time. Without a fixed cycle the counter must increase with each frame.
        counter = time.monotonic_ns() // COUNTER_UNIT_NS
        TRAILER.pack_into(frame, self._provider.trailer, counter & 0xFFFF, STATUS_NORMAL, 0)
        if newest:
            frame[self._provider.tick : self._provider.trailer] = newest[self._consumer.tick : self._consumer.trailer]
        return frame

    def answers(self, data: bytes, cycle: int) -> bool:
        """Whether the drives have the speed of the last cycle: then the gateway has processed it and sent its answer."""
        actual = self._consumer.halves[0].decode(data, self._consumer.offsets[0])[1]
        return round(actual / _SPEED_STEP) == (cycle - 1) % SPEEDS

    def states(self, data: bytes) -> list[int]:
        """ZSW1 of each axis."""
        layout = self._consumer
        return [half.decode(data, layout.offsets[index])[0] for index, half in enumerate(layout.halves)]

    def operating(self, data: bytes) -> bool:
        """Whether every axis is in operation."""
        return all(word & _ZSW1_STATE == _OPERATION for word in self.states(data))

    def enable(self, peer: Peer, period_ns: int) -> None:
        """Send OFF, then ON, until each axis follows. GatewayError when they do not come to operation."""
        deadline = time.monotonic() + _READY_S
        while time.monotonic() < deadline:
            peer.begin()
            run([peer], _CYCLES_PER_LOOK, period_ns)
            if not peer.newest:
                continue
            if self.operating(peer.newest):
                return
            for axis, word in enumerate(self.states(peer.newest)):
                if word & _ZSW1_STATE == _READY_TO_SWITCH_ON:
                    self.words[axis] = _ON
                elif word & _INHIBITED:
                    self.words[axis] = _OFF  # the watchdog of a busy machine has expired: OFF is needed again
            self._prepare()
        raise GatewayError("benchmark: the axes did not come to operation")
