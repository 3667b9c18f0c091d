"""The tables of the published guides, written by hand, and what the product declares: telegrams, PDOs, states."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.states import STATUS_PATTERNS
from pdgw.gateway.axis.adapters.transparent import ACTUAL_ATTRIBUTES, SETPOINT_ATTRIBUTES
from pdgw.gateway.axis.telegrams import drive_layout
from pdgw.peers.drive.model.shapes import FAMILY
from pdgw.profidrive.telegrams import telegram
from tests.support.documents.profile_numbers import word_positions

PUBLISHED = (Path(__file__).parent / "support/documents/published_tables.md").read_text(encoding="utf-8")
_INDEX = re.compile(r"\b([0-9A-F]{4})h(?:/(\d))?")


def rows(head: str) -> Iterator[list[str]]:
    """The cells of each row of the table with this head."""
    table = PUBLISHED.partition(f"\n| {head}")[2].partition("\n\n")[0]
    for line in table.splitlines()[2:]:
        yield [cell.strip() for cell in line.strip("|").split("|")]


def number_of(cell: str) -> int:
    found = re.match(r"\d+", cell)
    assert found is not None, cell
    return int(found[0])


LAYOUTS = list(rows("telegram | setpoints"))


def test_the_tables_are_found() -> None:
    assert len(LAYOUTS) > 10
    assert len(list(rows("telegram | RPDO"))) == 3


@pytest.mark.parametrize("row", LAYOUTS, ids=lambda row: row[0])
def test_the_layouts_are_those_of_the_declarations(row: list[str]) -> None:
    declared = telegram(number_of(row[0]))
    for half, signals, words in ((declared.setpoints, row[1], row[2]), (declared.actuals, row[3], row[4])):
        assert int(words) * 2 == half.size
        if signals != "see below":
            assert tuple(re.sub(r"\(\d\)", "", signals).split(", ")) == half.names


@pytest.mark.parametrize("row", list(rows("telegram | RPDO")), ids=lambda row: row[0])
def test_the_pdos_are_those_of_the_declarations(row: list[str]) -> None:
    """Objects that are always written by SDO are listed after the last PDO."""

    def addresses(pdo: Pdo) -> list[tuple[int, int]]:
        return [FAMILY.entries.get(entry.attribute, entry).address for entry in pdo.entries]

    layout = drive_layout(telegram(number_of(row[0])))
    for pdos, cell in ((layout.rpdos, row[1]), (layout.tpdos, row[2])):
        told = [part for part in re.split(r"; |, (?=\w+ by SDO)", cell) if not part.endswith("by SDO")]
        assert len(told) == len(pdos)
        for pdo, part in zip(pdos, told, strict=True):
            assert number_of(part) == pdo.number
            assert [(int(index, 16), int(sub or 0)) for index, sub in _INDEX.findall(part)] == addresses(pdo)


def test_each_word_of_telegram_100_is_the_object_of_its_signal() -> None:
    """``4-5``, ``Target Position 607Ah i32``: place, name, address and type; the mode of operation is a byte of its word."""
    manufacturer = telegram(100)
    entries = {entry.attribute: entry for entry in DRIVE_OBJECTS.entries} | dict(FAMILY.entries)
    told = list(rows("word | setpoint |"))
    for half, attributes, column in (
        (manufacturer.setpoints, SETPOINT_ATTRIBUTES, 0),
        (manufacturer.actuals, ACTUAL_ATTRIBUTES, 2),
    ):
        expected = []
        for item, attribute, word in zip(half.signals, attributes, word_positions(half), strict=True):
            entry = entries[attribute]
            place = f"{word}-{word + item.words - 1}" if item.words > 1 else f"{word}"
            expected.append((place, (entry.index, entry.subindex), entry.type.name.lower()))
        found = []
        for row in told:
            place, text = row[column : column + 2]
            if place:
                match = re.search(r"([0-9A-F]{4})h(?: sub (\d))?(?: \(mask\))? ([iu]\d+)", text)
                assert match is not None, text
                found.append((place, (int(match[1], 16), int(match[2] or 0)), match[3]))
        assert found == expected


def test_the_states_have_the_patterns_that_are_read() -> None:
    patterns: dict[str, set[str]] = {}
    for pattern in STATUS_PATTERNS:
        bits = "".join("x" if not pattern.mask >> n & 1 else str(pattern.value >> n & 1) for n in range(7, -1, -1))
        patterns.setdefault(pattern.state.value.lower(), set()).add(f"{bits[:4]} {bits[4:]}")
    table = list(rows("state (PROFIdrive"))
    assert len(table) == len(patterns)
    for name, actual, statusword in table:
        told = statusword if statusword != "same" else actual.removeprefix("xxxx xxxx ")
        assert told in patterns[name.rpartition(" / ")[2]], name
