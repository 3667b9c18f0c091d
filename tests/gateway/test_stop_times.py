"""Time from a stop in the PLC, and from its death, to the Controlword on CAN; the table of docs/safety.md."""

from __future__ import annotations

import re

import pytest

from pdgw.durations import MS
from tests.support.documents.parts import read_part
from tests.support.documents.stop_times import BUSES, LINKS, PLACE, Link, Row, measure


@pytest.mark.parametrize("link", LINKS, ids=lambda link: link.name)
@pytest.mark.parametrize("cycle_ms", [4, 16])
def test_stops_reach_a_full_bus_within_their_bounds(link: Link, cycle_ms: int) -> None:
    row = measure(link, cycle_ms, 2)
    assert row.stop_ns <= row.stop_bound_ns
    assert row.death_ns <= row.death_bound_ns


def test_the_document_has_all_times_within_their_bounds() -> None:
    cells = r"\| (\d+) ms \| ([\d.]+) ms \| ([\d.]+) ms \|"
    text = read_part(*PLACE)
    for link in LINKS:
        found = re.findall(rf"\| {re.escape(link.name)} {cells}", text)
        assert [int(cycle) for cycle, _, _ in found] == list(BUSES)
        for cycle, stop, death in found:
            row = Row(link, int(cycle), round(float(stop) * MS), round(float(death) * MS))
            assert row.stop_ns <= row.stop_bound_ns
            assert row.death_ns <= row.death_bound_ns
