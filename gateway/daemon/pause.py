"""Whether the gateway itself did not run: its machine was paused, suspended or overloaded.

Everything then seems to be lost at one moment, and the drives see no heartbeat of the gateway. The stop is right, its first
cause is the gateway.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.emcy import HEARTBEAT_ERROR
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS, By, FaultNumber

log = logging.getLogger("gateway")

_EFFECT_NS: Final = 500 * MS
"""What is found within this time after a pause follows from it, with the time to read the fault of a drive."""
_LOSSES: Final = (FaultNumber.NODE_LOST, FaultNumber.PLC_LOST, FaultNumber.LEFT_OPERATION)
_WHY: Final = "machine paused, suspended or overloaded"
_REMEDY: Final = "find what pauses or overloads the machine of the gateway: virtual machine, suspend, other programs"


class Pause:
    """The last gap between two cycles that was longer than ``limit_ns``, the shortest time of a supervision."""

    def __init__(self, limit_ns: int, report: Callable[[str], object]) -> None:
        """``report``: called with one line for each of them."""
        self._limit = limit_ns
        self._report = report
        self._ended = -_EFFECT_NS - 1
        self._text = ""

    def cycle(self, due: int, now: int) -> None:
        """A cycle begins at ``now`` that should have begun at ``due``, monotonic nanoseconds."""
        if now - due > self._limit:
            self._ended = now
            self._text = f"the gateway did not run for {(now - due) / SECOND:.2g} s"
            log.warning("%s: %s", self._text, _WHY, extra={"event": "gateway"})
            self._report(self._text)

    def explain(self, record: FaultRecord) -> FaultRecord | None:
        """A fault that follows from it; None if it does not."""
        follows = record.by is None and (record.number in _LOSSES or record.code == HEARTBEAT_ERROR)
        if not follows or record.time_ns - self._ended > _EFFECT_NS:
            return None
        fault = GATEWAY_FAULTS.get(record.number)
        what = record.text if fault is None else fault.title
        return replace(record, text=f"{what}: {self._text} ({_WHY})", remedy=_REMEDY, by=By.GATEWAY)
