"""The exhaustive walk of an axis in its short alphabet; ``make walk`` walks all choices and telegrams."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.workshop.walk.cases import Case, short

FIGURES = Path(__file__).parents[2] / "docs" / "walk.txt"


@pytest.mark.parametrize("case", list(short()), ids=lambda case: case.name)
def test_no_reachable_state_breaks_a_rule(case: Case) -> None:
    result = case.run()
    print(f"{case.name}: {result}")
    assert not result.violations, "\n".join(map(str, result.violations.values()))
    assert result.stuck is None
    assert f"{case.name}: {result}\n" in FIGURES.read_text(encoding="utf-8"), "run: make docs"
