"""The platform of this machine with a clock that stops while the process gets no processor.

All that a test has on it, gateway, drives and PLC, is then held up together, for however long, and none of them finds another
one silent. What is waited for in the kernel or in another program takes its real time.
"""

from __future__ import annotations

import time
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.loop.readiness import best_readiness
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.gateway.base.platform import SystemPlatform

_AT_MOST_NS: Final = 20 * MS
"""Between two looks at the clock no more than this passes, beside what the loop meant to wait: the rest was a stall."""


class _Clock:
    def __init__(self) -> None:
        self.may_wait_ns = 0
        self._real = self._shown = time.monotonic_ns()

    def now(self) -> int:
        real = time.monotonic_ns()
        self._shown += min(real - self._real, self.may_wait_ns + _AT_MOST_NS)
        self._real = real
        return self._shown


class ReportingReadiness:
    """Report to the clock how long the loop waits."""

    def __init__(self, clock: _Clock) -> None:
        self.system = best_readiness()
        self._clock = clock
        self.watch = self.system.watch
        self.close = self.system.close

    def wait(self, seconds: float) -> list[tuple[int, int]]:
        clock = self._clock
        clock.now()
        clock.may_wait_ns = int(seconds * SECOND)
        ready = self.system.wait(seconds)
        clock.now()
        clock.may_wait_ns = 0
        return ready


class UnhurriedPlatform(SystemPlatform):
    """The machine with such a clock."""

    def __init__(self) -> None:
        clock = _Clock()
        self.loop = SystemLoop(ReportingReadiness(clock), clock.now)
