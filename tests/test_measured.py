"""The figures the documents quote are those of ``docs/measured``, with date, build and machine."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.test_documents import DOCUMENTS

DOCS = Path(__file__).parents[1] / "docs"
MEASURED = sorted((DOCS / "measured").iterdir())
_HEAD = re.compile(
    r"\d{4}-\d\d-\d\d, pdgw \d+\.\d+\.\d+\S*, .*(?:pure Python|compiled).*, C?Python 3\.\d+\S*, .+, \d+ cores, "
    r"(?:usual|real-time) priority.*"
)
_FIGURE = re.compile(r"\d (?:us|MiB)\b|\d times (?:the echo|faster)|\d(?:\.\d)? x as|% of a core")


class Quote(NamedTuple):
    """Figures in a document, and where they come from: the groups of both patterns are the same numbers, rounded as quoted."""

    document: str
    quoted: str
    file: str
    measured: str


def _ratio(axes: int, cycle: str) -> str:
    """The p50 of the gateway over that of the echo, in a row of the exchange."""
    return rf"│ {axes} +│ {cycle} +│ echo .*\n(?:│ +│ +│ (?:echo|gateway|to CAN).*\n)+│ +│ +│ ratio +│ ([\d.]+) "


def _median(axes: int, cycle: str) -> str:
    """The p50 of the gateway in microseconds, in a row of the exchange."""
    return rf"│ {axes} +│ {cycle} +│ echo .*\n│ +│ +│ gateway +│ (\d+) us"


_SHARE = r"│ 1 ms +│ gateway +│ ([\d.]+) %"
"""Of a core, at 1 ms; in the first table of the file that has one, which is that of usual priority."""

QUOTES = [
    Quote("benchmarks.md", r"one axis at 1 ms ([\d.]+) times the echo", "exchange-realtime.txt", _ratio(1, "1 ms")),
    Quote("benchmarks.md", r"eight ([\d.]+); a storm", "exchange-realtime.txt", _ratio(8, "1 ms")),
    Quote("benchmarks.md", r"Compiled: ([\d.]+) and", "exchange-compiled-realtime.txt", _ratio(1, "1 ms")),
    Quote("benchmarks.md", r"Compiled: [\d.]+ and ([\d.]+);", "exchange-compiled-realtime.txt", _ratio(8, "1 ms")),
    Quote("benchmarks.md", r"16 axes at 2 ms (\d+) us", "exchange-compiled-realtime.txt", _median(16, "2 ms")),
    Quote(
        "benchmarks.md",
        r"at 4 ms (\d+) and (\d+) us",
        "exchange-compiled-realtime.txt",
        rf"{_median(32, '4 ms')}[\s\S]*{_median(64, '4 ms')}",
    ),
    Quote("benchmarks.md", r"at usual priority ([\d.]+) % of a core", "profinet.txt", _SHARE),
    Quote("benchmarks.md", r"% of a core, compiled ([\d.]+) %", "profinet-compiled.txt", _SHARE),
    Quote(
        "flight-recorder.md",
        r"A cycle costs ([\d.]+) us and ([\d.]+) us for each axis, a CAN frame ([\d.]+) us",
        "exchange-realtime.txt",
        r"flight recorder: ([\d.]+) us a cycle and ([\d.]+) us an axis, ([\d.]+) us a CAN frame",
    ),
]
GOALS = {
    "benchmarks.md": (r"Not reached: 0.1 % missed at 250 us [^.]*250 us with 32 axes",),
    "safety.md": (r"at most 1 MiB",),
    "soak.md": (r"16 MiB after the first hour",),
    "timeline.md": (r"more than 20 times faster",),
    "transport.md": (r"31\.25 us",),
}
"""Figures other than measurements: goals, limits, facts of a protocol."""


@pytest.mark.parametrize("path", MEASURED, ids=lambda path: path.name)
def test_measurements_have_date_build_and_machine(path: Path) -> None:
    assert _HEAD.fullmatch(path.read_text(encoding="utf-8").splitlines()[0])


@pytest.mark.parametrize("quote", QUOTES, ids=lambda quote: f"{quote.document}: {quote.quoted[:24]}")
def test_a_quoted_figure_is_the_measured_one(quote: Quote) -> None:
    quoted = re.search(quote.quoted, (DOCS / quote.document).read_text(encoding="utf-8"))
    measured = re.search(quote.measured, (DOCS / "measured" / quote.file).read_text(encoding="utf-8"))
    assert quoted is not None
    assert measured is not None
    for said, found in zip(quoted.groups(), measured.groups(), strict=True):
        assert said == f"{float(found):.{len(said.partition('.')[2])}f}"


def test_documented_goals_are_reached() -> None:
    timeline = (DOCS / "measured" / "timeline.txt").read_text(encoding="utf-8")
    speed = re.search(r"(\d+) x as fast as real time \(goal (\d+)\); first line after ([\d.]+) s", timeline)
    assert speed is not None
    assert int(speed[1]) > int(speed[2]) == 20
    assert float(speed[3]) < 1
    exchange = (DOCS / "measured" / "exchange-realtime.txt").read_text(encoding="utf-8")
    quiet, storm = re.findall(r"│ (?:quiet|\d+ requests/s) +│.*│ ([\d.]+) % │", exchange)
    assert float(storm) <= float(quiet)


def test_every_figure_in_a_document_is_measured() -> None:
    for path in DOCUMENTS:
        text = path.read_text(encoding="utf-8")
        patterns = (*(quote.quoted for quote in QUOTES if quote.document == path.name), *GOALS.get(path.name, ()))
        for known in [re.search(pattern, text) for pattern in patterns]:
            assert known is not None, f"{path.name}: one of {patterns}"
            text = text.replace(known[0], "")
        found = _FIGURE.search(text)
        if path.name not in {"tables.md", "CHANGELOG.md"}:
            assert found is None, f"{path.name}: ...{text[max(0, found.start() - 60) : found.end()]}"
