"""What is counted is shown: with a name, a unit and a meaning."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from pdgw.ds301.counters import Counters
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.service.status import snapshot
from tests.support.gateways.daemon import axis, configuration

_ROOT = Path(__file__).parents[2]
_EDGE = ("ds301/bus/network.py", "ds301/loop/loop.py", "gateway/daemon.py", "gateway/links", "gateway/links/profinet")


def test_a_counter_reads_what_its_part_counts_now() -> None:
    counters = Counters()
    seen = [1]
    counters.add("bus can0", "sent", "frames", "accepted by the interface", lambda: seen[0])
    seen[0] = 7
    assert counters.values() == [
        {"part": "bus can0", "name": "sent", "value": 7, "unit": "frames", "meaning": "accepted by the interface"}
    ]


def test_status_lists_every_counter_with_unit_and_meaning() -> None:
    daemon = build_gateway(configuration(axis(1, more="")))
    try:
        listed = snapshot(daemon)["counters"]
    finally:
        daemon.release()
    names = {(item["part"], item["name"]) for item in listed}
    assert {("bus can", "sent"), ("link", "accepted"), ("link", "stale"), ("records", "malformed")} <= names
    assert len(names) == len(listed)
    assert all(item["unit"] and item["meaning"] and item["value"] >= 0 for item in listed)


def _modules() -> list[Path]:
    found: list[Path] = []
    for place in _EDGE:
        path = _ROOT / place
        found += sorted(path.glob("*.py")) if path.is_dir() else [path]
    return found


@pytest.mark.parametrize("path", _modules(), ids=lambda path: path.name)
def test_nothing_public_is_counted_and_not_registered(path: Path) -> None:
    registered = "\n".join(module.read_text() for module in _modules())
    for node in ast.walk(ast.parse(path.read_text())):
        # A sum of times does not count anything.
        if (
            isinstance(node, ast.AugAssign)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.target, ast.Attribute)
        ):
            name = node.target.attr
            assert name.startswith("_") or f'"{name}"' in registered, f"{path.name}: {name} is counted, never shown"
