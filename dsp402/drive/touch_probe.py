"""The touch probe of a drive: positions latched at an edge of a probe or at the zero pulse of its encoder.

Source: CiA 402-2 (60B8h touch probe function, 60B9h status, 60BAh to 60BDh positions). Left out: continuous mode, sources by
60D0h.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

FUNCTION: Final = 0x60B8
STATUS: Final = 0x60B9
POSITIONS: Final = (0x60BA, 0x60BB, 0x60BC, 0x60BD)
"""Probe 1 rising and falling, probe 2 rising and falling: edges 0 to 3."""
_PROBE_2 = 8
_ENABLE = 1 << 0
ZERO_PULSE: Final = 1 << 2
"""60B8h: the zero pulse of the encoder in the place of probe 1."""
_RISING = 1 << 4
_STORED = 1 << 1


def enable_bits(edge: int) -> int:
    """60B8h for one edge (0 to 3), first event only."""
    return (_ENABLE | _RISING << (edge & 1)) << (_PROBE_2 * (edge >> 1))


def function(edges: Iterable[int], *, zero_pulse: bool = False) -> int:
    """60B8h for several edges; ``zero_pulse``: of the encoder, instead of probe 1."""
    value = ZERO_PULSE if zero_pulse else 0
    for edge in edges:
        value |= enable_bits(edge)
    return value


def enabled_bits(value: int) -> int:
    """60B9h: the probes that 60B8h enables."""
    return value & (_ENABLE | _ENABLE << _PROBE_2)


def stored_bit(edge: int) -> int:
    """60B9h: the position of an edge is stored."""
    return _STORED << (edge & 1) << (_PROBE_2 * (edge >> 1))
