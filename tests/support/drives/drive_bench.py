"""A simulated drive on a desk, in virtual time."""

from __future__ import annotations

import struct

from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State
from pdgw.peers.drive import LINEAR_AXIS, DriveModel, Machine, SimulatedDriveNode
from tests.support.drives.node_bench import NodeBench

NODE = 1
SMALL = Machine(negative_limit=-20_000, positive_limit=20_000, negative_stop=-30_000, positive_stop=30_000)


class DriveBench(NodeBench[SimulatedDriveNode]):
    """A drive, and a master's SDOs."""

    @property
    def model(self) -> DriveModel:
        return self.node.model

    def read(self, index: int, subindex: int = 0) -> bytes | None:
        """The answer frame to an upload request, None when none came at once."""
        answers = self._ask(struct.pack("<BHB4x", 0x40, index, subindex))
        return answers[0] if answers else None

    def write(self, index: int, subindex: int, value: int) -> int:
        """An SDO download; returns 0 or the abort code the node answered."""
        data = struct.pack("<" + self.node.entries[index, subindex].type.char, value)
        return self.download(index, subindex, data)

    def download(self, index: int, subindex: int, data: bytes) -> int:
        command = 0x23 | (4 - len(data)) << 2
        answer = self._ask(struct.pack("<BHB", command, index, subindex) + data.ljust(4, b"\0"))[0]
        return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0

    def _ask(self, request: bytes) -> list[bytes]:
        self.frames.clear()
        self.frame(0x600 + self.node.node_id, request)
        return self.sent(0x580 + self.node.node_id)


class Bench(DriveBench):
    """A drive in operation, commanded by SDOs."""

    def __init__(self, machine: Machine | None = None, mode: int = Mode.VELOCITY) -> None:
        super().__init__(lambda send: SimulatedDriveNode(NODE, send, machine=machine or LINEAR_AXIS))
        self.run(2)
        self.write(0x6060, 0, mode)
        self.nmt(NmtCommand.START)
        self.run(1)

    def control(self, word: int, milliseconds: int = 1) -> None:
        self.write(0x6040, 0, word)
        self.run(milliseconds)

    def enable(self) -> None:
        for word in (0x06, 0x07, 0x0F):
            self.control(word)
        assert self.model.state is State.OPERATION_ENABLED

    def until(self, mask: int, limit: int = 60_000) -> int:
        """Milliseconds until a Statusword bit of the mask is set."""
        for elapsed in range(limit):
            if self.model.statusword & mask:
                return elapsed
            self.run(1)
        raise AssertionError(f"Statusword {self.model.statusword:04X}h, position {self.model.position_actual}")


def drive_in(state: State) -> Bench:
    bench = Bench()
    ways = {
        State.SWITCH_ON_DISABLED: (),
        State.READY_TO_SWITCH_ON: (0x06,),
        State.SWITCHED_ON: (0x06, 0x07),
        State.OPERATION_ENABLED: (0x06, 0x07, 0x0F),
        State.QUICK_STOP_ACTIVE: (0x06, 0x07, 0x0F),
    }
    for word in ways.get(state, (0x06, 0x07, 0x0F)):
        bench.control(word)
    if state in {State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}:
        bench.write(0x60FF, 0, 6000)
        bench.run(500)
    if state is State.QUICK_STOP_ACTIVE:
        bench.write(0x6040, 0, 0x02)
    elif state in {State.FAULT, State.FAULT_REACTION_ACTIVE}:
        bench.model.inject(7)
        bench.model.clear()
        if state is State.FAULT:
            bench.run(5)
    assert bench.model.state is state
    return bench
