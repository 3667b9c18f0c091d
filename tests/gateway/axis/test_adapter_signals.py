"""Every signal of a telegram is read or written. An actual value without a writer would be 0 with a good IOPS."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.gateway.axis.adapters.encoder_words import EncoderAdapter
from pdgw.gateway.axis.adapters.speed_words import SpeedAdapter
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS, ENCODER_TELEGRAM_NUMBERS, make_adapter
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Telegram, telegram
from tests.support.axis.positioner import CHOICES

_SETTINGS = AxisSettings(positioner=replace(CHOICES, lu_per_unit=1000))


def with_actual(number: int, name: str) -> Telegram:
    chosen = telegram(number)
    return replace(chosen, actuals=replace(chosen.actuals, signals=(*chosen.actuals.signals, signal(name))))


@pytest.mark.parametrize("number", DRIVE_TELEGRAM_NUMBERS)
def test_adapter_serves_every_signal_of_its_telegram(number: int) -> None:
    make_adapter(number, _SETTINGS)


def test_speed_adapter_refuses_a_telegram_with_a_position() -> None:
    """Telegram 8, as someone may add it in two lines of data."""
    with pytest.raises(GatewayError, match="telegram 3: SpeedAdapter neither reads nor writes XIST_A"):
        SpeedAdapter(with_actual(3, "XIST_A"), _SETTINGS).check()


@pytest.mark.parametrize("number", ENCODER_TELEGRAM_NUMBERS)
def test_encoder_adapter_refuses_a_signal_that_it_does_not_serve(number: int) -> None:
    EncoderAdapter(telegram(number))
    with pytest.raises(GatewayError, match="neither reads nor writes MIST_GLATT"):
        EncoderAdapter(with_actual(number, "MIST_GLATT"))
