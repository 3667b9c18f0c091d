"""The faults of one axis as the parameter channel shows them: P944 to P953, and the numbers they may have.

Fed by the drive object, read by the parameter channel. P946 and P951 are the fault numbers of a drive object with their codes
and texts, element n for number n: the manufacturer's (``own``, by number) and the gateway's, which each drive object has.
Source: docs/parameter-channel.md "Fault buffer".
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple

from pdgw.base.durations import MS
from pdgw.dsp402.drive_type import DriveFault
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.fault_numbers import EMCY_WARNING, GATEWAY_FAULTS, FaultNumber
from pdgw.profidrive.parameters.faults import FAULTS_PER_SITUATION, SIZE, Fault, FaultBuffer

_NO_FAULT = Fault(0, 0, 0, 0)
_KEPT = 64
_OWN_PLACES = 6
"""Places of situation 0 that the gateway's own faults may take: the others are for those of the device."""


class ReportedFault(NamedTuple):
    """A fault as in the status document; ``id`` counts the faults and warnings of a drive object from 1."""

    id: int
    active: bool
    """Not acknowledged; of a warning: active."""
    record: FaultRecord


def _key(record: FaultRecord) -> tuple[int, int]:
    return record.number, record.code


def _places(record: FaultRecord) -> int:
    return FAULTS_PER_SITUATION if record.of_device else _OWN_PLACES


class FaultLog:
    """The history for the user and the fault buffer of one axis; times count from ``origin_ns``."""

    def __init__(self, origin_ns: int) -> None:
        self.history: deque[FaultRecord] = deque(maxlen=_KEPT)
        self._origin = origin_ns
        self.buffer = FaultBuffer()
        """P944 and P952."""
        self._active: dict[tuple[int, int], ReportedFault] = {}
        """Faults that are not acknowledged, the oldest first. Equal ones count once, so that none hides another."""
        self._entered = 0
        self.count = 0
        """Faults since the start, without warnings: the recorder has it beside each step."""

    def enter(self, record: FaultRecord) -> None:
        """Store a fault in the history and in the buffer, a warning in the history alone."""
        self.history.append(record)
        self._entered += 1
        if not record.is_warning:
            self.count += 1
            if _key(record) not in self._active and len(self._active) < _KEPT:
                self._active[_key(record)] = ReportedFault(self._entered, active=True, record=record)
                self.buffer.enter(self._fault(record), _places(record))

    def acknowledge(self) -> None:
        """The PLC acknowledged and the cause is gone. The gateway's own faults, repeated, have one situation."""
        self.buffer.acknowledge(GATEWAY_FAULTS)
        self._active.clear()

    def clear(self, lasts: Callable[[FaultRecord], bool]) -> None:
        """P952 := 0: what is acknowledged or gone. ``lasts``: the cause of an unacknowledged fault is present."""
        self._active = {key: item for key, item in self._active.items() if lasts(item.record)}
        present: list[Fault] = []
        for record in self.unacknowledged():
            if len(present) < _places(record):
                present.append(self._fault(record))
        self.buffer.clear(present)

    def _fault(self, record: FaultRecord) -> Fault:
        time_ms = max(0, record.time_ns - self._origin) // MS
        return Fault(record.number, record.code, record.value, time_ms & 0xFFFFFFFF)

    def reported(self, *, present: int, newest: int | None = None) -> list[ReportedFault]:
        """The history with its ids, newest first, then older faults that are not acknowledged; ``newest``: maximum number.
        ``present``: the warnings of ``Outputs.warning``.
        """
        seen: set[int] = set()
        result: list[ReportedFault] = []
        for back, record in enumerate(reversed(self.history)):
            if newest is not None and back >= newest:
                break
            number = self._entered - back
            if record.is_warning:
                # A warning has one entry, however often it is reported.
                fault = GATEWAY_FAULTS.get(record.number)
                bit = EMCY_WARNING if fault is None else fault.warning_mask
                active = bool(present & bit) and record.number not in seen
                seen.add(record.number)
            else:
                first = self._active.get(_key(record))
                active = first is not None and number >= first.id
            result.append(ReportedFault(number, active, record))
        if newest is None:
            result += [item for item in reversed(self._active.values()) if item.id <= self._entered - len(self.history)]
        return result

    def entries(self) -> list[Fault]:
        """All 64 places, empty ones as zeros."""
        return [self.buffer.entry(place) or _NO_FAULT for place in range(SIZE)]

    def cause(self, number: int = 0) -> ReportedFault | None:
        """The oldest unacknowledged fault with this number, else the oldest one."""
        found = list(self._active.values())
        return next((item for item in found if item.record.number == number), found[0] if found else None)

    def of_device(self, since: int) -> ReportedFault | None:
        """The first fault of the device itself from ``since`` (monotonic ns) on that is not acknowledged."""
        return next(
            (item for item in self._unacknowledged() if item.record.of_device and item.record.time_ns >= since), None
        )

    def fault_code(self, since: int) -> int:
        """The first fault from ``since`` (monotonic ns) on that is not acknowledged, else the newest; 0 for none."""
        if not self._active:
            return 0
        records = [item.record for item in self._unacknowledged()]
        return next((record for record in records if record.time_ns >= since), records[-1]).number

    def _unacknowledged(self) -> list[ReportedFault]:
        """The oldest first, also equal ones."""
        reported = reversed(self.reported(present=0))
        return [item for item in reported if item.active and not item.record.is_warning]

    @property
    def acknowledged(self) -> bool:
        """There is no fault that is not acknowledged."""
        return not self._active

    def unacknowledged(self) -> list[FaultRecord]:
        """The unacknowledged faults, each once, also those without a place in situation 0."""
        return [item.record for item in self._active.values()]


def fault_rows(own: Mapping[int, DriveFault]) -> list[tuple[int, int, str]]:
    """Number (P951), code (P946) and text (P951, P947) for each number from 0 on; 0, 0 and empty where there is no fault."""
    rows = {fault.number: (fault.number, fault.error_code, fault.name) for fault in own.values()}
    rows |= {fault.value: (fault.value, fault.code, fault.title) for fault in FaultNumber}
    return [rows.get(number, (0, 0, "")) for number in range(max(rows) + 1)]
