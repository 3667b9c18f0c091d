"""Work at the end of each cycle: cycle times, the flight recorder, and the watchdog of the service manager.

The cyclic loop calls only ``CycleWatch.cycle``, after the PLC has its answer and the drives their commands.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import Final, Protocol

from pdgw.base.durations import MS, SECOND

BOUNDS_NS: Final = (*(int(step * scale * MS) for scale in (0.1, 1, 10) for step in (1, 2, 5)), 100 * MS)
"""Upper ends of the classes: 0.1 to 100 ms in steps of 1, 2, 5. Longer times have their own class."""


class Histogram:
    """Durations by class. Counts are plain integers and never fall."""

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS_NS) + 1)
        self.total_ns = 0
        self.longest_ns = 0

    def observe(self, duration_ns: int) -> None:
        self.counts[bisect_left(BOUNDS_NS, duration_ns)] += 1
        self.total_ns += duration_ns
        self.longest_ns = max(self.longest_ns, duration_ns)

    def status(self) -> dict[str, object]:
        """Upper ends in seconds, how many were in each class (the last one: longer than all), the sum and the longest of all."""
        return {
            "bounds_s": [bound / SECOND for bound in BOUNDS_NS],
            "counts": list(self.counts),
            "sum_s": self.total_ns / SECOND,
            "max_s": self.longest_ns / SECOND,
        }


class CycleListener(Protocol):
    """Observer that is called in every cycle."""

    def cycle(self, now: int, accepted: bool, answered: int) -> None:
        """See ``CycleWatch.cycle``. It never waits."""


class CycleWatch:
    """The only call of the cyclic loop about its cycles."""

    def __init__(self) -> None:
        self.periods = Histogram()
        """Times from the start of a cycle to the next."""
        self.responses = Histogram()
        """Times from the PLC's frame to the answer."""
        self.ages = Histogram()
        """Greatest possible ages of the PLC's frames: from the gateway's frame that they answer."""
        self.listeners: list[CycleListener] = []
        self._last = 0

    def cycle(self, now: int, accepted: bool, answered: int, age_ns: int | None = None) -> None:
        """A cycle that began at ``now`` is done.

        ``accepted``: it began with a frame of the PLC; ``answered``: when its answer was sent, 0 without one; ``age_ns``: age of
        the PLC's frame, if known.
        """
        if self._last:
            self.periods.observe(now - self._last)
        self._last = now
        if accepted and answered:
            self.responses.observe(answered - now)
        if age_ns is not None:
            self.ages.observe(age_ns)
        for listener in self.listeners:
            listener.cycle(now, accepted, answered)
