"""An encoder on the shaft of a simulated drive: over the bus by its PDO, and in one process by a callable."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pdgw.ds301.configuration import map_pdo
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.peers.encoder import Motion, SimulatedEncoderNode
from pdgw.peers.encoder.motion import Follower
from pdgw.peers.node.node import MS, NmtCommand, SimulatedNode

DRIVE, ENCODER = 4, 9
INCREMENTS = 4096
TPDO = next(pdo for pdo in LAYOUTS[Operation.POSITIONING].tpdos if "position_actual" in pdo.attributes)
RPM = 300


class Shaft:
    """A drive and an encoder joined without bus or thread; the drive turns at ``RPM``."""

    def __init__(self, make: Callable[[SimulatedDriveNode], Motion]) -> None:
        self.drive = SimulatedDriveNode(DRIVE, lambda *frame: self.pass_on(self.encoder, *frame))
        self.encoder = SimulatedEncoderNode(ENCODER, lambda *_: None, motions=[make(self.drive)])
        self.now = 0
        for node in (self.drive, self.encoder):
            node.start(0)
        for step in map_pdo(TPDO, TPDO.cob_id(DRIVE), event_ms=0):
            self.drive.set_data(step.index, step.subindex, step.data, check_writable=True)
        self.run(2)
        self.drive.receive(0, bytes((NmtCommand.START, 0)), self.now)
        self.write(0x6060, 3)
        self.write(0x60FF, 2 * RPM)  # velocity units of 0.5 rpm
        for word in (0x06, 0x0F):
            self.write(0x6040, word)

    def pass_on(self, node: SimulatedNode, can_id: int, data: bytes) -> None:
        node.receive(can_id, data, self.now)

    def write(self, index: int, value: int) -> None:
        entry = self.drive.entry(index, 0)
        self.drive.set_data(index, 0, value.to_bytes(entry.type.bits // 8, "little"), check_writable=True)

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now += MS
            for node in (self.drive, self.encoder):
                node.poll(self.now)


def _listens(drive: SimulatedDriveNode) -> Motion:
    byte = TPDO.attributes.index("position_actual")
    return Follower(TPDO.cob_id(DRIVE), sum(entry.type.bits // 8 for entry in TPDO.entries[:byte]), INCREMENTS)


def _asks(drive: SimulatedDriveNode) -> Motion:
    return lambda _: drive.model.position_actual / INCREMENTS


@pytest.mark.parametrize("make", [_listens, _asks])
def test_the_encoder_has_position_and_speed_of_the_drive(make: Callable[[SimulatedDriveNode], Motion]) -> None:
    shaft = Shaft(make)
    shaft.run(1500)
    model = shaft.drive.model
    assert model.velocity_actual == 2 * RPM
    assert int(shaft.encoder.read(0x6004)) == pytest.approx(model.position_actual, abs=1)
    assert shaft.encoder.read(0x6030, 1) == pytest.approx(RPM / 60 * 4096, rel=0.01)
