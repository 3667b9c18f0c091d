"""A simulated node on a desk, in virtual time: frames, objects and milliseconds by hand, and all it sends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from pdgw.base.durations import MS
from pdgw.ds301.communication import NmtCommand
from pdgw.peers.node.node import SimulatedNode

N = TypeVar("N", bound=SimulatedNode)


class NodeBench(Generic[N]):
    """Of the node that ``make`` makes with what takes its frames; it boots at ``now``, in nanoseconds."""

    def __init__(self, make: Callable[[Callable[[int, bytes], None]], N], now: int = 0) -> None:
        self.frames: list[tuple[int, int, bytes]] = []
        """Time in milliseconds, identifier and data."""
        self.now = now
        self.node = make(lambda can_id, data: self.frames.append((self.now // MS, can_id, data)))
        self.node.start(now)

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now += MS
            self.node.poll(self.now)

    def frame(self, can_id: int, data: bytes) -> None:
        """A frame comes from the bus."""
        self.node.receive(can_id, data, self.now)

    def nmt(self, command: NmtCommand) -> None:
        self.frame(0, bytes((command, self.node.node_id)))

    def sent(self, can_id: int) -> list[bytes]:
        """The data of all frames with an identifier."""
        return [data for _, sent_id, data in self.frames if sent_id == can_id]

    def set(self, index: int, value: int, subindex: int = 0) -> None:
        """Write an object as its own software would; SdoAbortedError where the node takes no such value."""
        entry = self.node.entry(index, subindex)
        data = value.to_bytes(entry.type.bits // 8, "little", signed=entry.type.char.islower())
        self.node.set_data(index, subindex, data, check_writable=True)
