"""``pdgw status``: values, ages and times of faults, folded and never cut; ``--check`` for monitoring systems; ``--watch``."""

from __future__ import annotations

import json
import os
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from pdgw.gateway.base.reasons import AxisState
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.profidrive.signal_text import texts
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.commands.gateway.status import status
from pdgw.tools.output.status_text import Health, check_line, duration, object_lines, status_lines
from tests.support.cli import pdgw
from tests.support.gateways.daemon import (
    OFF,
    SIMULATED_POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    encoder_of,
    operating,
    running,
    until,
)
from tests.support.processes import free_tcp_port


def fault(number: int, age_s: float) -> dict[str, Any]:
    return {
        "id": 1,
        "active": True,
        "number": number,
        "code": 1,
        "text": "drive does not confirm its mode of operation " * 3,
        "is_warning": number > 107,
        "time": "2026-03-01T12:03:41.500+01:00",
        "age_s": age_s,
    }


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    """What a gateway with a drive of telegram 9 and an encoder says."""
    table = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 83\nsimulate = true\n"
    with running(configuration(axis(1, telegram_number=9) + table)) as daemon:
        return snapshot(daemon)


def test_version_time_and_ages_are_in_the_document(document: dict[str, Any]) -> None:
    assert document["version"] == version("profidrive-gateway")
    assert document["time"][:2] == "20"
    for item in (*document["axes"], *document["encoders"]):
        assert item["heard_age_ms"] is None or item["heard_age_ms"] >= 0
        assert all({"time", "age_s"} <= entry.keys() for entry in item["faults"])


def test_file_that_changed_since_the_start_is_named(document: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text("")
    running_file = document | {"file": str(file), "file_modified": file.stat().st_mtime}

    def shown() -> str:
        return "\n".join(status_lines(running_file, 400))

    assert not document["file"], "the gateway of the test has none"
    assert "configuration" not in "\n".join(status_lines(document))
    assert f"configuration {file}\n" in shown()
    assert "since the start" not in shown()
    os.utime(file, (1, 1))
    assert "-> changed or removed since the start: the gateway runs what it read then" in shown()
    file.unlink()
    assert "-> changed or removed since the start" in shown()


@pytest.mark.parametrize("width", [40, 80, 132])
def test_no_line_is_longer_than_the_terminal_and_nothing_is_cut(document: dict[str, Any], width: int) -> None:
    item = document["axes"][0]
    changed = document | {"axes": [item | {"sentence": "a reason " * 20, "faults": [fault(12, 65), fault(108, 7300)]}]}
    lines = [*status_lines(changed, width, counters=True), *object_lines(changed, item["do_id"], width)]
    assert max(map(len, lines)) <= max(width, 62)
    text = " ".join(" ".join(lines).split())
    assert "… " not in text
    assert ("a reason " * 20).strip() in text
    for name in (*item["actuals"], "fault 12 at 12:03:41, 1 min 5 s ago", "warning 108 at 12:03:41, 2 h 1 min ago"):
        assert name in text


def test_values_are_shown_with_bits_and_percent(document: dict[str, Any]) -> None:
    item = document["axes"][0]
    setpoints = {"STW1": 0x043F, "SATZANW": 0x8000, "STW2": 0, "MDI_TARPOS": 0x20000000, "MDI_VELOCITY": 0}
    setpoints |= {"MDI_ACC": 0x2000, "MDI_DEC": 0, "MDI_MOD": 1}
    lines = object_lines(
        document | {"axes": [item | {"setpoint_texts": texts(telegram(9).setpoints, setpoints)}]}, item["do_id"], 400
    )
    (line,) = [line for line in lines if "from PLC" in line and "STW1" in line]
    assert "STW1 043Fh ON NO_COAST_STOP" in line
    assert "MDI_TARPOS 50.000 %" in line
    assert "MDI_ACC 50.000 %" in line


def test_position_is_in_the_unit_of_the_telegram() -> None:
    with running(configuration(axis(1, telegram_number=111, more=SIMULATED_POSITIONER))) as daemon:
        until(daemon, lambda: daemon.axes[0].good, "online")
        document = snapshot(daemon)
        item = document["axes"][0]
        assert item["position_unit"] == "LU"
        assert item["position"] == item["actuals"]["XIST_A"]
        assert f"position {item['position']} LU" in "\n".join(status_lines(document, 200))


def test_only_abnormal_counters_are_shown_by_default(document: dict[str, Any]) -> None:
    counters = [
        {"part": "bus can", "name": "sent", "value": 5, "unit": "frames", "meaning": "taken"},
        {"part": "bus can", "name": "bus_off", "value": 2, "unit": "messages", "meaning": "went bus-off"},
        {"part": "bus can", "name": "lost", "value": 0, "unit": "times", "meaning": "went away"},
    ]
    changed = document | {"counters": counters}
    short = "\n".join(status_lines(changed))
    assert "bus can bus_off: 2 messages (went bus-off)" in short
    assert "bus can sent" not in short
    assert "bus can lost" not in short
    assert "bus can lost: 0 times" in "\n".join(status_lines(changed, counters=True))


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0 s"), (59, "59 s"), (60, "1 min"), (725, "12 min 5 s"), (7380, "2 h 3 min"), (349_200, "4 d 1 h")],
)
def test_durations_have_two_units(seconds: float, text: str) -> None:
    assert duration(seconds) == text


