"""Load of a bus, from the worst-case frames of a configuration, and the latest time at which each frame is on the wire.

Load. Source: CiA 301 / Bosch CAN 2.0A: a standard data frame has 47 + 8n bits; in the worst case a stuff bit follows every four
of the 34 + 8n bits that are subject to stuffing. So 8 bytes take 111 to 135 bit times.

Latest times. Source: Davis, Burns, Bril, Lukkien, "Controller Area Network (CAN) schedulability analysis: refuted, revisited
and revised" (2007); Davis, Kollmann, Pollex, Slomka, "Controller Area Network (CAN) Schedulability Analysis with FIFO Queues"
(2011). Every sender, the gateway's interface among them, counts as a FIFO queue: a frame waits for all frames of its sender,
and the first of the queue competes with the bus. The bound holds for controllers that send by priority too. Frames take the
most stuff bits. Not part of it: disturbed frames, EMCY, NMT commands, and unplanned traffic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.ds301.aborts import CanopenError

DEFAULT_BITRATE: Final = 1_000_000
"""Default bit rate of a bus."""
GATEWAY: Final = 0
"""The sender of the gateway's frames, whatever its node-ID is."""
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
    """Frames that can appear ``per_second`` times: what they are, data bytes, rate, COB-ID, sender (node-ID)."""

    name: str
    size: int
    per_second: float
    cob_id: int = 0
    sender: int = GATEWAY


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


_LONGEST_NS: Final = SECOND
"""A wait that grows beyond this has no end: the bus is overloaded."""


def response_times(frames: Sequence[CyclicFrames], bitrate: int) -> dict[CyclicFrames, int | None]:
    """Nanoseconds from the moment a frame is due until it was sent, at worst; None where there is no bound."""
    analysis = _Analysis(frames, bitrate)
    busy = analysis.busy_period()
    if busy is None:
        return dict.fromkeys(frames)
    # No frame waits longer than the bus is busy without a gap. Each round starts from upper bounds, so its results are
    # bounds.
    waits = dict.fromkeys((frame.sender for frame in frames), busy)
    while (closer := {sender: analysis.wait(sender, waits) for sender in waits}) != waits:
        waits = closer
    return {frame: min(busy, waits[frame.sender] + analysis.duration[frame]) for frame in frames}


class _Analysis:
    def __init__(self, frames: Sequence[CyclicFrames], bitrate: int) -> None:
        self.duration = {frame: frame_bits(frame.size) * SECOND // bitrate for frame in frames}
        self._bit_ns = SECOND // bitrate
        self._period = {frame: int(SECOND / frame.per_second) for frame in frames}
        self._queues: dict[int, list[CyclicFrames]] = {}
        for frame in frames:
            self._queues.setdefault(frame.sender, []).append(frame)

    def busy_period(self) -> int | None:
        """The longest time without a gap on the bus, whatever the order of the frames; None: it does not end."""
        return self._fixed_point(
            0, [(self.duration[frame], period, 0) for frame, period in self._period.items()], _LONGEST_NS
        )

    def wait(self, sender: int, waits: Mapping[int, int]) -> int:
        """Time from the last frame of a queue being due until it starts. The waits of other queues are their jitter."""
        queue = self._queues[sender]
        lowest = max(frame.cob_id for frame in queue)
        blocking = max(self.duration[frame] for frame in queue)
        first = [(self.duration[frame], self._period[frame], self._bit_ns) for frame in queue]
        for frame, duration in self.duration.items():
            if frame.sender != sender and frame.cob_id > lowest:
                blocking = max(blocking, duration)
            elif frame.sender != sender:
                first.append((duration, self._period[frame], waits[frame.sender] + self._bit_ns))
        last = min(self.duration[frame] for frame in queue)
        found = self._fixed_point(blocking - last, first, waits[sender])
        return waits[sender] if found is None else found

    def _fixed_point(self, begin: int, frames: Sequence[tuple[int, int, int]], limit: int) -> int | None:
        """The time in which ``begin`` and all frames (duration, period, jitter) due in it are sent; None: above ``limit``."""
        window = 1  # an empty window has no frames
        while window <= limit:
            needed = begin + sum(duration * -(-(window + jitter) // period) for duration, period, jitter in frames)
            if needed <= window:
                return window
            window = needed
        return None
