"""Few tests have processes or the wall clock: they are what is slow, and what a busy machine disturbs."""

from __future__ import annotations

import pytest

from tests.conftest import is_real

AT_MOST = 40
ON_THEIR_OWN = {"tour", "can"}
"""Folders that ``make test`` does not run."""


def test_number_of_tests_with_processes_or_real_time_is_limited(request: pytest.FixtureRequest) -> None:
    real = [item for item in request.session.items if is_real(item) and item.path.parent.name not in ON_THEIR_OWN]
    assert len(real) <= AT_MOST, (
        "too many tests are marked e2e or browser: play it in virtual time (World), in this process (tests/support/cli.py), "
        "or beside what another test has started"
    )
