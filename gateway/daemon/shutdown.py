"""The end of a gateway: it waits until no drive has power and each has its own values again, or the time is over."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.drive.client import DriveClient
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.drive_object import DriveObject

log = logging.getLogger("gateway")

_SHUTDOWN_NS: Final = 5_000 * MS
_OFF_CYCLES: Final = 3
"""Number of consecutive cycles without power in any drive before the nodes are stopped."""


class Shutdown:
    """From the request to stop until the nodes are stopped."""

    def __init__(self, objects: Sequence[DriveObject], now: int) -> None:
        """It begins: each axis stops its way, and only OFF2 and OFF3 count."""
        log.info("stopping the drives")
        self._objects = objects
        self._until = now + _SHUTDOWN_NS
        self._off_cycles = 0
        self._written_back: list[tuple[Axis, Future[None]]] | None = None
        """What writes the drives' own values back, once all are off."""
        for item in objects:
            item.gateway_stops = True

    def step(self, now: int, *, alone: bool) -> bool:
        """One cycle; True when it is over. ``alone``: no other master is on a bus."""
        powered = any(item.may_have_power for item in self._objects)
        self._off_cycles = 0 if powered else self._off_cycles + 1
        if now <= self._until:
            return self._off_cycles >= _OFF_CYCLES and self._write_back(alone=alone)
        if powered:
            log.error("drives did not stop, or are lost, within %d s: power off by NMT", _SHUTDOWN_NS // SECOND)
        return True

    def _write_back(self, *, alone: bool) -> bool:
        """Once all drives are off: whether each has its own values again, or failed to take them. Not beside another master."""
        if self._written_back is None:
            axes = [item for item in self._objects if isinstance(item, Axis) and alone]
            kept = [axis for axis in axes if axis.drive.own_values]
            self._written_back = [(axis, axis.drive.submit(DriveClient.write_back)) for axis in kept]
        if not all(future.done() for _, future in self._written_back):
            return False
        for axis, future in self._written_back:
            if (error := future.exception()) is not None:
                log.warning("%s: the drive's own limits are not written back: %s", axis.label, error)
        return True