@pytest.fixture(scope="module")
def well_document() -> dict[str, Any]:
    """A gateway that is well."""
    encoder = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
    with running(configuration(axis(1) + encoder)) as daemon:
        plc = Plc(daemon, [1, 81])
        plc.endpoint.set(1, {"STW2_ENC": 0x0400})
        plc.enable()
        plc.until(lambda: daemon.encoders[0].reason is None, "the encoder obeys")
        return snapshot(daemon)


def with_axis(well_document: dict[str, Any], **keys: object) -> dict[str, Any]:
    """The same with other values of the first axis."""
    item = well_document["axes"][0] | keys
    stops = item["state_id"] not in ("OBEYS", "OFF")
    cause = {key: item[key] for key in ("state", "state_id", "reason", "remedy")} | {"who": "axis 1", "objects": [1]}
    return well_document | {"axes": [item], "causes": [cause] if stops else []}


def test_check_rejects_other_output_formats() -> None:
    done = pdgw("status", "--check", "--json", "--watch")
    assert done.returncode == 2
    assert "prints one line, not allowed with --json, --watch" in done.stderr


def test_check_of_a_gateway_without_problems_is_ok(well_document: dict[str, Any]) -> None:
    health, line = check_line(well_document)
    assert health == Health.OK == 0
    assert line.startswith("OK - pdgw: PLC connected, 2 of 2 in operation | objects=2 obeying=2 findings=0 uptime=")


@pytest.mark.parametrize(
    ("state", "health"),
    [("OFF", 0), ("STARTING", 1), ("WAITS", 1), ("STOPPING", 1), ("FAULT", 2), ("NOT_ON_THE_BUS", 2)],
)
def test_the_state_of_an_axis_decides(well_document: dict[str, Any], state: str, health: int) -> None:
    found, line = check_line(with_axis(well_document, state_id=state, state=state.title(), reason="that is why"))
    assert found == health
    assert ("axis 1 " in line) == (health > 0)
    assert ("that is why" in line) == (health > 0)


def test_the_worst_comes_first_and_everything_is_in_one_line(well_document: dict[str, Any]) -> None:
    warning = {"active": True, "text": "a warning\nof two lines"}
    worse = with_axis(well_document, faults=[warning]) | {"buses": [{"name": "can0", "healthy": False}]}
    health, line = check_line(worse | {"plc": well_document["plc"] | {"connected": False}})
    assert health == Health.CRITICAL
    assert line.startswith("CRITICAL - pdgw: no PLC; bus can0 lost; axis 1: a warning of two lines |")
    assert check_line(with_axis(well_document, faults=[warning]))[0] == Health.WARNING
    assert check_line(with_axis(well_document, faults=[warning | {"active": False}]))[0] == Health.OK


def test_a_warning_bit_of_a_drive_is_a_warning_and_an_event() -> None:
    with operating() as (daemon, plc):
        assert check_line(snapshot(daemon))[0] is Health.OK
        drive_of(daemon).node.start_fault("warning-bit")
        judge_warning(daemon, plc, "Statusword.7 = 1")


def test_a_warning_of_an_encoder_is_a_warning_and_an_event() -> None:
    encoder = "[[encoder]]\ndo_id = 1\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
    with running(configuration(encoder)) as daemon:
        plc = Plc(daemon, [81])
        plc.endpoint.set(0, {"STW2_ENC": 0x400})
        plc.until(lambda: daemon.encoders[0].enable_status.state is AxisState.OBEYS, "in operation")
        encoder_of(daemon).node.start_fault("battery")
        judge_warning(daemon, plc, "6505h")


def judge_warning(daemon: Daemon, plc: Plc, word: str) -> None:
    """Both devices show the warning without an EMCY."""
    begin = daemon.events.newest
    plc.until(lambda: daemon.objects[0].outputs.warning, "the warning")
    plc.exchange(60)
    health, line = check_line(snapshot(daemon))
    assert health is Health.WARNING
    assert "1: warning of the device" in line
    assert word in line
    events = [event.text for event in daemon.events.after(begin) if event.kind == "warning"]
    assert events == [f"the device shows a warning ({word})"]


def test_a_drive_in_fault_is_critical() -> None:
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 1, "ready")
        assert check_line(snapshot(daemon))[0] == Health.OK
        drive_of(daemon).inject(7)
        plc.until(lambda: check_line(snapshot(daemon))[0] == Health.CRITICAL, "told")


def test_no_gateway_is_unknown() -> None:
    done = pdgw("status", "--check", "--port", str(free_tcp_port()))
    assert done.returncode == Health.UNKNOWN == 3
    assert done.stdout.startswith("UNKNOWN - no gateway answers")
    assert done.stderr == ""


def test_watch_queries_repeatedly(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    class EnoughError(Exception):
        """The user's Ctrl-C."""

    answers = iter(range(3))

    def pause(_: float) -> None:
        if next(answers) == 2:
            raise EnoughError

    monkeypatch.setattr("pdgw.tools.commands.gateway.status.time.sleep", pause)
    with pytest.raises(EnoughError):
        status(free_tcp_port(), watch=True, as_json=True)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert all("no gateway answers" in json.loads(line)["error"] for line in lines)


def test_watch_ends_with_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    def pause(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pdgw.tools.commands.gateway.status.time.sleep", pause)
    done = pdgw("status", "--watch", "--port", str(free_tcp_port()))
    assert "retry every second" in done.stdout
    assert done.returncode == 130
    assert "Traceback" not in done.stderr
