"""Who may import whom: the product never imports what plays the other side, nor the tools."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from pdgw.profidrive.signals import SIGNALS

ROOT = Path(__file__).parent.parent
PRODUCT = ("profidrive", "profinet", "ds301", "dsp402", "dsp406", "gateway")


@cache
def imports(file: Path) -> frozenset[str]:
    """Every module a file imports, wherever in it."""
    return frozenset(_imports(file))


def _imports(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


def importers(room: str, *forbidden: str) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    files = list((ROOT / room).rglob("*.py"))
    assert files
    for file in files:
        wrong = [name for name in imports(file) for other in forbidden if f"{name}.".startswith(f"pdgw.{other}.")]
        if wrong:
            found[str(file.relative_to(ROOT))] = wrong
    return found


@pytest.mark.parametrize("room", PRODUCT)
def test_no_room_of_the_product_imports_peers_tools_or_decoder(room: str) -> None:
    assert importers(room, "peers", "tools", "decoder") == {}


def test_the_daemon_and_what_it_consists_of_know_no_page_metrics_or_mqtt() -> None:
    assert importers("gateway", "web") == importers("decoder", "web") == importers("peers", "web") == {}
    for room in (*PRODUCT, "decoder", "peers"):
        names = {name.partition(".")[0] for file in (ROOT / room).rglob("*.py") for name in imports(file)}
        assert not names & {"starlette", "uvicorn", "prometheus_client", "paho"}, room


def test_the_page_knows_no_command_and_nobody_who_plays_the_other_side() -> None:
    assert importers("web", "tools", "peers") == {}


@pytest.mark.parametrize("room", [*PRODUCT, "decoder", "web", "peers", "tools"])
def test_nobody_imports_the_workshop(room: str) -> None:
    assert importers(room, "workshop") == {}


def test_the_monitor_of_the_walk_knows_neither_power_table_nor_interlock() -> None:
    known = imports(ROOT / "workshop" / "walk" / "monitor.py")
    assert not [name for name in known if name.endswith(("power_table", "interlock"))]


def test_what_tests_share_knows_none_of_the_tests() -> None:
    shared = {name for file in (ROOT / "tests" / "support").rglob("*.py") for name in imports(file)}
    of_tests = {name for name in shared if name.startswith("tests.") and not name.startswith("tests.support")}
    assert of_tests == set()


@pytest.mark.parametrize("room", ["ds301", "dsp402", "dsp406"])
def test_the_rooms_of_canopen_have_no_word_of_profidrive(room: str) -> None:
    """Signals without a number are telegram 100's, which have the names of objects."""
    words = {name for name, signal in SIGNALS.items() if signal.number} | {"N2", "N4", "PNU", "NSOLL", "NIST", "DO-ID"}
    found = {
        (str(file.relative_to(ROOT)), word)
        for file in (ROOT / room).rglob("*.py")
        for word in re.findall(r"[A-Z][A-Z0-9_-]+", file.read_text(encoding="utf-8"))
        if word in words
    }
    assert found == set()


def test_the_search_finds_what_is_there() -> None:
    assert "tools/commands/sim_drive.py" in importers("tools", "peers")


def test_what_pydantic_finds_wrong_is_worded_in_one_place() -> None:
    """Whoever catches a ValidationError hands it to ``pdgw.explain``; ``error_count`` alone needs no words."""
    catching = [
        file
        for room in (*PRODUCT, "decoder", "web", "peers", "tools")
        for file in (ROOT / room).rglob("*.py")
        if "except ValidationError" in file.read_text(encoding="utf-8")
    ]
    assert len(catching) > 5
    for file in catching:
        text = file.read_text(encoding="utf-8")
        assert "pdgw.explain" in imports(file), file
        assert ".errors()" not in text, file


@pytest.mark.parametrize("module", ["explain", "durations"])
def test_what_every_room_may_import_belongs_to_none(module: str) -> None:
    assert not [name for name in imports(ROOT / "pdgw" / f"{module}.py") if name.startswith("pdgw")]


def test_units_of_time_stand_in_one_place() -> None:
    """Nobody reckons with nanoseconds of a millisecond or a second that are spelled out."""
    spelled_out = re.compile(r"[*/%] (1e[69]|1_000_000|1_000_000_000|10\*\*[69])\b")
    found = [
        (str(file.relative_to(ROOT)), line.strip())
        for room in (*PRODUCT, "decoder", "web", "peers", "tools")
        for file in (ROOT / room).rglob("*.py")
        for line in file.read_text(encoding="utf-8").splitlines()
        if spelled_out.search(line)
    ]
    assert found == []
