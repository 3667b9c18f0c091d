"""The log never delays the gateway: full disks, blocked pipes, storms."""

from __future__ import annotations

import errno
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from pdgw.ds301.communication import EMCY, SDO_RESPONSE
from pdgw.ds301.counters import Counters
from pdgw.tools.recording import recorder
from pdgw.tools.service.log_format import LogLevel
from pdgw.tools.service.run_log import RunLog, on_signals
from tests.support.buses import PATIENCE_S
from tests.support.gateways.daemon import axis, configuration, running, until, world_of
from tests.support.logs import log_put_back


def test_log_tests_remove_their_handlers(tmp_path: Path) -> None:
    root, gateway = logging.getLogger(), logging.getLogger("gateway")
    before = root.handlers[:], root.level, gateway.level, gateway.getEffectiveLevel()
    with log_put_back():
        run_log = RunLog(LogLevel.ERROR, tmp_path / "log")
        assert gateway.getEffectiveLevel() == logging.ERROR
        run_log.stop()
    assert (root.handlers, root.level, gateway.level, gateway.getEffectiveLevel()) == before


def shown(counters: Counters, part: str) -> int:
    return sum(int(item["value"]) for item in counters.values() if item["part"] == part)  # type: ignore[call-overload]


def test_log_continues_when_its_folder_is_back(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    run_log = RunLog(LogLevel.INFO, folder / "log")
    gateway = logging.getLogger("gateway")

    def wait(condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition() and time.monotonic() < deadline:
            time.sleep(0.01)

    gateway.info("before")
    wait(lambda: "before" in (folder / "log").read_text())
    folder.rename(tmp_path / "old")
    gateway.info("between")
    wait(lambda: run_log.lost)
    assert run_log.lost == 1
    folder.mkdir()
    gateway.info("after")
    run_log.stop()
    assert (folder / "log").read_text().rstrip().endswith("after")


def test_sighup_on_a_full_disk_does_not_end_the_gateway(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_log = RunLog(LogLevel.INFO, tmp_path / "log")

    def full() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(run_log._handler, "close", full)
    on_signals(lambda: None, run_log)["SIGHUP"]()
    assert run_log.lost == 1
    run_log.stop()


SCRIPT = """
import logging, sys
from pdgw.tools.service.log_format import LogLevel
from pdgw.tools.service.run_log import RunLog
run_log = RunLog(LogLevel.INFO, None)
for number in range(3000):
    logging.getLogger("gateway").info("%d %s", number, "x" * 200, extra={"do": number})
run_log.stop()
sys.stdout.write(str(run_log.lost))
"""


@pytest.mark.e2e
def test_log_to_a_blocked_pipe_does_not_prevent_the_end() -> None:
    reading, writing = os.pipe()
    try:
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT], stderr=writing, stdout=subprocess.PIPE, timeout=PATIENCE_S, check=True
        )
    finally:
        os.close(reading)
        os.close(writing)
    assert int(done.stdout) > 0


def test_lines_that_were_still_waiting_at_the_end_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "END_S", 0.01)
    run_log = RunLog(LogLevel.INFO, tmp_path / "log")
    run_log._handler.acquire()
    try:
        for number in range(5):
            logging.getLogger("gateway").info("%d", number)
        run_log.stop()
        assert run_log.lost >= 5
    finally:
        run_log._handler.release()


def test_delayed_end_of_a_process_costs_one_short_wait() -> None:
    class Writing(threading.Thread):
        waits = 0

        def join(self, timeout: float | None = None) -> None:
            self.waits += 1

        def is_alive(self) -> bool:
            return self.waits < 3

    thread = Writing()
    recorder.wait_for_end(thread)
    assert thread.waits == 3


def test_a_storm_of_log_lines_is_bounded_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pdgw.tools.service.run_log._LINES", 10)
    run_log = RunLog(LogLevel.INFO, tmp_path / "log")
    counters = Counters()
    run_log.count_in(counters)
    run_log._handler.acquire()
    try:
        for number in range(1000):
            logging.getLogger("gateway").info("%d", number)
    finally:
        run_log._handler.release()
    run_log.stop()
    assert shown(counters, "log") >= 900


def test_sighup_continues_in_a_new_log_file(tmp_path: Path) -> None:
    path = tmp_path / "log"
    run_log = RunLog(LogLevel.INFO, path)
    stops: list[str] = []
    signals = on_signals(lambda: stops.append("stop"), run_log)
    logging.getLogger("gateway").info("before")
    deadline = time.monotonic() + PATIENCE_S
    while "before" not in path.read_text() and time.monotonic() < deadline:
        time.sleep(0.01)
    path.rename(tmp_path / "log.1")
    signals["SIGHUP"]()
    logging.getLogger("gateway").info("after")
    run_log.stop()
    assert "before" in (tmp_path / "log.1").read_text()
    assert "after" in path.read_text()
    assert stops == []
    for name in ("SIGUSR1", "SIGUSR2"):
        signals[name]()
    assert stops == []
    for name in ("SIGQUIT", "SIGTERM", "SIGINT"):
        signals[name]()
    assert len(stops) == 3


@pytest.mark.parametrize(("before", "expected"), [(signal.SIG_DFL, ["stop"]), (signal.SIG_IGN, [])])
def test_sighup_without_a_log_file_stops_except_under_nohup(
    before: signal.Handlers, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signal, "getsignal", lambda number: before)
    stops: list[str] = []
    on_signals(lambda: stops.append("stop"), cast(RunLog, SimpleNamespace(reopens=False)))["SIGHUP"]()
    assert stops == expected


def test_a_traceback_too_long_for_a_pipe_keeps_its_last_line(capfd: pytest.CaptureFixture[str]) -> None:
    run_log = RunLog(LogLevel.INFO, None)
    try:
        raise ValueError("x" * 5000 + " what was wrong")
    except ValueError:
        logging.getLogger("gateway").exception("a task ended")
    run_log.stop()
    told = capfd.readouterr().err
    assert "a task ended" in told
    assert "ValueError: x" in told
    assert told.endswith(" what was wrong\n")
    assert len(told) < 2200


def test_storms_of_emcy_and_sdo_answers_need_limited_memory() -> None:
    with running(configuration(axis(1))) as daemon:
        until(daemon, lambda: daemon.axes[0].drive.generation, "online")
        (network,) = daemon.networks.values()
        for number in range(5000):
            network.on_frame(EMCY + 1, number.to_bytes(2, "little") + bytes(6))
            network.on_frame(SDO_RESPONSE + 1, bytes(8))
        assert len(daemon.axes[0].faults) <= 64
        assert world_of(daemon) is daemon.platform
