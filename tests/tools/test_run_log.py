"""Log and recording never delay the gateway: full disks, blocked pipes, storms. The lines of the log and its formats."""

from __future__ import annotations

import errno
import json
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.communication import EMCY, SDO_RESPONSE
from pdgw.ds301.counters import Counters
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.tools.recording import recorder
from pdgw.tools.service.log_format import LogFormat, LogLevel, formatter
from pdgw.tools.service.run_log import RunLog, on_signals
from tests.support.buses import PATIENCE_S, wait_for
from tests.support.gateways.daemon import Plc, axis, configuration, running, until, world_of
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
        for number in range(500):
            network.on_frame(EMCY + 1, number.to_bytes(2, "little") + bytes(6), 0)
            network.on_frame(SDO_RESPONSE + 1, bytes(8), 0)
        assert len(daemon.axes[0].faults) <= 64
        assert world_of(daemon) is daemon.platform


def record(text: str, created: float = 0.0, level: int = logging.INFO) -> logging.LogRecord:
    return logging.makeLogRecord(
        {"msg": text, "levelno": level, "levelname": logging.getLevelName(level), "created": created}
    )


def texts(records: list[logging.LogRecord]) -> list[str]:
    return [item.getMessage() for item in records]


def test_text_has_the_date_the_level_and_milliseconds() -> None:
    line = formatter(LogFormat.TEXT, to_file=True).format(record("stopped", 1_700_000_000.25))
    assert re.fullmatch(r"2023-11-\d\d \d\d:\d\d:20\.\d{3} INFO    stopped", line)


def test_json_has_time_level_event_object_fault_and_text(tmp_path: Path) -> None:
    path = tmp_path / "log"
    run_log = RunLog(LogLevel.INFO, path, LogFormat.JSON)
    with running(configuration(axis(7))) as daemon:
        Plc(daemon, [1]).exchange()
        world_of(daemon).loop.run_for(SECOND)
        daemon.axes[0].raise_fault(FaultNumber.REFERENCE, 'a "quoted" text\nin two lines', world_of(daemon).loop.now())
        next(iter(daemon.networks.values())).on_error_frame(bus_off=True, passive=False)
    run_log.stop()
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    for line in lines:
        assert {"time", "level", "text"} <= line.keys() <= {"time", "level", "text", "event", "do", "bus", "fault"}
        assert datetime.fromisoformat(line["time"]).tzinfo is not None
    (fault,) = (line for line in lines if line.get("fault") == 104)
    assert (fault["level"], fault["event"], fault["do"]) == ("error", "fault", 7)
    assert '"quoted" text\nin two lines' in fault["text"]
    assert any(line.get("bus") == "can" and line["event"] == "bus" for line in lines)
    assert any(line.get("event") == "reason" and "Waits: PLC lost: no valid frame" in line["text"] for line in lines)


def test_the_journal_gets_levels_and_no_second_date(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "journal").open("w") as file:
        monkeypatch.setattr("sys.stderr", file)
        status = os.fstat(file.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino}")
        chosen = formatter(LogFormat.AUTO, to_file=False)
        levels = (logging.ERROR, logging.WARNING, logging.INFO, logging.DEBUG)
        lines = [chosen.format(record("x", level=level)) for level in levels]
        assert lines == ["<3>x", "<4>x", "<6>x", "<7>x"]
        # Neither a log file nor standard error that was redirected since is the journal.
        assert formatter(LogFormat.AUTO, to_file=True).format(record("x")).startswith("19")
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino + 1}")
        assert formatter(LogFormat.AUTO, to_file=False).format(record("x")).startswith("19")


def test_renamed_log_file_is_reopened_without_a_signal(tmp_path: Path) -> None:
    path = tmp_path / "log"
    run_log = RunLog(LogLevel.INFO, path)
    logging.getLogger("gateway").info("before")
    wait_for(path.read_text, "written")
    path.rename(tmp_path / "log.1")
    logging.getLogger("gateway").info("after")
    run_log.stop()
    assert "after" in path.read_text()
