"""Which translator, PDO layout and start mode belong to a telegram."""

from __future__ import annotations

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.pdo import Operation
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.translator.base import Translator, TranslatorSettings
from pdgw.gateway.translator.encoder import EncoderTranslator, EncoderTranslatorSettings
from pdgw.gateway.translator.positioning import PositioningTranslator
from pdgw.gateway.translator.transparent import TransparentTranslator
from pdgw.gateway.translator.velocity import VelocityTranslator
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, telegram

_DRIVE_TELEGRAMS: dict[int, tuple[type[Translator], Operation, Mode | None]] = {
    1: (VelocityTranslator, Operation.VELOCITY, Mode.VELOCITY),
    2: (VelocityTranslator, Operation.VELOCITY, Mode.VELOCITY),
    3: (VelocityTranslator, Operation.VELOCITY_WITH_POSITION, Mode.VELOCITY),
    20: (VelocityTranslator, Operation.VELOCITY, Mode.VELOCITY),
    9: (PositioningTranslator, Operation.POSITIONING, None),
    100: (TransparentTranslator, Operation.TRANSPARENT, None),
}

DRIVE_TELEGRAM_NUMBERS = tuple(sorted(_DRIVE_TELEGRAMS))
"""The telegrams a drive axis can be given (P922)."""

ENCODER_TELEGRAM_NUMBERS = tuple(
    sorted(number for number, item in TELEGRAMS.items() if item.mode is ApplicationMode.ENCODER)
)
"""The telegrams an encoder can be given (P922)."""


def _row(number: int) -> tuple[type[Translator], Operation, Mode | None]:
    try:
        return _DRIVE_TELEGRAMS[number]
    except KeyError:
        raise GatewayError(
            f"telegram: {number} is not supported for a drive, allowed {list(DRIVE_TELEGRAM_NUMBERS)}"
        ) from None


def make_translator(number: int, settings: TranslatorSettings) -> Translator:
    """The translator of a drive telegram; GatewayError for one that no drive axis supports."""
    return _row(number)[0](telegram(number), settings)


def make_encoder_translator(number: int, settings: EncoderTranslatorSettings) -> EncoderTranslator:
    """The translator of an encoder telegram; GatewayError for another one."""
    if number not in ENCODER_TELEGRAM_NUMBERS:
        raise GatewayError(
            f"telegram: {number} is not supported for an encoder, allowed {list(ENCODER_TELEGRAM_NUMBERS)}"
        )
    return EncoderTranslator(telegram(number), settings)


def pdo_operation(number: int) -> Operation:
    """The PDO layout a drive telegram needs."""
    return _row(number)[1]


def initial_mode(number: int) -> Mode | None:
    """6060h to set while configuring, None where the telegram's RPDO carries the mode."""
    return _row(number)[2]
