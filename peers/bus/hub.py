"""The hub of a loopback bus: it forwards every frame of a member to all others, in the same order for all.

A member sends ``JOIN`` to the hub's address and gets the port of its own socket. It connects to that and sends ``PROBE``;
from then on, a refused datagram means that the member has ended. Each other datagram is one can_frame. Members inside the
hub's process are functions.
"""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import struct
from collections import deque
from collections.abc import Callable
from typing import Protocol

from pdgw.ds301.bus.can_frame import CAN_FRAME
from pdgw.gateway.base.ports import bound

log = logging.getLogger("peers")

HOST = "127.0.0.1"
JOIN, LEAVE = b"J", b"L"
"""First and last datagram of a member; all others are frames."""
PROBE = b""
"""Empty datagram: a hub ignores it; without a hub the system reports an error."""
WELCOME = struct.Struct(">cH")
"""The answer to ``JOIN``: ``W`` and the port."""
_AT_ONCE = 64
"""Frames read from one member before the others have their turn."""

Receiver = Callable[[bytes], None]
"""Receives the 16 bytes of a frame."""


class Readers(Protocol):
    """Calls ``data`` when a socket is readable. A selector is one if it is served with ``for key, _ in s.select():
    key.data()``.
    """

    def register(self, fileobj: socket.socket, events: int, data: Callable[[], None], /) -> object:
        """Start calling. ``events`` is EVENT_READ."""

    def unregister(self, fileobj: socket.socket, /) -> object:
        """Stop calling."""


class Hub:
    """One bus. It works while ``readers`` are served.

    Raises GatewayError when the port cannot be opened; port 0 selects a free one.
    """

    def __init__(self, readers: Readers, port: int = 0) -> None:
        self._readers = readers
        self._listener = bound("bus", HOST, port, "choose another")
        self._listener.setblocking(False)
        self._members: list[socket.socket] = []
        self._joining: set[socket.socket] = set()
        """Those that may not be connected yet: the system refuses frames to them."""
        self._local: list[Receiver] = []
        self._waiting: deque[tuple[object, bytes]] = deque()
        readers.register(self._listener, selectors.EVENT_READ, self._admit)

    @property
    def channel(self) -> str:
        """The ``channel`` of the interface ``pdgw-bus`` for members."""
        host, port = self._listener.getsockname()
        return f"{host}:{port}"

    @property
    def members(self) -> int:
        """Number of members. One that ended without LEAVE counts until the next frame for it."""
        return len(self._members) + len(self._local)

    def attach(self, receive: Receiver) -> Receiver:
        """Add a member of this process. ``receive`` gets the frames of the others; the returned function sends."""
        self._local.append(receive)
        return lambda frame: self._carry(receive, frame)

    def detach(self, receive: Receiver) -> None:
        """Remove a member; no error if it is not a member."""
        if receive in self._local:
            self._local.remove(receive)

    def close(self) -> None:
        """Close the bus for all members."""
        for member in tuple(self._members):
            self._remove(member)
        self._readers.unregister(self._listener)
        self._listener.close()

    def _admit(self) -> None:
        # BlockingIOError: no data; others: error of a datagram to a member that ended
        with contextlib.suppress(OSError):
            data, address = self._listener.recvfrom(64)
            if data == JOIN:
                member = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                member.bind((HOST, 0))
                member.connect(address)
                member.setblocking(False)
                self._members.append(member)
                self._joining.add(member)
                self._readers.register(member, selectors.EVENT_READ, lambda: self._take(member))
                self._listener.sendto(WELCOME.pack(b"W", member.getsockname()[1]), address)

    def _take(self, member: socket.socket) -> None:
        for _ in range(_AT_ONCE):
            try:
                frame = member.recv(64)
            except BlockingIOError:
                return
            except OSError:  # refused: the socket is closed, or not connected yet
                if member in self._joining:
                    continue
                frame = LEAVE
            self._joining.discard(member)
            if frame == LEAVE:
                self._remove(member)
                return
            if len(frame) == CAN_FRAME.size:
                self._carry(member, frame)

    def _carry(self, sender: object, frame: bytes) -> None:
        """Forward to all but the sender. An immediate answer of a local member is forwarded after all have received the
        frame.
        """
        waiting = self._waiting
        waiting.append((sender, frame))
        if len(waiting) > 1:
            return  # called by a member from within the loop below
        while waiting:
            source, data = waiting[0]
            for member in tuple(self._members):
                if member is not source:
                    self._send(member, data)
            for receive in tuple(self._local):
                if receive is not source:
                    self._hand(receive, data)
            waiting.popleft()

    @staticmethod
    def _hand(receive: Receiver, data: bytes) -> None:
        try:
            receive(data)
        except Exception:  # an error of one device must not end the bus of the others
            log.exception("a member of the bus failed")

    def _send(self, member: socket.socket, data: bytes) -> None:
        try:
            member.send(data)
        except BlockingIOError:
            return  # a member that does not read loses frames, as with SocketCAN
        except OSError:
            if member not in self._joining:
                self._remove(member)

    def _remove(self, member: socket.socket) -> None:
        if member in self._members:
            self._members.remove(member)
            self._joining.discard(member)
            self._readers.unregister(member)
            member.close()
