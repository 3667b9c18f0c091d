"""How a line of the log looks: text with its date, JSON for collectors, or what the journal wants."""

from __future__ import annotations

import json
import logging
import os
import sys
from datetime import datetime
from enum import StrEnum

_FIELDS = ("event", "do", "bus", "fault")
"""What a record may tell beside its text: what kind of thing happened, and to whom."""
_SYSLOG = ((logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_SYSLOG_DEBUG = 7
_FLUSH_S = 10.0
"""So long a line that repeats itself waits until it is told how often."""


class LogFormat(StrEnum):
    """Of ``--log-format``."""

    AUTO = "auto"
    """Levels as prefixes when standard error is the journal, which knows the time itself; else text."""
    TEXT = "text"
    JSON = "json"


class _Text(logging.Formatter):
    def __init__(self) -> None:
        super().__init__("%(asctime)s.%(msecs)03d %(levelname)-7s %(message)s", "%Y-%m-%d %H:%M:%S")


class _Json(logging.Formatter):
    """One object a line: ``time`` (ISO 8601 with its zone), ``level``, ``text``, and of ``_FIELDS`` what the record has."""

    def format(self, record: logging.LogRecord) -> str:
        time = datetime.fromtimestamp(record.created).astimezone().isoformat(timespec="milliseconds")
        document: dict[str, object] = {"time": time, "level": record.levelname.lower()}
        for name in _FIELDS:
            value = getattr(record, name, None)
            if value is not None:
                document[name] = value
        return json.dumps(document | {"text": record.getMessage()}, ensure_ascii=False)


class _Journal(logging.Formatter):
    """sd-daemon(3): the level in front, the time is the journal's."""

    def format(self, record: logging.LogRecord) -> str:
        level = next((syslog for least, syslog in _SYSLOG if record.levelno >= least), _SYSLOG_DEBUG)
        return f"<{level}>{record.getMessage()}"


def in_journal() -> bool:
    """Standard error goes to the journal (systemd.exec(5), JOURNAL_STREAM)."""
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return (device, inode) == (str(status.st_dev), str(status.st_ino))


def formatter(chosen: LogFormat, *, to_file: bool) -> logging.Formatter:
    """The formatter of a file or of standard error."""
    if chosen is LogFormat.JSON:
        return _Json()
    if chosen is LogFormat.AUTO and not to_file and in_journal():
        return _Journal()
    return _Text()


class Bundle:
    """Lines that say the same one after the other are told once, and then how often; ``take`` gives what is to be written."""

    def __init__(self) -> None:
        self._last: logging.LogRecord | None = None
        self._count = 0
        self._since = 0.0

    def take(self, record: logging.LogRecord) -> list[logging.LogRecord]:
        """A record came."""
        last = self._last
        if last is not None and (last.levelno, last.getMessage()) == (record.levelno, record.getMessage()):
            if not self._count:
                self._since = record.created
            self._count += 1
            self._last = record
            return self.due(record.created)
        told = self.flush()
        self._last = record
        return [*told, record]

    def due(self, now: float) -> list[logging.LogRecord]:
        """What has waited long enough; ``now`` as ``time.time``."""
        return self.flush() if self._count and now - self._since >= _FLUSH_S else []

    def flush(self) -> list[logging.LogRecord]:
        """What was repeated and not told yet."""
        last, count = self._last, self._count
        if last is None or not count:
            return []
        self._count = 0
        times = "once" if count == 1 else f"{count} times"
        told = logging.makeLogRecord(last.__dict__ | {"msg": f"{last.getMessage()} ({times} more)", "args": None})
        return [told]
