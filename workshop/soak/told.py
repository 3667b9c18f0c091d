"""What the fault buffer (P945, P948) has to show: each EMCY with an error, as the drive sent it on the bus."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from pdgw.durations import MS, SECOND
from pdgw.workshop.soak.watch import ViolationError

TOLD_NS: Final = 300 * MS
"""An EMCY is in the fault buffer within this time, whatever the cycle."""
_SAME_NS: Final = SECOND + 50 * MS
"""The same EMCY is one entry in this time."""
_LISTENS_NS: Final = 500 * MS
"""A gateway that starts hears only other masters at first."""
_SITUATION: Final = 8
"""Places of one fault situation; what comes when it is full is not entered."""


@dataclass(frozen=True, slots=True)
class Emergency:
    """One EMCY on the bus, with the time of its last bit."""

    time: int
    code: int


class Told:
    """The EMCYs of one drive that were not found in the fault buffer yet."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.waiting: list[Emergency] = []

    def sent(self, now: int, data: bytes) -> None:
        """An EMCY reached the gateway's controller."""
        code, register = int.from_bytes(data[:2], "little"), data[2]
        if code and register:
            self.waiting.append(Emergency(now, code))

    def due(self, now: int) -> bool:
        """Something should be in the buffer by now."""
        return bool(self.waiting) and now - self.waiting[0].time >= TOLD_NS

    def read(self, asked_at: int, origin: int, codes: Sequence[int], times_ms: Sequence[int]) -> None:
        """The fault buffer as it was at some time after ``asked_at``; its times count from ``origin``."""
        due = [item for item in self.waiting if asked_at - item.time >= TOLD_NS]
        self.waiting = self.waiting[len(due) :]
        entries = [(code, origin + time_ms * MS) for code, time_ms in zip(codes, times_ms, strict=True) if code]
        full = any(all(codes[at : at + _SITUATION]) for at in range(0, len(codes), _SITUATION))
        oldest = min((time for _, time in entries), default=0) if all(codes[::_SITUATION]) else 0
        for item in due:
            shown = any(code == item.code and -_SAME_NS <= time - item.time <= TOLD_NS for code, time in entries)
            if not shown and not full and item.time >= origin + _LISTENS_NS and item.time > oldest:
                raise ViolationError(
                    f"{self.name}: EMCY {item.code:04X}h is not in the fault buffer {(asked_at - item.time) / MS:.0f} ms later"
                )
