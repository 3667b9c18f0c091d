"""Tables and sentences that people wrote in the documents and that repeat a declaration say what it says."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.settings import DriveSettings
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import drive_layout
from pdgw.gateway.config import AxisConfig
from pdgw.gateway.config_surroundings import TransportConfig
from pdgw.gateway.transport.cyclic import WATCHDOG_FACTOR
from pdgw.peers.drive.shapes import FAMILY
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.bench.stops import VIRTUAL
from tests.test_documents import ROOT

_INDEX = re.compile(r"\b([0-9A-F]{4})h(?:/(\d))?")


def rows(document: str, head: str) -> Iterator[list[str]]:
    """The cells of each row of the table whose head begins so."""
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    table = text.partition(f"\n| {head}")[2].partition("\n\n")[0]
    for line in table.splitlines()[2:]:
        yield [cell.strip() for cell in line.strip("|").split("|")]


def number_of(cell: str) -> int:
    found = re.match(r"\d+", cell)
    assert found is not None, cell
    return int(found[0])


LAYOUTS = list(rows("telegrams.md", "telegram | setpoints"))


def test_the_tables_are_found() -> None:
    assert len(LAYOUTS) > 10
    assert len(list(rows("translation.md", "telegram | RPDO"))) == 3
    assert len(list(rows("safety.md", "what is lost"))) >= len(VIRTUAL)


@pytest.mark.parametrize("row", LAYOUTS, ids=lambda row: row[0])
def test_the_layouts_are_those_of_the_declarations(row: list[str]) -> None:
    declared = telegram(number_of(row[0]))
    for half, signals, words in ((declared.setpoints, row[1], row[2]), (declared.actuals, row[3], row[4])):
        assert int(words) * 2 == half.size
        if signals != "see below":
            assert tuple(re.sub(r"\(\d\)", "", signals).split(", ")) == half.names


@pytest.mark.parametrize("row", list(rows("translation.md", "telegram | RPDO")), ids=lambda row: row[0])
def test_the_pdos_are_those_of_the_declarations(row: list[str]) -> None:
    """What goes by SDO in any case is told behind the last PDO."""

    def addresses(pdo: Pdo) -> list[tuple[int, int]]:
        return [FAMILY.entries.get(entry.attribute, entry).address for entry in pdo.entries]

    layout = drive_layout(number_of(row[0]))
    for pdos, cell in ((layout.rpdos, row[1]), (layout.tpdos, row[2])):
        told = [part for part in re.split(r"; |, (?=\w+ by SDO)", cell) if not part.endswith("by SDO")]
        assert len(told) == len(pdos)
        for pdo, part in zip(pdos, told, strict=True):
            assert number_of(part) == pdo.number
            assert [(int(index, 16), int(sub or 0)) for index, sub in _INDEX.findall(part)] == addresses(pdo)


def test_the_bounds_of_the_stops_are_those_that_are_measured_against() -> None:
    told = {row[0]: (row[1], row[5]) for row in rows("safety.md", "what is lost")}
    for stop, _ in VIRTUAL:
        assert told[stop.cause] == (stop.measured, f"{stop.bound_ms:g} ms: {stop.bound}")


def test_the_defaults_in_sentences_are_the_defaults() -> None:
    transport, axis, node = TransportConfig(), AxisConfig(do_id=1, node_id=1, telegram=1), DriveSettings(1)
    defaults = (
        f"cycle {transport.cycle_time_ms:g} ms, watchdog {WATCHDOG_FACTOR} cycles, heartbeats {axis.heartbeat_ms} ms, "
        f"TPDO event timer {axis.tpdo_event_ms} ms, refresh {node.rpdo_refresh_ms} ms; "
        f'`on_plc_loss = "{AxisSettings().on_plc_loss.value}"`'
    )
    assert defaults in (ROOT / "docs/safety.md").read_text(encoding="utf-8")
    assert f"watchdog factor ({WATCHDOG_FACTOR}) x cycle" in (ROOT / "docs/translation.md").read_text(encoding="utf-8")
    assert f"`watchdog_factor = {WATCHDOG_FACTOR}`" in (ROOT / "docs/demo.md").read_text(encoding="utf-8")


def test_the_keys_of_the_units_are_keys_of_an_axis() -> None:
    keys = [row[0].strip("`") for row in rows("units.md", "key | is")]
    assert len(keys) > 5
    assert {*keys} <= {*AxisConfig.model_fields}
