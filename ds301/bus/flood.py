"""Which identifier fills a CAN bus: counted for a moment when nodes are silent, or when no frame goes out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.load import frame_bits

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
