"""The budget of each cause of log lines, at the logger itself: whatever repeats a line, the log stays readable.

A cause is the event, the drive object, the bus, and the fault number or the reason; for a line without them, the place in the
code and the text without its numbers.
"""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass
from typing import Final
from weakref import ref

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.loop import Loop, Timer

log = logging.getLogger("gateway")

REPORT_NS: Final = 10 * SECOND
"""After this time a cause may write one line more, and the last omitted line is written with their number."""
AT_ONCE: Final = 10
"""Lines of a cause that are written at once."""
_OBJECT, _CAUSE = ("event", "do", "bus"), ("fault", "reason")
"""Attributes of a record beside its text."""
_NUMBER: Final = re.compile(r"[0-9A-F]*\d[0-9A-F]*")
_CAUSES_MAX: Final = 1000


@dataclass(slots=True)
class _Cause:
    """The lines of one cause. ``left``: the time for which it may write, in ``REPORT_NS`` a line."""

    left: int = AT_ONCE * REPORT_NS
    time: int = 0
    omitted: int = 0
    """Lines omitted before the last one."""
    last: logging.LogRecord | None = None
    """The last omitted line; None: none was omitted since the last report."""


class LogBudget(logging.Filter):
    """Omits lines of causes that repeat, and writes the last one of ten seconds with their number. Runs beside the exchange."""

    def __init__(self, loop: Loop) -> None:
        super().__init__()
        self._loop = ref(loop)
        """The logger does not keep the loop of a gateway that was not stopped."""
        self._causes: dict[tuple[object, ...], _Cause] = {}
        self._timer: Timer | None = None

    def start(self) -> None:
        """Limit the lines of the gateway's logger from now on."""
        log.addFilter(self)
        self._report()

    def stop(self) -> None:
        """No line is limited any more; the omitted ones are counted."""
        if self._timer is not None:
            self._timer.cancel()
        log.removeFilter(self)
        for cause in self._causes.values():
            self._write(cause)

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to write a line."""
        loop = self._loop()
        if loop is None:
            return True
        now, cause = loop.now(), self._cause_of(record)
        cause.left = min(AT_ONCE * REPORT_NS, cause.left + now - cause.time)
        cause.time = now
        if cause.last is not None or cause.left < REPORT_NS:
            cause.omitted += cause.last is not None
            cause.last = record
            return False
        cause.left -= REPORT_NS
        return True

    def _cause_of(self, record: logging.LogRecord) -> _Cause:
        cause = tuple(getattr(record, name, None) for name in _CAUSE)
        if not any(item is not None for item in cause):
            cause = record.pathname, record.lineno, _NUMBER.sub("", record.getMessage())
        causes = self._causes
        key = *(getattr(record, name, None) for name in _OBJECT), *cause
        if key not in causes and len(causes) >= _CAUSES_MAX:
            del causes[next(iter(causes))]
        return causes.setdefault(key, _Cause())

    def _report(self) -> None:
        """Report how many lines were omitted. A cause that has ended is included."""
        log.removeFilter(self)
        for cause in self._causes.values():
            self._write(cause)
        log.addFilter(self)
        if (loop := self._loop()) is not None:
            self._timer = loop.call_later(REPORT_NS, self._report)

    def _write(self, cause: _Cause) -> None:
        last = cause.last
        if last is not None:
            if cause.omitted:
                last.msg, last.args = f"{last.getMessage()} ({cause.omitted} more since the last report)", None
            cause.last, cause.omitted, cause.left = None, 0, 0
            log.handle(last)
