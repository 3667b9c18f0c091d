"""The service: reports to the service manager, real-time scheduling, and sizes that were not measured."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.identity import COMPILED, PURE, beyond_measured
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service import operating_system
from pdgw.gateway.service.operating_system import DEFAULT_PRIORITY, ServiceManager
from tests.support.buses import PATIENCE_S
from tests.support.gateways.daemon import axis, configuration, world_of
from tests.support.gateways.daemon import running as playing
from tests.support.processes import free_udp_port, running

# -- ready, watchdog triggered only by cycles, stopping -----------------------------------------------------------


WATCHDOG_S = 2


@contextmanager
def manager_socket(address: str) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(address)
        listening.setblocking(False)
        yield listening


def received(listening: socket.socket) -> list[bytes]:
    lines = []
    while True:
        try:
            lines.append(listening.recv(100))
        except BlockingIOError:
            return lines


@pytest.mark.parametrize("abstract", [False, True])
def test_ready_alive_stopping(tmp_path: Path, abstract: bool) -> None:
    name = f"pdgw-{tmp_path.name}-{time.monotonic_ns()}" if abstract else str(tmp_path / "notify")
    environment = {"NOTIFY_SOCKET": f"@{name}" if abstract else name, "WATCHDOG_USEC": str(WATCHDOG_S * 1_000_000)}
    with manager_socket(f"\0{name}" if abstract else name) as listening:
        manager = ServiceManager(environment, 1)

        def before(daemon: Daemon) -> None:
            daemon.watch.listeners.append(manager)
            daemon.services.append(manager)

        with playing(configuration(axis(1)), before) as daemon:
            assert received(listening)[0] == b"READY=1"
            signs = []
            for _ in range(10):
                world_of(daemon).loop.run_for(SECOND)
                signs += received(listening)
            # Four in each time-out, so that one that is lost does no harm; not one in each cycle.
            assert set(signs) == {b"WATCHDOG=1"}
            assert 4 * 10 / WATCHDOG_S - 1 <= len(signs) <= 4 * 10 / WATCHDOG_S + 1
        assert received(listening)[-1] == b"STOPPING=1"
        assert manager.failures == 0


def test_no_sign_of_life_without_cycles(tmp_path: Path) -> None:
    with manager_socket(str(tmp_path / "n")) as listening:
        manager = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "n"), "WATCHDOG_USEC": "2000000"}, 7)
        manager.start()
        assert received(listening) == [b"READY=1"]
        manager.cycle(5 * MS, False, 0)
        manager.cycle(6 * MS, False, 0)
        assert received(listening) == [b"WATCHDOG=1"]
        manager.stop()


@pytest.mark.parametrize(
    "environment",
    [{}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "8"}],
    ids=["none", "no number", "another process"],
)
def test_no_watchdog_without_a_request_to_this_process(environment: dict[str, str]) -> None:
    manager = ServiceManager(environment, 7)
    assert manager.interval_ns == 0
    manager.start()
    manager.cycle(1, True, 2)
    manager.stop()


def test_a_manager_that_does_not_read_is_counted_and_never_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "n"
    with manager_socket(str(path)):
        manager = ServiceManager({"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "4"}, 7)
        for now in range(2000, 2_000_000, 1000):
            manager.cycle(now, True, now)
        assert manager.failures > 0  # the socket's buffer is full
        manager.stop()
    gone = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "missing")}, 7)
    gone.start()
    assert gone.failures == 1
    gone.stop()


@pytest.mark.e2e
def test_a_hung_gateway_gives_no_sign_of_life(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with manager_socket(str(tmp_path / "n")) as listening:
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "n"))
        monkeypatch.setenv("WATCHDOG_USEC", "400000")
        ports = ["--cyclic-port", str(free_udp_port()), "--acyclic-port", "0", "--status-port", "0"]
        with running("run", "--simulate", *ports, log=tmp_path / "log") as process:
            listening.settimeout(PATIENCE_S)
            assert listening.recv(100) == b"READY=1"
            assert listening.recv(100) == b"WATCHDOG=1"
            process.send_signal(signal.SIGSTOP)
            listening.settimeout(1)
            with contextlib.suppress(TimeoutError):
                while True:  # what was on the way
                    listening.recv(100)
            with pytest.raises(TimeoutError):
                listening.recv(100)
            process.send_signal(signal.SIGCONT)
            listening.settimeout(PATIENCE_S)
            assert listening.recv(100) == b"WATCHDOG=1"
            # As the manager's watchdog ends it: it says where it was.
            process.send_signal(signal.SIGABRT)
            process.wait(PATIENCE_S)
    assert "Fatal Python error: Aborted" in (tmp_path / "log").read_text()


# -- real-time scheduling, by default -----------------------------------------------------------------------------


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


# -- configurations beyond those measured with the running build --------------------------------------------------


@pytest.mark.parametrize("build", [PURE, COMPILED])
def test_more_axes_or_a_shorter_cycle_than_measured_are_reported(build: str) -> None:
    for axes, cycle_ms in ((1, 1), (8, 1), (4, 4), (32, 8)):
        assert beyond_measured(axes, cycle_ms, build) == ""
    assert beyond_measured(9, 1, build).startswith(f"9 axes at 1 ms: beyond what this build ({build}) was measured for")
    assert beyond_measured(1, 0.1, build).startswith("1 axis at 0.1 ms")
