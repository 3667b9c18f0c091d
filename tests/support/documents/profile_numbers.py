"""Numbers as the tables of the profile have them: sensors of P979, words of a telegram. The declarations have their own."""

from __future__ import annotations

from collections.abc import Sequence

from pdgw.profidrive.sensor_format import SensorFormat
from pdgw.profidrive.telegrams import TelegramHalf


def decode_sensor_format(elements: Sequence[int]) -> tuple[SensorFormat, ...]:
    """The sensors of a P979 value; the header says how many, with five elements each (structure version 1.2)."""
    header = elements[0]
    assert header & 0xF0FF == 0x5012
    sensors = []
    for start in range(1, 1 + 5 * (header >> 8 & 0xF), 5):
        kind, resolution, shift_xist1, shift_xist2, turns = elements[start : start + 5]
        linear, absolute, wide, static, validity_static, valid = (
            bool(kind >> bit & 1) for bit in (0, 1, 2, 29, 30, 31)
        )
        sensors.append(
            SensorFormat(
                resolution, turns, shift_xist1, shift_xist2, linear, absolute, wide, static, validity_static, valid
            )
        )
    return tuple(sensors)


# The words of a telegram as the standard numbers them.


def word_positions(half: TelegramHalf) -> tuple[int, ...]:
    """First word number (counted from 1, as in the standard) of every signal."""
    positions = []
    word = 1
    for item in half.signals:
        positions.append(word)
        word += item.words
    return tuple(positions)
