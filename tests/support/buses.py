"""Virtual buses with names of their own, a loop run by tests, and waiting for conditions instead of sleeping."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can

from pdgw.base.durations import MS
from pdgw.ds301.bus.interfaces import open_bus
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.bus.port import open_port
from pdgw.ds301.loop.loop import Loop
from pdgw.ds301.loop.system_loop import SystemLoop

_numbers = itertools.count()
_loops: list[SystemLoop] = []
"""Loops that run while the test waits."""
process_checks: list[Callable[[], None]] = []
"""One for each process of the test: AssertionError if the process has failed, so that waiting is useless."""
_POLL_NS = 10 * MS
"""Between two looks at a condition: to ask a process costs it and this one a millisecond or more."""
PATIENCE_S = 300.0
"""Longest wait, also on a busy machine; a longer one is a defect."""


def channel() -> str:
    """A virtual channel no other test uses."""
    return f"test-{next(_numbers)}"


def bus(name: str) -> can.BusABC:
    return open_bus("virtual", name)


def wait_for(condition: Callable[[], object], what: str | Callable[[], str], seconds: float = PATIENCE_S) -> None:
    """Wait until the condition is true. At the timeout, fail with ``what``; a function is evaluated at that time."""
    deadline = time.monotonic() + seconds
    while not condition():
        check_processes()
        assert time.monotonic() < deadline, f"not within {seconds} s: {what() if callable(what) else what}"
        pass_time(_POLL_NS)


def check_processes() -> None:
    """AssertionError if a process of the test has failed."""
    for check in process_checks:
        check()


def pass_time(duration: int) -> None:
    """Run the test's loops for this number of nanoseconds."""
    if not _loops:
        time.sleep(duration / 1e9)
    for loop in _loops:
        loop.call_later(duration, loop.stop)
        loop.run()


@contextmanager
def looped() -> Iterator[SystemLoop]:
    """A loop that runs while the test waits."""
    loop = SystemLoop()
    _loops.append(loop)
    try:
        yield loop
    finally:
        _loops.remove(loop)
        loop.close()


def network(loop: Loop, on: can.BusABC) -> CanNetwork:
    return CanNetwork(loop, lambda: open_port(loop, on))
