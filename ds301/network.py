"""One CAN bus: a python-can bus, the PDO fast path and canopen's acyclic services on it.

A reader thread takes every frame once: COB-IDs with a PDO subscription go straight to their owner, everything else to
canopen's network (NMT, SDO, EMCY, heartbeat). Sending never waits for the acyclic side.
"""

from __future__ import annotations

from collections.abc import Callable

import can
import canopen

PdoCallback = Callable[[bytes, int], None]
"""(data, monotonic receive time in ns), called on the reader thread."""


class CanNetwork:
    """A bus shared by the drives and encoders on it."""

    def __init__(self, bus: can.BusABC, name: str = "can") -> None:
        self.bus = bus
        self.name = name
        self.canopen = canopen.Network(bus)
        self.sent = 0
        self.received = 0
        self.send_errors = 0

    def start(self) -> None:
        """Start the reader thread."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop the reader thread and shut the bus down."""
        raise NotImplementedError

    def subscribe_pdo(self, cob_id: int, callback: PdoCallback) -> None:
        """Route frames of this COB-ID to ``callback`` only."""
        raise NotImplementedError

    def unsubscribe_pdo(self, cob_id: int) -> None:
        raise NotImplementedError

    def send(self, cob_id: int, data: bytes) -> bool:
        """Send without waiting; False (counted, ``healthy`` turns False) when the interface does not take the frame."""
        raise NotImplementedError

    @property
    def healthy(self) -> bool:
        """False from a bus-off or a send error until a frame passes again."""
        raise NotImplementedError

    def send_heartbeat(self, node_id: int, state: int = 5) -> None:
        """The gateway's own heartbeat. The cyclic loop calls it, so that a hung loop stops the drives."""
        raise NotImplementedError
