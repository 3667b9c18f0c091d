"""No OFF switches a drive on: a standing stop, a Statusword that is late, every telegram.

A selection is part of the suite; ``make long LONG=limit-cycles`` runs every delay from 0 to 100 ms.
"""

from __future__ import annotations

import os

import pytest

from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from tests.support.axis.limit_cycle import TRANSPARENT, search

EVERY = "PDGW_LIMIT_CYCLES" in os.environ
CYCLES_MS = (1, 2, 4, 16)
SELECTED = {1: (4,), 9: (2,), TRANSPARENT: (4,), 105: (4,), 111: (16,)}
"""Telegrams and cycle times of the suite: one of each kind of executor."""


@pytest.mark.parametrize(
    ("number", "cycle_ms"),
    [
        (number, cycle)
        for number in DRIVE_TELEGRAM_NUMBERS
        for cycle in (CYCLES_MS if EVERY else SELECTED.get(number, ()))
    ],
)
def test_standing_off_never_enables_a_drive_with_late_statusword(number: int, cycle_ms: int) -> None:
    assert search(number, cycle_ms, range(101) if EVERY else (5, 20, 60)) == []
