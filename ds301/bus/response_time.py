"""Worst-case response times on a CAN bus: the latest time at which each planned frame is on the wire.

Source: Davis, Burns, Bril, Lukkien, "Controller Area Network (CAN) schedulability analysis: refuted, revisited and revised"
(2007); Davis, Kollmann, Pollex, Slomka, "Controller Area Network (CAN) Schedulability Analysis with FIFO Queues" (2011). Every
sender, the gateway's interface among them, counts as a FIFO queue: a frame waits for all frames of its sender, and the first
of the queue competes with the bus. The bound holds for controllers that send by priority too. Frames take the most stuff bits.
Not part of it: disturbed frames, EMCY, NMT commands, and unplanned traffic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from pdgw.ds301.bus.load import CyclicFrames, frame_bits
from pdgw.durations import SECOND

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
        return self._settle(
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
        found = self._settle(blocking - last, first, waits[sender])
        return waits[sender] if found is None else found

    def _settle(self, begin: int, frames: Sequence[tuple[int, int, int]], limit: int) -> int | None:
        """The time in which ``begin`` and all frames (duration, period, jitter) due in it are sent; None: above ``limit``."""
        window = 1  # an empty window has no frames
        while window <= limit:
            needed = begin + sum(duration * -(-(window + jitter) // period) for duration, period, jitter in frames)
            if needed <= window:
                return window
            window = needed
        return None
