"""The words of a telegram as the standard numbers them."""

from __future__ import annotations

from pdgw.profidrive.telegrams import TelegramHalf


def word_positions(half: TelegramHalf) -> tuple[int, ...]:
    """First word number (counted from 1, as in the standard) of every signal."""
    positions = []
    word = 1
    for item in half.signals:
        positions.append(word)
        word += item.words
    return tuple(positions)
