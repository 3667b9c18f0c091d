"""Telegram words to signals with units and bits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import ApplicationMode, TelegramHalf


def signal_document(item: Signal, raw: int, *, positioning: bool = False) -> dict[str, Any]:
    """One signal: raw value, value in its unit (percent for N2/N4), unit and named bits."""
    percent = item.percent(raw)
    return {
        "raw": raw,
        "value": item.value_of(raw) if percent is None else percent,
        "unit": item.unit,
        "bits": {bit.name: bit.of(raw) for bit in item.fields(positioning=positioning)},
    }


def signals_document(half: TelegramHalf, values: Sequence[int]) -> dict[str, dict[str, Any]]:
    """All signals of one telegram direction by name, in telegram order."""
    positioning = half.mode is ApplicationMode.POSITIONING
    return {
        item.name: signal_document(item, raw, positioning=positioning)
        for item, raw in zip(half.signals, values, strict=True)
    }
