"""The second half of ``make long LONG=paused``: in a test with threads, pause one thread after the other for up to a second.

A busy machine does the same, only more seldom. This pytest plugin (``python -m pytest -p tests.thread_pauses``) does nothing
until a test has a second thread. Then every thread pauses after random numbers of lines: just after its start, between two
accesses to shared data, in the middle of a long wait. ``PDGW_PAUSES`` is the seed; the same test gets the same numbers again,
not the same race. A test that fails shows its pauses: the pause that made it fail is often at the place of the defect. Only
threads of the test's own process pause; ``tests.pauses`` pauses its processes.
"""

from __future__ import annotations

import os
import random
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Generator
from enum import Enum
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

LONGEST_S = float(os.environ.get("PDGW_LONGEST_PAUSE", "1"))
"""``make long LONG=paused LONGEST=3``: three of them."""
SHORT_S = 0.02
"""Two of three pauses are no longer: enough for every other thread to run, and many find room in a test."""
IN_A_TEST_S = 4 * LONGEST_S
"""All pauses of a test together: it ends in the time its patience has for a busy machine."""
FARTHEST = 20_000
"""Lines and calls from one pause of a thread to its next, at most; evenly distributed over the orders of magnitude."""
SWITCH_S = 1e-5
"""Between two threads, in place of 5 ms."""
OURS = f"{Path(__file__).parents[1]}{os.sep}"
"""Of the files below, those of what is installed there not counted, every line counts, of all others every call."""


class Whose(Enum):
    """Which threads of a test are held up."""

    ALL = "all threads"
    MAIN = "the test's own"
    OTHERS = "all but the test's own"


class Pauses:
    """Those of one test."""

    def __init__(self, seed: str) -> None:
        self._chance = random.Random(seed)
        self.whose = self._chance.choice(list(Whose))
        self.left_s = IN_A_TEST_S
        self.made: list[str] = []
        self._until_next: defaultdict[int, int] = defaultdict(self._draw)

    def _draw(self) -> int:
        return int(FARTHEST ** self._chance.random())

    def pass_by(self, frame: FrameType) -> None:
        """A thread comes to a line."""
        thread = threading.get_ident()
        is_main = thread == _MAIN
        if self.left_s <= 0 or (self.whose is Whose.MAIN and not is_main) or (self.whose is Whose.OTHERS and is_main):
            return
        self._until_next[thread] -= 1
        if self._until_next[thread] > 0:
            return
        self._until_next[thread] = self._draw()
        longest = LONGEST_S if self._chance.random() < 1 / 3 else SHORT_S
        pause = self._chance.uniform(0, longest)
        self.left_s -= pause
        who = "the test's own thread" if is_main else _name(thread)
        code = frame.f_code
        self.made.append(f"{pause:.3f} s: {who} in {code.co_name}, {code.co_filename}:{frame.f_lineno}")
        _sleep(pause)


_sleep = time.sleep
_installing = threading.Lock()
"""Python refuses a trace function while another thread gets one."""
_start = threading.Thread.start
_begin = threading.Thread._bootstrap_inner  # type: ignore[attr-defined]
_MAIN = threading.main_thread().ident
_of_this_test: Pauses | None = None


def _name(ident: int) -> str:
    """``threading.current_thread`` would make one for a thread that has not entered itself."""
    return next((thread.name for thread in tuple(threading._active.values()) if thread.ident == ident), str(ident))  # type: ignore[attr-defined]


def _trace(frame: FrameType, event: str, _: object) -> Any:
    pauses = _of_this_test
    if pauses is not None and event in {"call", "line"}:
        pauses.pass_by(frame)
    return _trace if _is_ours(frame) else None


def _is_ours(frame: FrameType) -> bool:
    path = frame.f_code.co_filename
    return path.startswith(OURS) and not path.startswith(sys.prefix)


def _begin_here() -> None:
    """Trace this thread too, also the functions it is in."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if _is_ours(frame):
            frame.f_trace = _trace
        frame = frame.f_back
    _install()


def _install() -> None:
    with _installing:
        sys.settrace(_trace)


def _started(thread: threading.Thread) -> None:
    if _of_this_test is not None and sys.gettrace() is None and threading.get_ident() == _MAIN:
        _begin_here()
    _start(thread)


def _begun(thread: threading.Thread) -> None:
    _install()
    _begin(thread)


def pytest_configure() -> None:
    sys.setswitchinterval(SWITCH_S)
    threading.Thread.start = _started  # type: ignore[method-assign]
    threading.Thread._bootstrap_inner = _begun  # type: ignore[attr-defined]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """From the set-up of the fixtures until they are gone."""
    global _of_this_test  # noqa: PLW0603 (a trace function has no argument for it)
    pauses = _of_this_test = Pauses(f"{os.environ.get('PDGW_PAUSES', '1')} {item.nodeid}")
    # What a module's fixture has started. Daemons may be left by any test, and wait for nothing.
    if any(not thread.daemon for thread in threading.enumerate() if thread is not threading.main_thread()):
        _install()
    try:
        return (yield)
    finally:
        with _installing:
            sys.settrace(None)
        pauses.left_s = 0
        _of_this_test = None


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if _of_this_test is not None and _of_this_test.made:
        report.sections.append((f"pauses of {_of_this_test.whose.value}", "\n".join(_of_this_test.made)))
    return report
