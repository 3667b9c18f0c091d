"""Format of a log line: text with its date, JSON for collectors, or prefixed for the journal."""

from __future__ import annotations

import json
import logging
import os
import sys
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

_FIELDS = ("event", "do", "bus", "fault")
"""Attributes of a record beside its text: kind of event, drive object, bus, fault number."""
_SYSLOG = ((logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_SYSLOG_DEBUG = 7
_FLUSH_S = 10.0
"""Repeats of a line are reported after this time, in seconds."""
AT_ONCE = 20
"""Lines of one kind about one object that are written before they are limited."""
_PER_SECOND = 0.1
"""Lines per second of one kind that are written then."""


class LogLevel(StrEnum):
    """Levels of ``--log-level``."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


class LogFormat(StrEnum):
    """Values of ``--log-format``."""

    AUTO = "auto"
    """Level prefixes when standard error is the journal, which adds the time; else text."""
    TEXT = "text"
    JSON = "json"


LevelOption = Annotated[LogLevel, typer.Option(help="Log level.")]
FileOption = Annotated[Path | None, typer.Option(help="Log file (default: standard error).")]
FormatOption = Annotated[
    LogFormat, typer.Option(help="Text with dates, JSON, or journal prefixes if standard error is the journal.")
]


class _Text(logging.Formatter):
    def __init__(self) -> None:
        super().__init__("%(asctime)s.%(msecs)03d %(levelname)-7s %(message)s", "%Y-%m-%d %H:%M:%S")


class _Json(logging.Formatter):
    """One JSON object a line: ``time`` (ISO 8601 with time zone), ``level``, ``text``, and the ``_FIELDS`` of the record."""

    def format(self, record: logging.LogRecord) -> str:
        time = datetime.fromtimestamp(record.created).astimezone().isoformat(timespec="milliseconds")
        document: dict[str, object] = {"time": time, "level": record.levelname.lower()}
        for name in _FIELDS:
            value = getattr(record, name, None)
            if value is not None:
                document[name] = value
        return json.dumps(document | {"text": record.getMessage()}, ensure_ascii=False)


class _Journal(logging.Formatter):
    """Level prefix as in sd-daemon(3), without the time, which the journal adds."""

    def format(self, record: logging.LogRecord) -> str:
        level = next((syslog for least, syslog in _SYSLOG if record.levelno >= least), _SYSLOG_DEBUG)
        return f"<{level}>{record.getMessage()}"


def in_journal() -> bool:
    """Whether standard error is connected to the journal (systemd.exec(5), JOURNAL_STREAM)."""
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return (device, inode) == (str(status.st_dev), str(status.st_ino))


def formatter(chosen: LogFormat, *, to_file: bool) -> logging.Formatter:
    """The formatter for a file or for standard error."""
    if chosen is LogFormat.JSON:
        return _Json()
    if chosen is LogFormat.AUTO and not to_file and in_journal():
        return _Journal()
    return _Text()


def _waited(since: float, now: float) -> bool:
    """Whether the time to report is over. The wall clock may be set back meanwhile."""
    return abs(now - since) >= _FLUSH_S


class _Kind:
    """The lines of one kind about one object."""

    def __init__(self) -> None:
        self.left = float(AT_ONCE)
        self.time = 0.0
        self.dropped: list[logging.LogRecord] = []
        """The first and the last omitted line."""
        self.count = 0


class Budget:
    """Limits many lines of one kind about one object, such as EMCY. Omitted lines are counted and reported within ten
    seconds.

    A kind is the event, the fault number and the object; for a line without an event, the place in the code.
    """

    def __init__(self) -> None:
        self._kinds: dict[tuple[object, ...], _Kind] = {}

    def take(self, record: logging.LogRecord) -> list[logging.LogRecord]:
        """The records to write now: none, or the number of omitted lines and this record."""
        event = getattr(record, "event", None) or (record.pathname, record.lineno)
        kind = self._kinds.setdefault((event, *(getattr(record, name, None) for name in _FIELDS[1:])), _Kind())
        kind.left = min(float(AT_ONCE), kind.left + max(0.0, record.created - kind.time) * _PER_SECOND)
        kind.time = record.created
        if kind.left < 1:
            kind.count += 1
            kind.dropped = [*kind.dropped[:1], record]
            return []
        kind.left -= 1
        return [*_left_out(kind), record]

    def due(self, now: float) -> list[logging.LogRecord]:
        """The counts that are due."""
        waiting = [kind for kind in self._kinds.values() if kind.count]
        return [item for kind in waiting if _waited(kind.dropped[0].created, now) for item in _left_out(kind)]

    def flush(self) -> list[logging.LogRecord]:
        """All counts that are not reported yet."""
        return [item for kind in self._kinds.values() for item in _left_out(kind)]


def _left_out(kind: _Kind) -> list[logging.LogRecord]:
    if not kind.count:
        return []
    last, count = kind.dropped[-1], kind.count
    kind.dropped, kind.count = [], 0
    text = f"{count} similar lines omitted, the last: {last.getMessage()}"
    return [logging.makeLogRecord(last.__dict__ | {"msg": text, "args": None})]


class Bundle:
    """Writes equal consecutive lines once, and their number later. ``take`` returns the records to write.

    A ``Budget`` limits lines that differ.
    """

    def __init__(self) -> None:
        self._budget = Budget()
        self._last: logging.LogRecord | None = None
        self._count = 0
        self._since = 0.0

    def take(self, record: logging.LogRecord) -> list[logging.LogRecord]:
        """Add a record. Return the records to write now."""
        last = self._last
        if last is not None and (last.levelno, last.getMessage()) == (record.levelno, record.getMessage()):
            if not self._count:
                self._since = record.created
            self._count += 1
            self._last = record
            return self.due(record.created)
        repeated = self._repeated()
        self._last = record
        return [*repeated, *self._budget.due(record.created), *self._budget.take(record)]

    def due(self, now: float) -> list[logging.LogRecord]:
        """The reports that are due; ``now`` as ``time.time``."""
        repeated = self._repeated() if self._count and _waited(self._since, now) else []
        return [*repeated, *self._budget.due(now)]

    def flush(self) -> list[logging.LogRecord]:
        """All repetitions and omissions that are not reported yet."""
        return [*self._repeated(), *self._budget.flush()]

    def _repeated(self) -> list[logging.LogRecord]:
        last, count = self._last, self._count
        if last is None or not count:
            return []
        self._count = 0
        times = "once" if count == 1 else f"{count} times"
        return [logging.makeLogRecord(last.__dict__ | {"msg": f"{last.getMessage()} ({times} more)", "args": None})]
