"""How often each fault of a drive object came: kept for a day, whatever is acknowledged meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.reasons import GATEWAY_FAULTS

DAY_NS: Final = 86_400 * SECOND
FLAPS: Final = 5
"""A fault that came so often in a day is one line among the happenings, with its number."""
_KINDS: Final = 64
"""Different faults that are counted at a time."""


@dataclass(slots=True)
class Total:
    """One fault. Times are monotonic nanoseconds."""

    name: str
    first_ns: int
    last_ns: int
    count: int = 1


class Totals:
    """The faults of one drive object by number and code. One that did not come for a day is forgotten."""

    def __init__(self) -> None:
        self._totals: dict[tuple[int, int], Total] = {}

    def enter(self, record: FaultRecord) -> None:
        """A fault is reported."""
        key, now = (record.number, record.code), record.time_ns
        total = self._totals.pop(key, None)
        if total is None or now - total.last_ns > DAY_NS:
            fault = GATEWAY_FAULTS.get(record.number)
            total = Total(record.text if fault is None else fault.title, now, now, 0)
        total.count += 1
        total.last_ns = now
        self._totals[key] = total
        if len(self._totals) > _KINDS:
            del self._totals[next(iter(self._totals))]

    def present(self, now: int) -> list[Total]:
        """Those of the last day, the newest first."""
        return [total for total in reversed(self._totals.values()) if now - total.last_ns <= DAY_NS]
