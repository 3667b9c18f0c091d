"""``python -m tests.room_tests [ROOM ...]``: for a change in a room, the tests to run first, and the CPU seconds that they need.

The seconds are those of the last runs on this machine with ``python -m pytest -p tests.cpu_times``.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from tests.cpu_times import CACHE
from tests.test_package_imports import ROWS, room_of

ROOT: Final = Path(__file__).parents[1]
ALWAYS: Final = "tests/test_package_imports.py tests/test_language.py tests/test_names.py"
"""For a change anywhere, beside ``make lint``."""
TESTS: Final = {
    "base": "tests/gateway/configuration tests/gateway/test_log_budget.py tests/test_package.py",
    "profidrive": "tests/profidrive tests/test_published_layouts.py tests/gateway/axis/test_telegram_signals.py",
    "profinet": "tests/profinet tests/decoder/frames/profinet tests/gateway/links/profinet",
    "ds301": "tests/ds301 tests/dsp402 tests/dsp406 tests/gateway/test_bus_room.py",
    "dsp402": "tests/dsp402 tests/gateway/axis/supervision tests/gateway/test_shapes_driven.py",
    "dsp406": "tests/dsp406 tests/gateway/axis/test_encoder.py tests/conformance/test_encoder_faults.py",
    "gateway.base": "tests/gateway/objects tests/gateway/axis/test_status_words.py",
    "gateway.motion": "tests/gateway/motion tests/gateway/axis tests/long/test_walk_handshakes.py",
    "gateway.axis": "tests/gateway/axis tests/long/test_walk.py tests/decoder/replay tests/long/test_bench.py",
    "gateway.configuration": "tests/gateway/configuration tests/gateway/commissioning",
    "gateway.objects": "tests/gateway/objects tests/gateway/service tests/decoder/replay tests/long/test_bench.py",
    "gateway.links": "tests/gateway/links tests/gateway/test_losses.py tests/long/test_bench.py",
    "gateway.service": "tests/gateway/service tests/tools/test_status.py",
    "gateway.trace": "tests/gateway/trace tests/decoder/replay tests/formats tests/long/test_bench.py",
    "gateway.parameters": "tests/gateway/parameters tests/tools/test_param.py tests/tools/test_device.py",
    "gateway.commissioning": "tests/gateway/commissioning tests/tools/test_bus.py tests/tools/test_axis_test.py",
    "gateway.client": "tests/gateway/parameters tests/tools/test_param.py",
    "gateway.daemon": "tests/gateway tests/decoder/replay tests/long/test_bench.py",
    "peers": "tests/peers tests/conformance",
    "tools": "tests/tools tests/decoder tests/recording tests/web tests/test_documents.py tests/test_loading.py",
}
"""Each room with its tests."""


def rooms() -> set[str]:
    """The rooms of the table of imports that have modules."""
    return {room_of(package) for package in ROWS} - {"gateway"}


def lines(kept: Mapping[str, float], chosen: list[str]) -> Iterator[str]:
    """A line for each room. ``kept``: CPU seconds by file of tests; a room with a file that was not run yet has none."""
    for room, tests in [("any room", ALWAYS), *TESTS.items()]:
        if not chosen or room in chosen:
            files = [str(file.relative_to(ROOT)) for path in tests.split() for file in _files(ROOT / path)]
            known = all(file in kept for file in files)
            spent = f"{sum(kept[file] for file in files):.0f} s" if known else "-"
            yield f"{room:22} {spent:>6}  pytest {tests}"


def _files(path: Path) -> list[Path]:
    return sorted(path.rglob("test_*.py")) if path.is_dir() else [path]


if __name__ == "__main__":
    stored = ROOT / ".pytest_cache" / "v" / CACHE
    for line in lines(json.loads(stored.read_text()) if stored.exists() else {}, sys.argv[1:]):
        print(line)
