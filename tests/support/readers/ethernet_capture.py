"""Capture of everything that an Ethernet interface sends and receives, as pcapng with the kernel's time stamps (Linux).

The kernel collects the frames in a ring of blocks (linux/if_packet.h, TPACKET_V3) and wakes the reader once for each block,
so the recording hardly disturbs the recorded process.
"""

from __future__ import annotations

import mmap
import os
import select
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Final, Self

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.arrivals import SO_TIMESTAMPNS
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.trace import pcapng
from pdgw.tools.decoder.capture.live import EVERY_PROTOCOL
from pdgw.tools.decoder.frames.records import LinkType


class PcapngWriter:
    """Interfaces are added as they are met; times are nanoseconds. Raises OSError as the file does."""

    def __init__(self, path: Path, configuration: str = "") -> None:
        self._file: BinaryIO = path.open("wb", buffering=1 << 16)
        self._interfaces: dict[tuple[int, str], int] = {}
        self._file.write(pcapng.section_header(configuration))

    def write(self, link: LinkType, name: str, time_ns: int, data: bytes) -> None:
        """One packet of an interface."""
        number = self._interfaces.get((link, name))
        if number is None:
            number = self._interfaces[link, name] = len(self._interfaces)
            self._file.write(pcapng.interface(link, name))
        self._file.write(pcapng.packet(number, time_ns, data))

    def close(self) -> None:
        self._file.close()


_SOL_PACKET, _PACKET_RX_RING, _PACKET_STATISTICS, _PACKET_VERSION, _TPACKET_V3 = 263, 5, 6, 10, 2
_REQUEST: Final = struct.Struct("7I")
"""Size and number of blocks, size and number of frames (only their product counts), milliseconds until a block is delivered,
private bytes, features.
"""
_BLOCK_SIZE, _BLOCKS, _FRAME_SIZE, _HANDED_OUT_MS = 1 << 20, 16, 1 << 11, 100
_BLOCK: Final = struct.Struct("8x3I")
"""Whose it is, frames in it, offset of the first one."""
_STATUS: Final = struct.Struct("8xI")
_FRAME: Final = struct.Struct("4I8xH")
"""Offset of the next one, seconds, nanoseconds, recorded bytes; offset of the frame itself."""
_OF_KERNEL, _OF_READER = 0, 1
_STATISTICS: Final = struct.Struct("3I")
_WAIT_S: Final = 0.2
_NICE: Final = 10
"""Niceness of the writing thread, below everything that is recorded."""


class EthernetCapture:
    """Records from ``__enter__`` to ``__exit__``; GatewayError if the interface or the file cannot be opened."""

    def __init__(self, interface: str, path: Path) -> None:
        self.lost = 0
        """Frames that arrived faster than they could be written; valid at the end."""
        try:
            self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
        except OSError as error:
            raise GatewayError(f"interface {interface}: cannot be recorded ({error.strerror or error})") from error
        try:
            request = _REQUEST.pack(
                _BLOCK_SIZE, _BLOCKS, _FRAME_SIZE, _BLOCK_SIZE // _FRAME_SIZE * _BLOCKS, _HANDED_OUT_MS, 0, 0
            )
            self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self._socket.setsockopt(_SOL_PACKET, _PACKET_VERSION, _TPACKET_V3)
            self._socket.setsockopt(_SOL_PACKET, _PACKET_RX_RING, request)
            self._ring = mmap.mmap(self._socket.fileno(), _BLOCK_SIZE * _BLOCKS)
            self._socket.bind((interface, EVERY_PROTOCOL))
            self._writer = PcapngWriter(path)
        except OSError as error:
            self._socket.close()
            raise GatewayError(f"interface {interface}: cannot be recorded ({error.strerror or error})") from error
        self._interface = interface
        self._block = 0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._record, name=f"capture of {interface}", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._thread.join()
        statistics = self._socket.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, _STATISTICS.size)
        _, self.lost, _ = _STATISTICS.unpack(statistics)
        self._ring.close()
        self._socket.close()
        self._writer.close()

    def _record(self) -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        while True:
            ready, _, _ = select.select((self._socket,), (), (), _WAIT_S)
            for time_ns, data in self._frames():
                self._writer.write(LinkType.ETHERNET, self._interface, time_ns, data)
            if not ready and self._ending.is_set():
                return

    def _frames(self) -> Iterator[tuple[int, bytes]]:
        """Times and frames of the blocks that the kernel has handed out."""
        ring = self._ring
        while True:
            start = self._block * _BLOCK_SIZE
            status, count, offset = _BLOCK.unpack_from(ring, start)
            if not status & _OF_READER:
                return
            at = start + offset
            for _ in range(count):
                following, seconds, rest, size, begin = _FRAME.unpack_from(ring, at)
                yield seconds * SECOND + rest, ring[at + begin : at + begin + size]
                at += following
            _STATUS.pack_into(ring, start, _OF_KERNEL)
            self._block = (self._block + 1) % _BLOCKS
