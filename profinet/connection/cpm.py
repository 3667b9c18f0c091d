"""Consumer protocol machine: which frames with output data count, and the data hold timer; sans-I/O.

Source: IEC 61158-6-10 (CPM, RTC-PDU, APDU-Status).
"""

from __future__ import annotations

import enum

from pdgw.profidrive.frame import (
    HEADER,
    IOPS_GOOD,
    STATUS_DATA_VALID,
    STATUS_PRIMARY,
    STATUS_RUN,
    TRAILER,
    is_newer,
)
from pdgw.profinet.connection.connect import CyclicPlan
from pdgw.profinet.model import Subslot

STATUS_IGNORE = 0x80
"""DataStatus.Ignore: the frame keeps the relationship alive and has no data."""


class Verdict(enum.Enum):
    """Result of a cyclic frame; the value is the name of its counter."""

    __hash__ = object.__hash__  # Enum's own is a Python function and would run in every cycle

    ACCEPTED = "accepted"
    PROVIDER_STOP = "provider stop"
    NO_DATA = "backup or ignore: data kept"
    LENGTH = "wrong length"
    TRANSFER_STATUS = "transfer status not 0"
    NOT_VALID = "data not valid"
    STALE = "stale cycle counter"


_ACCEPTED = Verdict.ACCEPTED


class Consumer:
    """Receive one cyclic relationship. The caller has checked sender and FrameID.

    ``counters``: counters to continue.
    """

    def __init__(self, plan: CyclicPlan, counters: dict[Verdict, int] | None = None) -> None:
        block = plan.block
        self.plan = plan
        self.trailer = HEADER.size + block.data_length
        """Places of CycleCounter and status, from the FrameID on."""
        self.size = self.trailer + TRAILER.size
        """Size of a frame from the FrameID on."""
        self.counter: int | None = None
        """CycleCounter of the last frame that was accepted; None: none yet."""
        self._places = {
            place: (HEADER.size + item.offset, HEADER.size + item.iops) for place, item in plan.data.items()
        }
        self.frame_id = plan.frame_id
        self.hold_ns = block.hold_ns
        self.cycle_ns = block.cycle_ns
        self.payload = bytes(self.size)
        """The last accepted frame from its FrameID on."""
        self.running = False
        """The controller is in RUN: its data counts."""
        self.last_ns: int | None = None
        """When the last frame was accepted; None: none yet."""
        self.data_ns: int | None = None
        """When the last one with data was."""
        self.refused: tuple[Verdict, bytes, int] | None = None
        """The last frame whose data did not count: why, its bytes from the FrameID on, and when it came."""
        self.counters = dict.fromkeys(Verdict, 0) if counters is None else counters

    @property
    def status(self) -> tuple[int, int, int]:
        """CycleCounter, DataStatus and TransferStatus of the last frame with data."""
        counter, data_status, transfer = TRAILER.unpack_from(self.payload, self.trailer)
        return counter, data_status, transfer

    @property
    def deadline(self) -> int | None:
        """When the data hold time is over."""
        return None if self.last_ns is None else self.last_ns + self.hold_ns

    def receive(self, frame: bytes, start: int, now: int) -> Verdict:
        """A frame whose payload starts at ``start``."""
        if len(frame) - start != self.size:
            return self._refuse(Verdict.LENGTH, frame, start, now)
        counter, status, transfer = TRAILER.unpack_from(frame, start + self.trailer)
        if transfer:
            return self._refuse(Verdict.TRANSFER_STATUS, frame, start, now)
        if not status & STATUS_DATA_VALID:
            return self._refuse(Verdict.NOT_VALID, frame, start, now)
        if self.counter is not None and not is_newer(counter, self.counter):
            return self._refuse(Verdict.STALE, frame, start, now)
        self.counter = counter
        self.last_ns = now
        if status & STATUS_IGNORE or not status & STATUS_PRIMARY:
            return self._refuse(Verdict.NO_DATA, frame, start, now)
        self.data_ns = now
        self.payload = frame[start:]
        self.running = status & STATUS_RUN != 0
        return self._count(_ACCEPTED if self.running else Verdict.PROVIDER_STOP)

    def _refuse(self, verdict: Verdict, frame: bytes, start: int, now: int) -> Verdict:
        self.refused = verdict, frame[start:], now
        return self._count(verdict)

    def _count(self, verdict: Verdict) -> Verdict:
        self.counters[verdict] += 1
        return verdict

    def place(self, place: Subslot) -> tuple[int, int] | None:
        """Places of data and IOPS of a submodule in ``payload``; None without data."""
        return self._places.get(place)

    def iocs(self, place: Subslot) -> int | None:
        """The controller's status of a submodule's input data; None where the frame has none."""
        offset = self.plan.iocs.get(place)
        return None if offset is None else self.payload[HEADER.size + offset]

    def output(self, place: Subslot) -> bytes | None:
        """Output data of a submodule; None unless the controller is in RUN and says that this data is GOOD."""
        where = self._places.get(place)
        if where is None or not self.running:
            return None
        offset, iops = where
        return self.payload[offset:iops] if self.payload[iops] & IOPS_GOOD else None
