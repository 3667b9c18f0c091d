"""What of the scaling each telegram needs."""

from __future__ import annotations

import pytest

from pdgw.dsp402.drive_type import Quantity
from pdgw.gateway.needs import needed_quantities
from pdgw.profidrive.telegrams import telegram

SPEED = (Quantity.SPEED,)


@pytest.mark.parametrize(
    ("number", "needed"),
    [(1, SPEED), (2, SPEED), (3, SPEED), (20, SPEED), (100, SPEED), (9, tuple(Quantity))],
)
def test_a_telegram_needs_only_what_its_signals_are_fractions_of(number: int, needed: tuple[Quantity, ...]) -> None:
    assert needed_quantities(telegram(number)) == needed
