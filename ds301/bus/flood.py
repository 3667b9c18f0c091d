"""Which identifier fills a CAN bus: counted for a moment when nodes are silent, or when no frame goes out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.load import frame_bits
from pdgw.ds301.loop.loop import Loop, Timer

SAMPLE_NS: Final = 100 * MS
"""Duration of a sample."""
AGAIN_NS: Final = SECOND
"""Time between two samples while the bus is full."""
_FULL: Final = 0.75
"""Load above which others do not get their turn; stuff bits, another fifth of the time, are not counted."""
_HALF: Final = 0.5
"""One identifier with more of the load fills the bus."""


@dataclass(frozen=True, slots=True)
class Flood:
    """An identifier that fills a bus, and its load: the share of the time without stuff bits."""

    can_id: int
    load: float

    @property
    def text(self) -> str:
        """Evidence."""
        return f"frames with COB-ID {self.can_id:03X}h fill the bus: more than {100 * self.load:.0f} % of the time"

    @property
    def remedy(self) -> str:
        """What to do."""
        return f"find the device that sends COB-ID {self.can_id:03X}h, and disconnect it"


class Census:
    """The bits of each identifier, counted during a sample."""

    def __init__(self) -> None:
        self._bits: dict[int, int] = {}

    def count(self, can_id: int, size: int) -> None:
        """A frame was received."""
        self._bits[can_id] = self._bits.get(can_id, 0) + frame_bits(size, worst=False)

    def flood(self, bitrate: int) -> Flood | None:
        """What fills the bus; None if nothing does."""
        total = sum(self._bits.values())
        load = total * SECOND / SAMPLE_NS / bitrate
        if load < _FULL:
            return None
        most = max(self._bits, key=lambda can_id: self._bits[can_id])
        share = self._bits[most] / total
        return Flood(most, min(load * share, 1.0)) if share > _HALF else None


class FloodWatch:
    """Takes samples of one bus when it is asked, and again while the bus is full.

    ``bitrate`` has that of the bus. ``begins`` is called when a sample begins, ``report`` with the text of a flood or of its end,
    and whether there is one.
    """

    def __init__(
        self, loop: Loop, bitrate: Callable[[], int], begins: Callable[[], None], report: Callable[[str, bool], None]
    ) -> None:
        self._loop = loop
        self._begins = begins
        self._bitrate = bitrate
        self._report = report
        self.flood: Flood | None = None
        """What fills the bus."""
        self.census: Census | None = None
        """The sample that is taken now, which counts received frames."""
        self._next: Timer | None = None

    def examine(self) -> bool:
        """Take a sample. False if one is taken, or will be."""
        if self.census is not None or self._next is not None:
            return False
        self._begin()
        return True

    def cancel(self) -> None:
        """Take no more samples."""
        if self._next is not None:
            self._next.cancel()

    def _begin(self) -> None:
        self.census = Census()
        self._begins()
        self._next = self._loop.call_later(SAMPLE_NS, self._end)

    def _end(self) -> None:
        census, self.census, self._next = self.census, None, None
        before, self.flood = self.flood, None if census is None else census.flood(self._bitrate())
        if self.flood is not None:
            self._next = self._loop.call_later(AGAIN_NS, self._begin)
        if self.flood is not None and (before is None or before.can_id != self.flood.can_id):
            self._report(self.flood.text, True)
        elif self.flood is None and before is not None:
            self._report("not full any more", False)
