"""Real-time scheduling: asked for by default; what is refused is logged with what would grant it."""

from __future__ import annotations

import logging
import os

import pytest

from pdgw.gateway.service import operating_system
from pdgw.gateway.service.operating_system import DEFAULT_PRIORITY

OTHER, FIFO, BATCH = 0, 1, 3


class System:
    """The scheduling calls of an operating system that grants or refuses."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, policy: int = OTHER, refuses: bool = False) -> None:
        self.policy, self.priority = policy, 77 if policy == FIFO else 0
        self.refuses = refuses
        self.asked: list[tuple[int, int, int]] = []
        monkeypatch.setattr(os, "SCHED_OTHER", OTHER, raising=False)
        monkeypatch.setattr(os, "SCHED_FIFO", FIFO, raising=False)
        monkeypatch.setattr(os, "sched_param", Parameter, raising=False)
        monkeypatch.setattr(os, "sched_getscheduler", lambda pid: self.policy, raising=False)
        monkeypatch.setattr(os, "sched_getparam", lambda pid: Parameter(self.priority), raising=False)
        monkeypatch.setattr(os, "sched_setscheduler", self.set, raising=False)

    def set(self, pid: int, policy: int, parameter: Parameter) -> None:
        self.asked.append((pid, policy, parameter.sched_priority))
        if self.refuses:
            raise PermissionError(1, "Operation not permitted")
        self.policy, self.priority = policy, parameter.sched_priority


class Parameter:
    """``os.sched_param``, which not every operating system has."""

    def __init__(self, sched_priority: int) -> None:
        self.sched_priority = sched_priority


def test_the_default_asks_for_priority_40_and_logs_that_it_is_granted(monkeypatch: pytest.MonkeyPatch) -> None:
    system = System(monkeypatch)
    line = operating_system.request(1)
    assert system.asked == [(0, FIFO, DEFAULT_PRIORITY)]
    assert line == (logging.INFO, "real-time priority 40 (SCHED_FIFO)")


def test_the_default_keeps_a_priority_that_the_starter_chose(monkeypatch: pytest.MonkeyPatch) -> None:
    system = System(monkeypatch, policy=FIFO)
    assert operating_system.request(1) == (logging.INFO, "real-time priority 77 (SCHED_FIFO)")
    assert system.asked == []


def test_a_refused_default_is_one_line_and_a_warning_below_8_ms(monkeypatch: pytest.MonkeyPatch) -> None:
    System(monkeypatch, refuses=True)
    level, text = operating_system.request(4)
    assert level == logging.WARNING
    assert text.startswith("normal scheduling: SCHED_FIFO is not granted (Operation not permitted; LimitRTPRIO=40")
    assert text.endswith("a busy machine misses cycles of 4 ms")
    level, text = operating_system.request(8)
    assert level == logging.INFO
    assert "missed" not in text


def test_the_usual_scheduling_that_the_starter_chose_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    system = System(monkeypatch, policy=BATCH)
    assert operating_system.request(1) == (logging.INFO, "normal scheduling, as started")
    assert system.asked == []


def test_a_system_without_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("sched_setscheduler", "sched_getscheduler"):
        monkeypatch.delattr(os, name, raising=False)
    assert operating_system.request(8)[1] == "normal scheduling: SCHED_FIFO is not available on this operating system"


def test_a_process_started_beside_the_gateway_has_the_usual_scheduling(monkeypatch: pytest.MonkeyPatch) -> None:
    system = System(monkeypatch)
    operating_system.usual(4711)
    assert system.asked == [(4711, OTHER, 0)]


def test_no_test_changes_the_scheduling_of_its_process() -> None:
    if not hasattr(os, "sched_getscheduler"):
        pytest.skip("the operating system has no scheduling classes")
    before = os.sched_getscheduler(0)
    level, text = operating_system.request(4)
    assert os.sched_getscheduler(0) == before
    assert before or (level == logging.WARNING and "stays as it is" in text)
