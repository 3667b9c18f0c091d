"""An axis at standstill before its motion has ended."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True, eq=False)
class Stall:
    """Call ``step`` once per cycle. Way counts, not speed: a slow task is always inside the standstill window."""

    _time: int
    """Time without way that is a stall, ns."""
    _since: int = -1
    """When the axis made way last, monotonic ns; -1: nothing is expected."""
    _lowest: int = 0
    """Lowest and"""
    _highest: int = 0
    """highest position since: encoder noise stays between them."""

    def step(self, expects: bool, position: int, now: int) -> bool:
        """One cycle; True for a stalled axis. ``expects``: the axis is at standstill, and its motion has not ended."""
        if not expects:
            self._since, self._lowest, self._highest = -1, 0, 0
        elif self._since < 0:
            self._since, self._lowest, self._highest = now, position, position
        elif not self._lowest <= position <= self._highest:
            self._since = now
            self._lowest, self._highest = min(position, self._lowest), max(position, self._highest)
        return self._since >= 0 and now - self._since >= self._time
