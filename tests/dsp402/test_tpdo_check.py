"""When an object of a TPDO is found out never to come in it, and when not."""

from __future__ import annotations

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import SdoAbortedError
from pdgw.ds301.node.node import TpdoSlot
from pdgw.ds301.node.operation import Operation
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.objects import ObjectAddress
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive.tpdo_check import CONTRADICTIONS, TpdoCheck
from pdgw.dsp402.pdo import layouts
from pdgw.dsp402.pdo.layouts import LAYOUTS

pytestmark = pytest.mark.planted

STATUS = LAYOUTS[layouts.Operation.VELOCITY].tpdos[0]
"""Statusword and Velocity Actual Value."""
BOTH = LAYOUTS[layouts.Operation.TRANSPARENT].tpdos[1]
"""Position and velocity in one TPDO."""
POSITION, VELOCITY = (0x6064, 0), (0x606C, 0)
TIMEOUT = 200 * MS
STOPPED, TURNS = bytes(4), b"\1\0\0\0"


class Drive:
    """The objects of a drive and its TPDO; it is the SDO access, mapping and RPDOs of the check, and its loop."""

    def __init__(self, pdo: Pdo) -> None:
        self.time = 0
        self.loop = self
        self.objects: dict[ObjectAddress, bytes] = dict.fromkeys((POSITION, VELOCITY), STOPPED)
        self.dropped: set[ObjectAddress] = set()
        self.slot = TpdoSlot(pdo, None, 0x181, watched=True)
        self.operates = True
        self.check = TpdoCheck(self, self, self)  # type: ignore[arg-type]
        self.map(self.slot)

    def map(self, *slots: TpdoSlot) -> None:
        self.operation = Operation(slots, TIMEOUT)
        self.check.configure(PdoPlan((), ()), self.operation)

    def now(self) -> int:
        return self.time

    def read(self, index: int, subindex: int) -> bytes:
        self.time += MS
        try:
            return self.objects[index, subindex]
        except KeyError:
            raise SdoAbortedError(0x06020000) from None

    def drop(self, address: ObjectAddress) -> None:
        self.dropped.add(address)

    def run(self, seconds: float, *frames: bytes) -> None:
        """A pass of the task every 20 ms; the frames in turns, one in 40 ms."""
        for step in range(int(seconds * 50)):
            self.time += 20 * MS
            if frames and step % 2:
                self.slot.receive(frames[step // 2 % len(frames)], self.time)
            if self.check.due(self.time):
                self.check.work(self.time)


def test_object_that_every_later_frame_contradicts_is_found() -> None:
    drive = Drive(BOTH)
    drive.objects[VELOCITY] = TURNS
    drive.run(0.98 + CONTRADICTIONS * 0.2, bytes(8))
    assert not drive.dropped
    drive.run(0.2, bytes(8))
    assert drive.dropped == {VELOCITY}, "6064h agrees"
    assert drive.operation.lost.endswith("606Ch but does not send it: it shows 0, the object contains 1")


def test_value_seen_once_between_two_checks_is_accepted_from_then_on() -> None:
    drive = Drive(STATUS)
    standing, turning = b"\x37\x02" + STOPPED, b"\x37\x02" + TURNS
    drive.slot.receive(standing, 1)
    drive.slot.receive(turning, 2)
    drive.slot.receive(standing, 3)
    drive.objects[VELOCITY] = TURNS
    drive.run(10, standing)
    assert not drive.dropped
    assert not drive.check.due(drive.time + SECOND), "nothing is read any more"
    assert not drive.slot.compared


def test_object_that_changes_after_another_one_of_its_tpdo_is_accepted() -> None:
    drive = Drive(BOTH)
    drive.run(3, bytes(8), TURNS + STOPPED)
    drive.run(0.08, STOPPED + TURNS)
    drive.objects[VELOCITY] = b"\2\0\0\0"
    drive.run(3, bytes(8))
    assert not drive.dropped


def test_next_bring_up_checks_again() -> None:
    drive = Drive(STATUS)
    drive.run(2, b"\x37\x02" + STOPPED, b"\x37\x02" + TURNS)
    drive.slot = TpdoSlot(STATUS, None, 0x181, watched=True)
    drive.map(drive.slot)
    drive.objects[VELOCITY] = TURNS
    drive.run(3, b"\x37\x02" + STOPPED)
    assert drive.dropped == {VELOCITY}


def test_next_bring_up_reads_no_object_for_the_tpdos_of_the_last_one() -> None:
    drive = Drive(STATUS)
    drive.objects[VELOCITY] = TURNS
    drive.run(2, b"\x37\x02" + STOPPED)
    assert drive.operation.lost
    drive.slot = TpdoSlot(STATUS, None, 0x181, watched=True)
    drive.map(drive.slot)
    assert not drive.operation.lost
    assert not drive.check.due(drive.time + SECOND - 1), "the drive has just begun to send it"
    drive.run(2, b"\x37\x02" + STOPPED, b"\x37\x02" + TURNS)
    assert not drive.check.due(drive.time + SECOND), "its object has changed in the TPDO"


def test_reading_without_a_later_frame_does_not_count() -> None:
    drive = Drive(BOTH)
    drive.slot.receive(bytes(8), 1)
    drive.objects[VELOCITY] = TURNS
    drive.run(10)
    assert not drive.dropped


def test_one_agreement_restarts_the_count() -> None:
    drive = Drive(BOTH)
    for _ in range(10):
        drive.objects[VELOCITY] = TURNS
        drive.run(CONTRADICTIONS * 0.2, bytes(8))
        drive.objects[VELOCITY] = STOPPED
        drive.run(1, bytes(8))
    assert not drive.dropped


@pytest.mark.parametrize(("frame", "found"), [(TURNS + STOPPED, VELOCITY), (STOPPED + TURNS, POSITION)])
def test_each_object_of_a_tpdo_has_its_own_place(frame: bytes, found: ObjectAddress) -> None:
    drive = Drive(BOTH)
    drive.objects = dict.fromkeys((POSITION, VELOCITY), b"\2\0\0\0")
    drive.run(3, bytes(8), frame)
    assert drive.dropped == {found}


def test_unreadable_object_and_one_without_a_frame_are_trusted() -> None:
    drive = Drive(STATUS)
    drive.objects[VELOCITY] = TURNS
    drive.run(10)
    del drive.objects[VELOCITY]
    drive.run(10, b"\x37\x02" + STOPPED)
    assert not drive.dropped
