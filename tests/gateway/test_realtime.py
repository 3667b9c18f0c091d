"""Real-time scheduling: asked for as configured, and what is refused is told with what would grant it."""

from __future__ import annotations

import os
import threading

import pytest

from pdgw.gateway import realtime
from pdgw.gateway.config_surroundings import RealtimeConfig


def test_nothing_is_asked_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("asked")

    for name in ("sched_setscheduler", "sched_setaffinity"):
        monkeypatch.setattr(os, name, never, raising=False)
    assert realtime.apply(RealtimeConfig()) == []


def test_what_the_system_refuses_is_told_with_the_right_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse, raising=False)
    monkeypatch.setattr(os, "SCHED_FIFO", 1, raising=False)
    monkeypatch.setattr(os, "sched_param", lambda priority: priority, raising=False)
    (line,) = realtime.apply(RealtimeConfig(priority=50))
    assert line.startswith("[realtime] priority = 50: Operation not permitted, goes on without")
    assert "CAP_SYS_NICE" in line


def test_a_system_without_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_setaffinity", raising=False)
    assert realtime.apply(RealtimeConfig(cpu=(0,))) == [
        "[realtime] cpu = [0]: not on this operating system, goes on without"
    ]


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the operating system has no processor affinity")
def test_the_gateway_runs_where_it_is_asked_to() -> None:
    """Linux keeps the affinity of each thread: this one ends with the test."""
    wanted = min(os.sched_getaffinity(0))
    found: list[object] = []

    def run() -> None:
        found.extend((realtime.apply(RealtimeConfig(cpu=(wanted,))), os.sched_getaffinity(0)))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found == [[], {wanted}]
