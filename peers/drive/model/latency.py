"""Latency of a simulated drive: it applies commands late and shows its Statusword late.

Every real drive has it: one task reads the PDOs, another runs the state machine, a third builds the Statusword. CiA DSP 402
V2.0 sets no limit.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import MS

LATENCY_MAX_MS: Final = 100


@dataclass(slots=True)
class Latency:
    """Latency of a drive in each direction, usually 0 to 100 ms.

    ``command_ms``: from the reception of an RPDO until its values apply. ``status_ms``: from a change of the drive until the
    Statusword shows it; positions and speeds are up to date.
    """

    command_ms: int = 0
    status_ms: int = 0


NO_LATENCY: Final = Latency()


class DelayLine:
    """A value that is shown with a delay. Times are those of the drive, in nanoseconds."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, int]] = deque()
        self._last = self._shown = -1

    @property
    def next_change(self) -> int | None:
        """Time of the next change of the shown value; None without one."""
        return self._waiting[0][0] if self._waiting else None

    def show(self, value: int, now: int, delay_ms: int) -> int:
        """Take the present value; return the value that is shown now. The first value is shown at once."""
        waiting = self._waiting
        if self._last < 0 or not (delay_ms or waiting):
            self._last = self._shown = value
        elif value != self._last:
            self._last = value
            waiting.append((now + delay_ms * MS, value))
        while waiting and waiting[0][0] <= now:
            self._shown = waiting.popleft()[1]
        return self._shown
