"""The exhaustive walk of an axis in its short alphabet; ``make long LONG=walk`` walks all choices and telegrams."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.profidrive.telegrams import TELEGRAMS
from tests.long.walk.cases import NOT_WALKED, Case, every, short

FIGURES = Path(__file__).parents[2] / "docs" / "walk.txt"


@pytest.mark.parametrize("case", list(short()), ids=lambda case: case.name)
def test_no_reachable_state_breaks_a_rule(case: Case) -> None:
    result = case.run()
    print(f"{case.name}: {result}")
    assert not result.violations, "\n".join(result.traces())
    assert f"{case.name}: {result}\n" in FIGURES.read_text(encoding="utf-8"), "run: make docs"


def test_every_telegram_is_walked_or_has_a_reason_not_to_be() -> None:
    walked = {case.number for case in every()}
    assert walked.isdisjoint(NOT_WALKED)
    assert walked | set(NOT_WALKED) == set(TELEGRAMS)
