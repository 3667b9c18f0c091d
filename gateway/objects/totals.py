"""How often each fault of a drive object came: kept for a day, whatever is acknowledged meanwhile."""

from __future__ import annotations

from typing import Final

from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS
from pdgw.gateway.base.finding_text import DAY_NS
from pdgw.gateway.base.reasons import Finding
from pdgw.gateway.objects.origins import of_fault

FLAPS: Final = 5
"""A fault that came so often in a day is one line among the happenings, with its number."""
_KINDS: Final = 64
"""Different faults that are counted at a time."""


class Totals:
    """The faults of one drive object by number and code. One that did not come for a day is forgotten."""

    def __init__(self) -> None:
        self._totals: dict[tuple[int, int], Finding] = {}

    def enter(self, record: FaultRecord) -> None:
        """A fault is reported. That of the gateway has the title of its number as evidence."""
        key, total = (record.number, record.code), of_fault(record)
        if (fault := GATEWAY_FAULTS.get(record.number)) is not None:
            total = total._replace(evidence=fault.title)
        before = self._totals.pop(key, None)
        if before is not None and record.time_ns - before.period[1] <= DAY_NS:
            total = before._replace(times=before.times + 1, last_ns=record.time_ns)
        self._totals[key] = total
        if len(self._totals) > _KINDS:
            del self._totals[next(iter(self._totals))]

    def present(self, now: int) -> list[Finding]:
        """Those of the last day, the newest first."""
        return [total for total in reversed(self._totals.values()) if now - total.period[1] <= DAY_NS]
