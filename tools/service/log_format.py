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
