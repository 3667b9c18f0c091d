"""An axis of telegram 9 and one of 111 for each test of what both have."""

from __future__ import annotations

import pytest

from tests.support.axis.tasks import MAKES, Make, TaskHand


@pytest.fixture(params=MAKES.values(), ids=list(MAKES))
def make(request: pytest.FixtureRequest) -> Make:
    """Makes one before its first frame."""
    made: Make = request.param
    return made


@pytest.fixture
def hand(make: Make) -> TaskHand:
    """One in operation."""
    return make().enable()
