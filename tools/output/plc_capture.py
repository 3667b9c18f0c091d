"""Write the traffic of the PLC simulator and its parameter channel to a pcap file with Ethernet, IP and UDP headers."""

from __future__ import annotations

import queue
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path

from pdgw.durations import SECOND, US
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.udp import Address
from pdgw.gateway.trace.blocks import udp_header

_FILE = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
"""Header of a pcap file: microseconds, version 2.4, UTC, whole packets, Ethernet."""
_PACKET = struct.Struct("<IIII")


class Capture:
    """Conversations as a pcap with Ethernet, IP and UDP headers; a separate thread writes them.

    GatewayError when the file cannot be opened, and from ``close`` when it could not be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._failure: Exception | None = None
        self._frames: queue.SimpleQueue[tuple[int, bytes] | None] = queue.SimpleQueue()
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise self._unwritable(error) from error
        self._thread = threading.Thread(target=self._write, name="capture", daemon=True)
        self._thread.start()

    def conversation(self, local: Address, remote: Address) -> Callable[[bool, bytes], None]:
        """A function that records the datagrams (sent, data) between two addresses; callable from any thread."""

        def take(sent: bool, data: bytes) -> None:
            ends = (f"{host}:{port}" for host, port in ((local, remote) if sent else (remote, local)))
            self._frames.put((time.time_ns(), udp_header(*ends, len(data)) + data))

        return take

    def close(self) -> None:
        self._frames.put(None)
        self._thread.join()
        try:
            self._file.close()
        except OSError as error:
            self._failure = self._failure or error
        if self._failure is not None:
            raise self._unwritable(self._failure)

    def _unwritable(self, error: Exception) -> GatewayError:
        why = getattr(error, "strerror", None) or repr(error)
        return GatewayError(f"--pcap {self._path}: cannot be written ({why})")

    def _write(self) -> None:
        try:
            self._write_frames()
        except Exception as error:  # after any error the capture is incomplete
            self._failure = error
            while self._frames.get() is not None:
                continue  # discard the rest, because it cannot be written

    def _write_frames(self) -> None:
        self._file.write(_FILE)
        while (item := self._frames.get()) is not None:
            when, packet = item
            seconds, rest = divmod(when, SECOND)
            self._file.write(_PACKET.pack(seconds, rest // US, len(packet), len(packet)) + packet)
