"""``pdgw status``: values, ages and times of faults, folded and never cut."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import pytest

from pdgw.gateway.service.status import snapshot
from pdgw.profidrive.signal_text import texts
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.output.status_text import duration, object_lines, status_lines
from tests.support.gateways.daemon import SIMULATED_POSITIONER, axis, configuration, running, until


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
