"""What the page has to know to show words by name and by bit, taken from the declarations: nothing is said twice."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from pdgw.gateway.reasons import AxisState
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, Telegram, TelegramHalf, telegram

SYMBOLS = {
    AxisState.OBEYS: "●",
    AxisState.OFF: "○",
    AxisState.STARTING: "◌",
    AxisState.WAITS: "▲",
    AxisState.STOPPING: "▲",
    AxisState.FAULT: "■",
    AxisState.NOT_ON_THE_BUS: "■",
}
"""Shown before the word of a state: what colour says is also said without."""


def _signal(signal: Signal, *, positioning: bool) -> dict[str, Any]:
    return {
        "name": signal.name,
        "description": signal.description,
        "digits": 2 * signal.type.size,
        "bits": [
            {"position": bit.position, "width": bit.width, "name": bit.name, "meaning": bit.meaning}
            for bit in signal.fields(positioning=positioning)
        ],
    }


def _half(half: TelegramHalf) -> list[dict[str, Any]]:
    return [_signal(signal, positioning=half.mode is ApplicationMode.POSITIONING) for signal in half.signals]


def _document(chosen: Telegram) -> dict[str, Any]:
    return {
        "number": chosen.number,
        "setpoints": _half(chosen.setpoints),
        "actuals": _half(chosen.actuals),
    }


@lru_cache(maxsize=len(TELEGRAMS))
def telegram_document(number: int) -> dict[str, Any]:
    """The words of a telegram with their bits and units; ProfidriveError for one that does not exist."""
    return _document(telegram(number))


def states_document() -> dict[str, dict[str, str]]:
    """Word and symbol of each state, by its name."""
    return {state.name: {"text": state.value, "symbol": symbol} for state, symbol in SYMBOLS.items()}
