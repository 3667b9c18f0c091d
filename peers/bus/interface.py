"""``pdgw-bus``: a member of a loopback bus as a python-can interface.

It is python-can's own SocketCAN class on another socket, so that code with direct access to the socket finds the same 16
bytes. It is registered as an entry point of python-can, so a configuration opens it by name.
"""

from __future__ import annotations

import contextlib
import select
import socket
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import can
from can.interfaces.socketcan import SocketcanBus, constants

from pdgw.ds301.bus.can_frame import CAN_FRAME, ERROR, EXTENDED, REMOTE, unpack_frame
from pdgw.peers.bus.hub import JOIN, LEAVE, PROBE, WELCOME

INTERFACE = "pdgw-bus"
_ANSWER_S = 10.0
"""Without a hub the kernel reports an error at once. A hub that does not answer is waiting for the processor."""
_FLAGS = EXTENDED | REMOTE | ERROR


def _address(channel: str) -> tuple[str, int]:
    host, _, port = channel.rpartition(":")
    if not host or not (port.isdecimal() and 0 < int(port) < 65536):
        raise can.CanInitializationError(
            f"channel {channel!r}: expected HOST:PORT, as `pdgw sim bus --serve` prints it"
        )
    return host, int(port)


def _join(channel: str) -> socket.socket:
    """Connect a socket to the hub at ``HOST:PORT``; CanInitializationError without a hub."""
    address = _address(channel)
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind((address[0], 0))
        sock.settimeout(_ANSWER_S)
        sock.connect(address)
        sock.send(JOIN)
        answer = sock.recv(64)
        if len(answer) != WELCOME.size:
            raise OSError("another program uses this port")
        sock.connect((address[0], WELCOME.unpack(answer)[1]))
        sock.send(PROBE)
    except OSError as error:
        sock.close()
        raise can.CanInitializationError(
            f"no bus on {channel} ({error}); start one with `pdgw sim bus --serve`"
        ) from error
    sock.setblocking(True)
    return sock


class LoopbackBus(SocketcanBus):
    """Channel ``HOST:PORT`` of a hub. A member does not receive its own frames. A bit rate is accepted and ignored."""

    def __init__(self, channel: str, can_filters: Any = None, **kwargs: Any) -> None:
        self._is_shutdown = True  # until there is a socket to close
        self.socket = _join(channel)
        self._is_shutdown = False
        self.channel = channel
        self.channel_info = f"loopback bus {channel}"
        self._bcm_sockets: dict[str, socket.socket] = {}
        self._is_filtered = False
        self._task_id = 0
        self._task_id_guard = threading.Lock()
        self._can_protocol = can.CanProtocol.CAN_20
        self._kernel_times = sys.platform == "linux"
        if self._kernel_times:
            self.socket.setsockopt(socket.SOL_SOCKET, constants.SO_TIMESTAMPNS, 1)
        can.BusABC.__init__(self, channel=channel, can_filters=can_filters, **kwargs)

    def probe_hub(self) -> None:
        """Send an empty datagram, so that reading fails if the hub has ended. Callable from any thread."""
        with contextlib.suppress(OSError):
            self.socket.send(PROBE)

    def shutdown(self) -> None:
        """Leave the bus."""
        if not self._is_shutdown:
            with self.socket:
                with contextlib.suppress(OSError):  # the hub has ended already
                    self.socket.send(LEAVE)
                super().shutdown()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._kernel_times:
            return super()._recv_internal(timeout)
        # Only Linux delivers a time stamp with the data.
        if not select.select([self.socket], [], [], timeout)[0]:
            return None, False
        try:
            identifier, data = unpack_frame(self.socket.recv(CAN_FRAME.size))
        except OSError as error:
            raise can.CanOperationError(f"Error receiving: {error.strerror}", error.errno) from error
        message = can.Message(
            timestamp=time.time(),
            arbitration_id=identifier & ~_FLAGS,
            is_extended_id=bool(identifier & EXTENDED),
            is_remote_frame=bool(identifier & REMOTE),
            is_error_frame=bool(identifier & ERROR),
            dlc=len(data),
            data=data,
        )
        return message, False

    def _apply_filters(self, filters: Any) -> None:
        """No filters in the kernel: python-can filters itself."""

    def _send_periodic_internal(
        self,
        msgs: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Callable[[can.Message], None] | None = None,
    ) -> Any:
        """Use a thread: the kernel's broadcast manager supports CAN sockets only."""
        return can.BusABC._send_periodic_internal(self, msgs, period, duration, autostart, modifier_callback)

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        return []
