"""Configurations beyond what the running build was measured for, and the generated figures."""

from __future__ import annotations

import pytest

from pdgw.gateway.service.build import COMPILED, PURE
from pdgw.gateway.service.measured import PATH, beyond_measured
from pdgw.workshop.documents.measured import generate, rows

_MEASUREMENT = """
│ 1    │ 0.5 ms  │ echo    │ 81 us   │ 153 us  │ 292 us  │ 0.03 % │ 14141/s  │
│      │         │ gateway │ 129 us  │ 193 us  │ 317 us  │ 0.00 % │ 11648/s  │
│ 8    │ 1 ms    │ echo    │ 94 us   │ 150 us  │ 744 us  │ 0.04 % │ 11827/s  │
│      │         │ gateway │ 187 us  │ 308 us  │ 1000 us │ 0.10 % │ 7815/s   │
│ 4    │ 4 ms    │ echo    │ 105 us  │ 171 us  │ 199 us  │ 0.00 % │ 14673/s  │
│      │         │ gateway │ 200 us  │ 373 us  │ 577 us  │ 0.00 % │ 9769/s   │
│ 64   │ 4 ms    │ echo    │ 1 us    │ 1 us    │ 1 us    │ 0.00 % │ 1/s      │
│      │         │ gateway │ 657 us  │ 2046 us │ 4000 us │ 0.11 % │ 1153/s   │
"""


def test_a_row_counts_unless_cycles_are_missed_or_another_row_is_harder() -> None:
    assert rows(_MEASUREMENT) == [(1, 0.5), (8, 1.0)]


def test_the_figures_are_those_of_the_measurements() -> None:
    """``make docs`` writes them."""
    assert PATH.read_text(encoding="utf-8") == generate()


@pytest.mark.parametrize("build", [PURE, COMPILED])
def test_more_axes_or_a_shorter_cycle_than_measured_are_told(build: str) -> None:
    for axes, cycle_ms in ((1, 1), (8, 1), (4, 4), (32, 8)):
        assert beyond_measured(axes, cycle_ms, build) == ""
    assert beyond_measured(9, 1, build).startswith(f"9 axes at 1 ms: beyond what this build ({build}) was measured for")
    assert beyond_measured(1, 0.1, build).startswith("1 axis at 0.1 ms")
