"""Recording for `pdgw run --record`, and the capture of an Ethernet interface."""

from __future__ import annotations

import logging
import mmap
import os
import select
import socket
import struct
import threading
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Final, Self

from pdgw.ds301.counters import Counters
from pdgw.durations import SECOND
from pdgw.gateway.errors import GatewayError, writing
from pdgw.gateway.links.udp import SO_TIMESTAMPNS
from pdgw.tools.decoder.capture.live import EVERY_PROTOCOL
from pdgw.tools.decoder.capture.pcap import PcapngWriter
from pdgw.tools.decoder.frames.records import LinkType
from pdgw.tools.recording.background_writer import wait_for_end
from pdgw.tools.recording.recordings import CONFIGURATION

# Capture of everything that an Ethernet interface sends and receives, as pcapng with the kernel's time stamps (Linux).
#
# The kernel collects the frames in a ring of blocks (linux/if_packet.h, TPACKET_V3) and wakes the reader once for each block,
# so the recording hardly disturbs the recorded process.


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


# ``pdgw run --record``: copy the recording of a running gateway from RAM to a folder, on a thread of its own.


log = logging.getLogger("gateway")

CAPTURE: Final = "gateway.pcapng"
CAPTURE_SIZE: Final = 256 << 20
"""Bytes after which another capture begins."""
CAPTURES: Final = 20
"""Full ones that are kept."""
_POLL_S: Final = 0.25


class Captures:
    """Write ``gateway.pcapng`` in a folder; a full file gets the time of its end in its name, and a new one begins.

    ``size``: bytes from which on a file is full, ``files``: number of full ones to keep, those of earlier runs included. Raises
    OSError as files do.
    """

    def __init__(self, folder: Path, size: int, files: int) -> None:
        self._folder = folder
        self._size = size
        self._files = files
        self._path = folder / CAPTURE
        self._put_aside()
        self._file: BinaryIO = self._path.open("wb")

    def begin(self) -> None:
        """A segment begins, which another file can begin with."""
        if self._file.tell() >= self._size:
            self._file.close()
            self._put_aside()
            self._file = self._path.open("wb")

    def write(self, data: bytes) -> None:
        """A part of the segment."""
        self._file.write(data)
        self._file.flush()

    def close(self) -> None:
        self._file.close()

    def _put_aside(self) -> None:
        try:
            ended = datetime.fromtimestamp(self._path.stat().st_mtime).strftime("%Y%m%d-%H%M%S")
        except FileNotFoundError:
            return  # another process has deleted it already
        names = (
            f"{self._path.stem}-{ended}{more}{self._path.suffix}" for more in ("", *(f"-{n}" for n in range(2, 1000)))
        )
        self._path.replace(next(path for name in names if not (path := self._folder / name).exists()))
        full = sorted(
            self._folder.glob(f"{self._path.stem}-*{self._path.suffix}"), key=lambda path: path.stat().st_mtime_ns
        )
        for path in full[: -self._files]:
            path.unlink(missing_ok=True)


class Recording:
    """Copies the segments of ``ring`` until ``stop``; GatewayError when the folder cannot be written."""

    def __init__(
        self, folder: Path, ring: Path, configuration: str, size: int = CAPTURE_SIZE, files: int = CAPTURES
    ) -> None:
        self._what = f"--record {folder}"
        with writing(self._what):
            folder.mkdir(parents=True, exist_ok=True)
            (folder / CONFIGURATION).write_text(configuration, encoding="utf-8")
            self._captures = Captures(folder, size, files)
        self._ring = ring
        self._segment: BinaryIO | None = None
        self._number = 0
        self.lost = 0
        """Segments that were deleted from the RAM before they were copied, or not written."""
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self._what, daemon=True)
        self._thread.start()

    def count_in(self, counters: Counters) -> None:
        """Count the lost segments."""
        counters.add("record", "lost", "segments", "not recorded: the disk is full or too slow", lambda: self.lost)

    def stop(self) -> None:
        """Everything is written afterwards, as far as the disk takes it within two seconds."""
        self._ending.set()
        wait_for_end(self._thread)

    def _run(self) -> None:
        try:
            while not self._ending.wait(_POLL_S):
                self._copy()
            self._copy()
            self._captures.close()
        except OSError as error:
            self.lost += 1
            log.error("%s: %s; the recording has stopped", self._what, error.strerror or error)

    def _copy(self) -> None:
        """What is new in the ring. An open segment can be read after it was deleted."""
        while True:
            later = [path for path in sorted(self._ring.glob("*.pcapng")) if _number(path) > self._number]
            if self._segment is not None:
                self._captures.write(self._segment.read())
            if not later:
                return
            missing = _number(later[0]) - self._number - 1
            if self._segment is not None:
                self._segment.close()
                if missing:
                    self.lost += missing
                    log.error("%s: the disk is too slow, %d segments are missing", self._what, missing)
            self._captures.begin()
            self._segment, self._number = later[0].open("rb"), _number(later[0])


def _number(segment: Path) -> int:
    return int(segment.stem.partition("-")[0])
