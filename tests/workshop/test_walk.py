"""The exhaustive walk of an axis in its short alphabet; ``make walk`` walks all choices and telegrams."""

from __future__ import annotations

import pytest

from pdgw.workshop.walk.cases import Case, short


@pytest.mark.parametrize("case", short(), ids=lambda case: case.name)
def test_no_reachable_state_breaks_a_rule(case: Case) -> None:
    result = case.run()
    print(f"{case.name}: {result}")
    assert not result.violations, "\n".join(map(str, result.violations.values()))
    assert result.stuck is None
    assert result.machine_states > 500
