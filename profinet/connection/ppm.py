"""Provider protocol machine: the frames with input data, sans-I/O.

Source: IEC 61158-6-10 (PPM, RTC-PDU, APDU-Status). The frame is kept as one buffer and filled in place.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from pdgw.profidrive.frame import (
    HEADER,
    IOPS_BAD,
    IOPS_GOOD,
    STATUS_NO_PROBLEM,
    STATUS_NORMAL,
    TRAILER,
)
from pdgw.profinet import ethernet
from pdgw.profinet.connection.connect import CyclicPlan
from pdgw.profinet.model import Subslot

NEVER: Final = 1 << 61
_COUNTER_MASK = 0xFFFF


class Provider:
    """Sends one cyclic relationship. ``proper``: submodules whose IOPS and IOCS may become GOOD."""

    def __init__(self, plan: CyclicPlan, destination: bytes, source: bytes, proper: Iterable[Subslot]) -> None:
        block = plan.block
        head = ethernet.header(destination, source, tag=block.tag)
        self._start = len(head) + HEADER.size
        self.trailer = self._start + block.data_length
        """Places of CycleCounter and status in ``frame``."""
        self._plan = plan
        self._proper = frozenset(proper)
        self.step = block.send_clock * block.reduction_ratio
        """Increment of the CycleCounter from frame to frame."""
        self.counter = 0
        """CycleCounter of the last frame."""
        self.due = 0
        """When the next frame is to be sent."""
        self._move = 0
        self._open = False
        self._good: set[Subslot] = set()
        """Submodules whose data is valid, open or not."""
        self.cycle_ns = block.cycle_ns
        self.frame = bytearray(self.trailer + TRAILER.size)
        """The whole Ethernet frame; written in place."""
        self.frame[: len(head)] = head
        HEADER.pack_into(self.frame, len(head), plan.frame_id)
        self.data_status = STATUS_NORMAL
        self.skipped = 0
        """Cycles without a frame before the last one: this side was late."""

    @property
    def status(self) -> tuple[int, int, int]:
        """CycleCounter, DataStatus and TransferStatus of the last frame."""
        counter, data_status, transfer = TRAILER.unpack_from(self.frame, self.trailer)
        return counter, data_status, transfer

    def start(self, now: int) -> None:
        """The first frame is sent a cycle from now."""
        self.due = now + self.cycle_ns

    def move(self, nanoseconds: int) -> None:
        """Send later (negative: earlier) from the frame after the next one on: much less than a cycle."""
        self._move = nanoseconds

    def open(self) -> None:
        """Statuses are GOOD from now on, of submodules with data where that was said to be valid."""
        self._open = True
        for place, item in self._plan.data.items():
            if place in self._proper and (not item.length or place in self._good):
                self.frame[self._start + item.iops] = IOPS_GOOD
        for place, offset in self._plan.iocs.items():
            if place in self._proper:
                self.frame[self._start + offset] = IOPS_GOOD

    def close(self) -> None:
        """All statuses BAD, as while the controller parameterises."""
        self._open = False
        for item in self._plan.data.values():
            self.frame[self._start + item.iops] = IOPS_BAD
        for offset in self._plan.iocs.values():
            self.frame[self._start + offset] = IOPS_BAD

    def place(self, place: Subslot) -> tuple[int, int] | None:
        """Places of data and IOPS of a submodule in ``frame``; None for a submodule that is not proper or has no data."""
        item = self._plan.data.get(place)
        if item is None or place not in self._proper:
            return None
        return self._start + item.offset, self._start + item.iops

    def iocs(self, place: Subslot) -> int | None:
        """The device's status of a submodule's output data; None where the frame has none."""
        offset = self._plan.iocs.get(place)
        return None if offset is None else self.frame[self._start + offset]

    def set(self, place: Subslot, data: bytes, *, good: bool) -> None:
        """Input data of a submodule; not good, or not opened yet: IOPS BAD."""
        where = self.place(place)
        if where is None:
            return
        offset, iops = where
        self.frame[offset:iops] = data
        self.set_status(place, good=good)

    def set_status(self, place: Subslot, *, good: bool) -> None:
        """The IOPS of a submodule alone."""
        where = self.place(place)
        if where is not None:
            (self._good.add if good else self._good.discard)(place)
            self.frame[where[1]] = IOPS_GOOD if good and self._open else IOPS_BAD

    def set_problem(self, present: bool) -> None:
        """Whether a fault diagnosis is present."""
        self.data_status = self.data_status & ~STATUS_NO_PROBLEM | (0 if present else STATUS_NO_PROBLEM)

    def poll(self, now: int) -> bytearray | None:
        """The frame when it is due. The buffer is reused; cycles that are over are counted and not made up for."""
        late = now - self.due
        if late < 0:
            return None
        skipped = self.skipped = late // self.cycle_ns
        self.due += (skipped + 1) * self.cycle_ns + self._move
        self._move = 0
        self.counter = (self.counter + (skipped + 1) * self.step) & _COUNTER_MASK
        TRAILER.pack_into(self.frame, self.trailer, self.counter, self.data_status, 0)
        return self.frame
