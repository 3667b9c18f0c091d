"""Lines of the log: with dates, as JSON, for the journal; repeated lines are written once and counted."""

from __future__ import annotations

import json
import logging
import os
import re
from datetime import datetime
from pathlib import Path

import pytest

from pdgw.durations import SECOND
from pdgw.gateway.reasons import FaultNumber, Reason
from pdgw.tools.service.log_format import AT_ONCE, Bundle, LogFormat, LogLevel, formatter
from pdgw.tools.service.run_log import RunLog
from tests.support.buses import PATIENCE_S, wait_for
from tests.support.gateways.daemon import Plc, axis, configuration, running, world_of


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
    assert any(line.get("event") == "reason" and Reason.PLC_LOST.value in line["text"] for line in lines)


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


def test_repeated_lines_are_written_once_and_counted() -> None:
    bundle = Bundle()
    assert texts(bundle.take(record("a"))) == ["a"]
    assert bundle.take(record("a", 1)) == bundle.take(record("a", 2)) == []
    assert texts(bundle.take(record("b", 3))) == ["a (2 times more)", "b"]
    assert texts(bundle.take(record("b", 3, logging.ERROR))) == ["b"]  # another level is another thing
    assert bundle.take(record("b", 4, logging.ERROR)) == []
    assert bundle.due(5) == []
    assert texts(bundle.due(14)) == ["b (once more)"]
    assert bundle.due(30) == bundle.flush() == []
    assert texts(bundle.take(record("a", 31))) == ["a"]
    assert texts(bundle.take(record("b", 32))) == ["b"]


def test_endlessly_repeated_line_is_reported_every_ten_seconds() -> None:
    bundle = Bundle()
    told = [item for second in range(60) for item in bundle.take(record("again", second))]
    assert texts(told) == ["again", *["again (11 times more)"] * 5]


def fault(text: str, seconds: float, number: int = 101, do: int = 1) -> logging.LogRecord:
    made = record(text, seconds, logging.ERROR)
    made.__dict__.update(event="fault", do=do, fault=number)
    return made


def test_a_storm_of_emcy_is_limited_and_counted() -> None:
    """6000 different EMCY of a drive in 3 s; another drive's fault and another fault number are written at once."""
    bundle = Bundle()
    written = []
    for number in range(6000):
        written += bundle.take(fault(f"EMCY {number}", number / 2000))
        if number == 3000:
            written += bundle.take(fault("other drive", 1.5, do=2))
            written += bundle.take(fault("other fault", 1.5, number=106))
    written += bundle.due(5)
    assert len(written) <= AT_ONCE + 4
    assert {"other drive", "other fault"} <= set(texts(written))
    written += bundle.due(14)
    assert "EMCY 5999" in texts(written)[-1]
    storm = [text for text in texts(written) if "EMCY" in text]
    counted = sum(int(text.split()[0]) for text in storm if "omitted" in text)
    assert counted + sum("omitted" not in text for text in storm) == 6000
    assert bundle.flush() == bundle.due(60) == []
    assert texts(bundle.take(fault("later", 100))) == ["later"]


def test_reason_that_toggles_for_an_hour_is_a_line_and_a_count_every_ten_seconds() -> None:
    bundle = Bundle()
    written = []
    for second in range(3600):
        made = record(f"axis 1: {'Waits' if second % 2 else 'In operation'}, since {second}", second)
        made.__dict__.update(event="reason", do=1)
        written += bundle.take(made)
    assert texts(written)[:AT_ONCE] == [text for text in texts(written)[:AT_ONCE] if "omitted" not in text]
    assert len(written) <= AT_ONCE + 2 * 360


@pytest.mark.parametrize("step_s", [-86_400, 86_400])
def test_clock_step_does_not_delay_counts(step_s: int) -> None:
    bundle = Bundle()
    for number in range(AT_ONCE + 2):
        bundle.take(fault(f"EMCY {number}", 100_000))
    for _ in range(2):
        bundle.take(record("again", 100_000))
    assert texts(bundle.due(100_001 + step_s)) == [
        "again (once more)",
        f"2 similar lines omitted, the last: EMCY {AT_ONCE + 1}",
    ]


def test_a_storm_of_lines_without_an_event_is_limited_by_its_place_in_the_code() -> None:
    bundle = Bundle()
    assert len([text for number in range(1000) for text in bundle.take(record(f"line {number}"))]) == AT_ONCE
    other = record("another place")
    other.lineno += 1
    assert texts(bundle.take(other)) == ["another place"]
    assert texts(bundle.flush()) == [f"{1000 - AT_ONCE} similar lines omitted, the last: line 999"]


def test_repetitions_at_the_end_are_logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pdgw.tools.service.log_format._FLUSH_S", PATIENCE_S)
    path = tmp_path / "log"
    run_log = RunLog(LogLevel.INFO, path)
    for _ in range(1000):
        logging.getLogger("gateway").info("the same")
    run_log.stop()
    assert [line.split("INFO")[1].strip() for line in path.read_text().splitlines()] == [
        "the same",
        "the same (999 times more)",
    ]


def test_renamed_log_file_is_reopened_without_a_signal(tmp_path: Path) -> None:
    path = tmp_path / "log"
    run_log = RunLog(LogLevel.INFO, path)
    logging.getLogger("gateway").info("before")
    wait_for(path.read_text, "written")
    path.rename(tmp_path / "log.1")
    logging.getLogger("gateway").info("after")
    run_log.stop()
    assert "after" in path.read_text()
