"""Whether a CAN bus works: what shows that it does not, and what that means.

Source: ISO 11898-1 (error confinement: error-passive, bus-off), the error frames of SocketCAN.
"""

from __future__ import annotations

import enum
from typing import Final

from pdgw.base.durations import MS, SECOND

BUSY_NS: Final = 100 * MS
"""An interface that accepts no frame for this time does not work; a queue that is full for a moment is normal."""
RESTART_NS: Final = 5 * SECOND
"""An interface restarts sooner after a bus-off, if it does at all."""


class Outage(enum.Enum):
    """Why a bus is lost; ``value`` is the text for the user."""

    _value_: str
    remedy: str

    def __new__(cls, text: str, remedy: str) -> Outage:
        member = object.__new__(cls)
        member._value_, member.remedy = text, remedy
        return member

    @property
    def text(self) -> str:
        """Evidence."""
        return str(self.value)

    INTERFACE = (
        "its interface is lost",
        "check the CAN interface, its plug and its driver",
    )
    BUS_OFF = (
        "bus-off: each frame of the gateway is destroyed",
        "check the CAN cable for a short circuit, termination, bit rate and the interface",
    )
    STAYS_OFF = (
        "bus-off, and the interface does not restart",
        "set the interface down and up (ip link set can0 down; ip link set can0 up); with restart-ms 100 it restarts by itself",
    )
    UNACKNOWLEDGED = (
        "no device on the bus acknowledges a frame: all nodes are silent",
        "check the supply of the devices, then the CAN cable at the gateway, termination and bit rate",
    )
    QUIET = (
        "the interface sends no frame and reports no error",
        "if it is bus-off since before the start (ip -details link show can0), set it down and up; else check the supply of the "
        "devices, then the CAN cable at the gateway, termination and bit rate",
    )
    STUCK = (
        "the interface receives frames and sends none",
        "unplug the CAN adapter for a moment, or set its interface down and up; check its driver",
    )


class BusHealth:
    """The evidence of one bus, from the events of its port. Times are monotonic nanoseconds."""

    def __init__(self) -> None:
        self.outage: Outage | None = None
        """From the first evidence until frames are received and the interface takes frames to send."""
        self.last = Outage.INTERFACE
        """The last outage, also when it is over."""
        self.failures = 0
        """Number of outages."""
        self.doubted = False
        """The bus may not work: ``received`` and ``taken`` have to be called."""
        self.error_frames = 0
        self.error_passive = 0
        """Error frames that report it,"""
        self.bus_off = 0
        """and those that report bus-off."""
        self._is_off = False
        """The controller reported bus-off, and has not reported another state since."""
        self._busy_since = -1
        self._one_way_since = -1
        """Since when frames are received while the interface takes none to send; -1: they are not."""
        self._error = 0
        """When the controller reported an error last; 0: never."""

    def shown(self, now: int) -> Outage | None:
        """The outage for the user: a bus-off may stay."""
        stays = self.outage is Outage.BUS_OFF and now - self._error >= RESTART_NS
        return Outage.STAYS_OFF if stays else self.outage

    def taken(self) -> None:
        """The interface has taken a frame to send."""
        self._busy_since = self._one_way_since = -1

    def received(self, now: int) -> None:
        """A frame was received. While the interface takes none to send, the bus works in one direction only."""
        if self._busy_since >= 0:
            if self._one_way_since < 0:
                self._one_way_since = now
        else:
            self.outage, self._is_off = None, False
            self.doubted = False

    def error(self, now: int, *, bus_off: bool, passive: bool = False) -> None:
        """The controller has reported an error."""
        self.error_frames += 1
        self.error_passive += passive
        self.bus_off += bus_off
        self._error, self._is_off = now, bus_off
        if bus_off:
            self._fail(Outage.BUS_OFF)

    def busy(self, now: int) -> None:
        """The interface has refused a frame."""
        self.doubted = True
        if self._busy_since < 0:
            self._busy_since = now
        elif now - self._busy_since >= BUSY_NS and not self._is_off:
            # The first frame of a device that was off comes before the interface has sent what waits.
            since = now if self.outage is None else now - BUSY_NS
            alone = Outage.UNACKNOWLEDGED if self._error else Outage.QUIET
            self._fail(Outage.STUCK if 0 <= self._one_way_since <= since else alone)

    def lost(self) -> None:
        """The interface does not work any more."""
        self.taken()
        self._is_off = False
        self._fail(Outage.INTERFACE)

    def _fail(self, outage: Outage) -> None:
        self.failures += self.outage is None
        self.outage = self.last = outage
        self.doubted = True
