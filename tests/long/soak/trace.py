"""The last events of a part of the soak, as lines with time."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable

from pdgw.base.durations import SECOND

_KEPT = 60
_KEPT_WITH_FRAMES = 600


def clock(now: int) -> str:
    """A time of the day, to the microsecond."""
    seconds, rest = divmod(now, SECOND)
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}.{rest // 1000:06d}"


class Trace(logging.Handler):
    """Records notes and the gateway's log. ``frames``: also every frame of buses and network."""

    def __init__(self, now: Callable[[], int], *, frames: bool = False) -> None:
        super().__init__()
        self.frames = frames
        self._now = now
        self.alarms: list[str] = []
        """Warnings and errors of the gateway's log."""
        self._lines: deque[str] = deque(maxlen=_KEPT_WITH_FRAMES if frames else _KEPT)

    def note(self, text: str) -> None:
        """Add a line."""
        self._lines.append(f"{clock(self._now())}  {text}")

    def emit(self, record: logging.LogRecord) -> None:
        self.note(f"gateway: {record.getMessage()}")
        if record.levelno >= logging.WARNING:
            self.alarms.append(record.getMessage())

    @property
    def lines(self) -> list[str]:
        """The last lines, oldest first."""
        return list(self._lines)
