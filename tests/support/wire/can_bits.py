"""Bits of a CAN frame on the wire, with the stuff bits of its contents.

Source: Bosch CAN 2.0A chapters 3 (frame, CRC) and 5 (bit stuffing). Independent of ``ds301.bus.load``, which uses the worst case.
"""

from __future__ import annotations

from typing import Final

_CRC_POLYNOMIAL: Final = 0x4599
_CRC_BITS = 15
_SAME_BITS = 5
"""Number of equal bits before a stuff bit of the other value."""
_UNSTUFFED: Final = 1 + 2 + 7 + 3
"""CRC delimiter, acknowledge slot and delimiter, end of frame, interframe space."""


def bits_on_the_wire(can_id: int, data: bytes) -> int:
    """Bit times of a standard data frame, including the interframe space."""
    bits = [0, *_binary(can_id, 11), 0, 0, 0, *_binary(len(data), 4)]
    for byte in data:
        bits += _binary(byte, 8)
    bits += _binary(_crc(bits), _CRC_BITS)
    return len(bits) + _stuff_bits(bits) + _UNSTUFFED


def _binary(value: int, count: int) -> list[int]:
    return [value >> place & 1 for place in reversed(range(count))]


def _crc(bits: list[int]) -> int:
    register = 0
    for bit in bits:
        register = register << 1 ^ (_CRC_POLYNOMIAL if bit ^ register >> (_CRC_BITS - 1) else 0)
        register &= (1 << _CRC_BITS) - 1
    return register


def _stuff_bits(bits: list[int]) -> int:
    stuffed, last, same = 0, -1, 0
    for bit in bits:
        same = same + 1 if bit == last else 1
        last = bit
        if same == _SAME_BITS:
            stuffed += 1
            last, same = 1 - bit, 1
    return stuffed
