"""Required reports: each EMCY with an error that the drive sent on the bus is in the fault buffer (P945, P948) or a warning."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.axis.values import FaultRecord
from tests.long.rules import Seen
from tests.long.soak.watch import require

STORED_NS: Final = 300 * MS
"""An EMCY is reported within this time, at any cycle time."""
_SAME_NS: Final = SECOND + 50 * MS
"""Repetitions of an EMCY within this time are one entry."""
_LISTENS_NS: Final = 500 * MS
"""After its start a gateway first listens for other masters only."""
_HISTORY: Final = 64
"""Faults and warnings that a drive object keeps."""
_SITUATION: Final = 8
"""Places of a fault situation. When it is full, further faults are not stored."""


@dataclass(frozen=True, slots=True)
class Emergency:
    """An EMCY on the bus, with the time of its last bit."""

    time: int
    code: int
    repeats: bool = False
    """An equal fault was not acknowledged when it came: both are one entry, which may be acknowledged before it is read."""


class PendingEmcys:
    """The EMCYs of one drive whose reports were not found yet."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.waiting: list[Emergency] = []

    def sent(self, now: int, data: bytes, present: Collection[int] = ()) -> None:
        """An EMCY has reached the gateway's controller. ``present``: codes of the faults that are not acknowledged."""
        code, register = int.from_bytes(data[:2], "little"), data[2]
        if code and register:
            self.waiting.append(Emergency(now, code, code in present))

    def due(self, now: int) -> bool:
        """Whether an EMCY must be reported now."""
        return bool(self.waiting) and now - self.waiting[0].time >= STORED_NS

    def read(
        self,
        asked_at: int,
        origin: int,
        codes: Sequence[int],
        times_ms: Sequence[int],
        history: Sequence[FaultRecord] = (),
    ) -> None:
        """Compare with the fault buffer, read at some time after ``asked_at``, and with the warnings of the history.

        The times of the buffer count from ``origin``.
        """
        due = [item for item in self.waiting if asked_at - item.time >= STORED_NS]
        self.waiting = self.waiting[len(due) :]
        entries = [(code, origin + time_ms * MS) for code, time_ms in zip(codes, times_ms, strict=True) if code]
        full = any(all(codes[at : at + _SITUATION]) for at in range(0, len(codes), _SITUATION))
        oldest = min((time for _, time in entries), default=0) if all(codes[::_SITUATION]) else 0
        entries += [(record.code, record.time_ns) for record in history if record.is_warning]
        if len(history) == _HISTORY:
            oldest = max(oldest, history[0].time_ns)
        for item in due:
            # An equal fault that is not acknowledged is one entry with the first time. Each acknowledge moves it.
            shown = item.code in (codes if item.repeats else codes[:_SITUATION]) or any(
                code == item.code and -_SAME_NS <= time - item.time <= STORED_NS for code, time in entries
            )
            unstored = not shown and not full and item.time >= origin + _LISTENS_NS and item.time > oldest
            details = f"EMCY {item.code:04X}h was sent {(asked_at - item.time) / MS:.0f} ms before"
            require(self.name, Seen(unstored=unstored), details)
