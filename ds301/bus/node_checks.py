"""Check all nodes of a bus every 20 ms, all together: each time of its own would wake the loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.loop.loop import Loop, Timer

CHECK_NS: Final = 20 * MS
_EARLY_NS: Final = MS
"""Actions due this soon after a cycle start with the cycle before, so that their order does not depend on chance."""


class NodeChecks:
    """Of one bus. ``take`` receives the frames that have waited, before each check."""

    def __init__(self, loop: Loop, take: Callable[[int], None]) -> None:
        self._loop = loop
        self._take = take
        self._checks: list[Callable[[int], None]] = []
        self._timer: Timer | None = None

    def add(self, check: Callable[[int], None]) -> None:
        """Call with the time every 20 ms."""
        self._checks.append(check)
        if self._timer is None:
            self._timer = self._loop.call_later(CHECK_NS, self._run)

    def remove(self, check: Callable[[int], None]) -> None:
        """The end of ``add``."""
        self._checks.remove(check)

    def run_before(self, when: int) -> None:
        """Check now if it would be due before ``when`` or soon after: the cyclic exchange is awake, and wakes again only then."""
        timer = self._timer
        if timer is not None and timer.when <= when + _EARLY_NS:
            timer.cancel()
            self._run()

    def _run(self) -> None:
        now, timer, self._timer = self._loop.now(), self._timer, None
        self._take(now)
        for check in self._checks:
            check(now)
        if self._checks and timer is not None:
            self._timer = self._loop.call_at(max(now, timer.when) + CHECK_NS, self._run)

    def cancel(self) -> None:
        """Check no more."""
        if self._timer is not None:
            self._timer.cancel()
