"""Write the traffic of the PLC simulator and its parameter channel to a pcap file with Ethernet, IP and UDP headers."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from pdgw.base.durations import SECOND, US
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.udp import Address
from pdgw.gateway.trace.pcapng import udp_header

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
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise self._unwritable(error) from error
        self._writer = ThreadPoolExecutor(1, "capture")
        self._writer.submit(self._write, _FILE)

    def conversation(self, local: Address, remote: Address) -> Callable[[bool, bytes], None]:
        """A function that records the datagrams (sent, data) between two addresses; callable from any thread."""

        def take(sent: bool, data: bytes) -> None:
            ends = (f"{host}:{port}" for host, port in ((local, remote) if sent else (remote, local)))
            packet = udp_header(*ends, len(data)) + data
            seconds, rest = divmod(time.time_ns(), SECOND)
            self._writer.submit(self._write, _PACKET.pack(seconds, rest // US, len(packet), len(packet)) + packet)

        return take

    def close(self) -> None:
        self._writer.shutdown()
        try:
            self._file.close()
        except OSError as error:
            self._failure = self._failure or error
        if self._failure is not None:
            raise self._unwritable(self._failure)

    def _unwritable(self, error: Exception) -> GatewayError:
        why = getattr(error, "strerror", None) or repr(error)
        return GatewayError(f"--pcap {self._path}: cannot be written ({why})")

    def _write(self, data: bytes) -> None:
        """Write until the first error, after which the capture is incomplete."""
        if self._failure is None:
            try:
                self._file.write(data)
            except Exception as error:  # of any kind: the capture is incomplete
                self._failure = error
