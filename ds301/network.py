"""One CAN bus: a python-can bus, the PDO fast path and canopen's acyclic services on it.

A reader thread takes every frame once: COB-IDs with a PDO subscription go straight to their owner, everything else to
canopen's network (NMT, SDO, EMCY, heartbeat). Sending never waits for the acyclic side.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable

import can
import canopen

PdoCallback = Callable[[bytes, int], None]
"""(data, monotonic receive time in ns), called on the reader thread."""
FrameListener = Callable[[can.Message], None]
"""Sees every frame sent and received (``is_rx`` tells); called on the sending or reading thread.

It must only queue, and queue a copy: the sender uses its message again in the next cycle."""

_RECEIVE_TIMEOUT = 0.2
_RETRY_SECONDS = 0.1
_BUS_OFF = 0x40
"""The bit of an error frame's identifier that says bus-off (SocketCAN, linux/can/error.h)."""


class _AcyclicNetwork(canopen.Network):  # type: ignore[misc]
    """canopen's network, sending through ours and fed by our reader."""

    def __init__(self, owner: CanNetwork) -> None:
        super().__init__(owner.bus)
        self._owner = owner

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._owner.send_message(
            can.Message(arbitration_id=can_id, data=data, is_extended_id=False, is_remote_frame=remote)
        )


class CanNetwork:
    """A bus shared by the drives and encoders on it."""

    def __init__(self, bus: can.BusABC, name: str = "can") -> None:
        self.bus = bus
        self.name = name
        self.canopen = _AcyclicNetwork(self)
        self.sent = 0
        self.received = 0
        self.send_errors = 0
        self.error_frames = 0
        self.malformed = 0
        """Frames of an acyclic service that could not be decoded, for example an EMCY of 3 bytes; ignored."""
        self.healthy = True
        """False from a bus-off or a send error until a frame passes again."""
        self.listeners: list[FrameListener] = []
        self._pdos: dict[int, PdoCallback] = {}
        # Reentrant, because an in-process bus may answer inside send.
        self._sending = threading.RLock()
        self._stopping = threading.Event()
        self._reader = threading.Thread(target=self._read, name=f"{name} reader", daemon=True)

    def start(self) -> None:
        """Start the reader thread."""
        self._reader.start()

    def close(self) -> None:
        """Stop the reader thread and shut the bus down."""
        self._stopping.set()
        if self._reader.is_alive():
            self._reader.join()
        self.bus.shutdown()

    def subscribe_pdo(self, cob_id: int, callback: PdoCallback) -> None:
        """Route frames of this COB-ID to ``callback`` only."""
        self._pdos[cob_id] = callback

    def unsubscribe_pdo(self, cob_id: int) -> None:
        """End a subscription; none is no error."""
        self._pdos.pop(cob_id, None)

    def send(self, cob_id: int, data: bytes) -> bool:
        """Send without waiting; False (counted, ``healthy`` turns False) when the interface does not take the frame."""
        return self.send_message(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False, is_rx=False))

    def send_message(self, message: can.Message) -> bool:
        """As ``send``, for any frame."""
        try:
            with self._sending:
                self.bus.send(message)
        except (can.CanError, OSError):
            self.send_errors += 1
            self.healthy = False
            return False
        self.sent += 1
        if self.listeners:
            message.timestamp = time.time()
            message.is_rx = False
            for listener in self.listeners:
                listener(message)
        return True

    def send_heartbeat(self, node_id: int, state: int = 5) -> None:
        """The gateway's own heartbeat. The cyclic loop calls it, so that a hung loop stops the drives."""
        self.send(0x700 + node_id, bytes((state,)))

    def send_sync(self) -> None:
        """One SYNC, from the cyclic loop."""
        self.send(0x80, b"")

    def _read(self) -> None:
        while not self._stopping.is_set():
            try:
                message = self.bus.recv(_RECEIVE_TIMEOUT)
            except (can.CanError, OSError):
                # The interface went away: say so and try again, it may come back.
                self.healthy = False
                self._stopping.wait(_RETRY_SECONDS)
                continue
            if message is not None:
                self._dispatch(message)

    def _dispatch(self, message: can.Message) -> None:
        if message.is_error_frame:
            self.error_frames += 1
            # A single disturbed frame is repeated by the controller; only bus-off ends the traffic.
            if message.arbitration_id & _BUS_OFF or self.bus.state is can.BusState.ERROR:
                self.healthy = False
            return
        self.received += 1
        self.healthy = True
        for listener in self.listeners:
            listener(message)
        if message.is_extended_id or message.is_remote_frame:
            return
        callback = self._pdos.get(message.arbitration_id)
        if callback is not None:
            callback(bytes(message.data), time.monotonic_ns())
        else:
            try:
                self.canopen.notify(message.arbitration_id, message.data, message.timestamp)
            except (struct.error, IndexError, ValueError):
                # canopen unpacks unchecked: one node's bad frame must not end the reader of all of them.
                self.malformed += 1
