"""Where a link's frames have the values of the drive objects, for those who read recorded frames."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FramePlaces:
    """Place of each drive object's values in the recorded frames from and to the PLC, None: it has none.

    ``kind``: ``udp`` frames begin with the FrameID after the headers, ``profinet`` frames to the PLC with the Ethernet header;
    those from the PLC are recorded after one.
    """

    kind: str
    setpoints: tuple[int | None, ...]
    actuals: tuple[int | None, ...]
