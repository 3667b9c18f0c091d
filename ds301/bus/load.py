"""The bus load planner: worst-case frames and bit times of a configuration.

Source: CiA 301 / Bosch CAN 2.0A: a standard data frame has 47 + 8n bits; in the worst case a stuff bit follows every four
of the 34 + 8n bits that are subject to stuffing. So 8 bytes take 111 to 135 bit times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from pdgw.ds301.errors import CanopenError
from pdgw.durations import SECOND

DEFAULT_BITRATE: Final = 1_000_000
"""Default bit rate of a bus."""
_OVERHEAD_BITS = 47
_STUFFED_OVERHEAD_BITS = 34
_SDO_SHARE: Final = 0.5
_LEAST_SDO_SHARE: Final = 0.1


def frame_bits(size: int, *, worst: bool = True) -> int:
    """Bit times of a standard frame with ``size`` data bytes, interframe space included."""
    if not 0 <= size <= 8:
        raise CanopenError("data bytes of a CAN frame", size, "0..8")
    bits = _OVERHEAD_BITS + 8 * size
    return bits + (_STUFFED_OVERHEAD_BITS + 8 * size - 1) // 4 if worst else bits


@dataclass(frozen=True, slots=True)
class CyclicFrames:
    """Frames that can appear ``per_second`` times: what they are, data bytes, rate, COB-ID and node-ID of their sender."""

    name: str
    size: int
    per_second: float
    cob_id: int = 0
    sender: int = 0


def bus_load(frames: Sequence[CyclicFrames], bitrate: int) -> float:
    """Worst-case share of the bus, 1.0 = full."""
    if bitrate <= 0:
        raise CanopenError("bitrate", bitrate, "above 0 bit/s")
    return sum(frame_bits(frame.size) * frame.per_second for frame in frames) / bitrate


def check_load(name: str, frames: Sequence[CyclicFrames], bitrate: int, limit: float = 1.0) -> float:
    """The load of bus ``name``; CanopenError with the numbers when it is above ``limit``."""
    load = bus_load(frames, bitrate)
    if load > limit:
        rate = sum(frame.per_second for frame in frames)
        raise CanopenError(
            f"worst-case load of bus {name}",
            f"{load:.0%} ({rate:.0f} frames/s at {bitrate} bit/s)",
            f"at most {limit:.0%}: raise cycle_time_ms, use fewer axes per bus or sync",
        )
    return load


def sdo_gap_ns(load: float, bitrate: int) -> int:
    """Time between two SDO requests in nanoseconds. Request and answer use half of what the planned ``load`` leaves free.

    An overloaded bus gives them a tenth, otherwise no node could be configured.
    """
    share = max(_SDO_SHARE * (1 - load), _LEAST_SDO_SHARE)
    return int(2 * frame_bits(8) * SECOND / (bitrate * share))
