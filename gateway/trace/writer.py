"""Writer of the ring: a record in less than a microsecond, in a file that exists before the first record.

Nothing waits for the disk or allocates memory during the exchange: the file is created and its pages are mapped when it is
opened. Readers poll the file (``reader``).
"""

from __future__ import annotations

import mmap
import os
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

from pdgw.gateway.errors import GatewayError
from pdgw.gateway.trace.layout import (
    FRAME,
    PEER_OFFSET,
    PEER_SIZE,
    SUFFIX,
    WORD,
    RingLayout,
    Word,
    sized,
)
from pdgw.gateway.trace.ordering import IN_ORDER, Fence
from pdgw.gateway.trace.truncation import Mapping

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

PREVIOUS = ".previous" + SUFFIX
_MODE = 0o440
"""No other program opens the ring for writing by mistake; the gateway has it open already."""
_LOCK_MODE = 0o600
"""File mode: a user who can read the file could lock it."""
_NAMES = 9
"""Maximum number of gateways of one name on a machine, each with its own file."""
_U64: Final = (1 << 64) - 1
_pack_frame: Final = FRAME.pack_into
_FRAME_SIZE: Final = FRAME.size
_NEWEST_CYCLE: Final = int(Word.NEWEST_CYCLE)
_NEWEST_FRAME: Final = int(Word.NEWEST_FRAME)
_FRAMES_BEFORE: Final = int(Word.FRAMES_BEFORE)
"""Constants, because each access to a member of an enum is a look-up."""


class RingFile:
    """A ring that is written; GatewayError when it cannot be made. ``limit``: bytes of records at most.

    ``fence``: called where everything stored before has to be seen before what follows; None: what this machine needs for that.
    """

    def __init__(
        self,
        directory: Path,
        layout: RingLayout,
        limit: int,
        *,
        keep_previous: bool = True,
        fence: Callable[[], None] | None = None,
    ) -> None:
        cycles, frames = sized(layout, limit)
        self.layout = layout = replace(layout, cycles=cycles, frames=frames)
        self._fence = Fence() if fence is None and not IN_ORDER else fence
        self.failures = 0
        """Records that could not be written: a value that fits no field."""
        try:
            self.path, self._lock = _place(directory, layout.name, keep_previous=keep_previous)
            self._map = _make(self.path, layout)
        except OSError as error:
            raise GatewayError(f"flight recorder: {directory}: {error.strerror or error}") from error
        except AttributeError as error:
            raise GatewayError("flight recorder: not available on this operating system") from error
        self._mapping = Mapping(self._map)
        self._words = memoryview(self._map).cast("Q")
        self._pack_cycle = layout.cycle.pack_into
        self._cycle_size, self._cycle_mask, self._cycles = layout.cycle.size, cycles - 1, layout.cycles_offset
        self._frame_mask, self._frames = frames - 1, layout.frames_offset
        self._cycle = self._frame = 0
        self._words[Word.PROCESS] = os.getpid()

    def cycle(self, values: list[object]) -> None:
        """One cycle: time, flags, sizes, answer time, both frames, then the fields of each drive object."""
        sequence = self._cycle = self._cycle + 1
        offset = self._cycles + (sequence & self._cycle_mask) * self._cycle_size
        words, word = self._words, offset // WORD
        fence = self._fence
        if fence is not None:
            fence()
            words[_FRAMES_BEFORE] = self._frame
        words[word] = 0
        try:
            self._pack_cycle(self._map, offset, 0, *values)
        except struct.error:
            self.failures += 1
            return
        words[word] = words[_NEWEST_CYCLE] = sequence

    def frame(self, bus: int, identifier: int, data: bytes, sent: int, time_ns: int) -> None:
        """One CAN frame; ``identifier`` with the flags of SocketCAN."""
        sequence = self._frame = self._frame + 1
        offset = self._frames + (sequence & self._frame_mask) * _FRAME_SIZE
        words, word = self._words, offset // WORD
        words[word] = 0
        _pack_frame(self._map, offset, 0, time_ns, identifier, bus, sent, len(data), 0, data)
        words[word] = words[_NEWEST_FRAME] = sequence

    def set_clock(self, wall_offset_ns: int) -> None:
        """Set the difference of the wall clock to the monotonic clock."""
        self._words[Word.WALL_OFFSET] = wall_offset_ns & _U64

    def set_peer(self, peer: str) -> None:
        """Set the present or last PLC."""
        self._map[PEER_OFFSET : PEER_OFFSET + PEER_SIZE] = peer.encode()[:PEER_SIZE].ljust(PEER_SIZE, b"\0")

    @property
    def truncated(self) -> bool:
        """Another program truncated the file: the records since then are lost."""
        return self._mapping.truncated

    def close(self) -> None:
        """Nothing more comes; the file stays."""
        if self._fence is not None:
            self._fence()
        self._words[Word.ENDED] = 1
        self._mapping.release()
        self._words.release()
        self._map.close()
        os.close(self._lock)


def _place(directory: Path, name: str, *, keep_previous: bool) -> tuple[Path, int]:
    """The path no living gateway has, and the lock that says so. What an earlier one left there is kept as the previous ring."""
    for number in range(1, _NAMES + 1):
        stem = name if number == 1 else f"{name}-{number}"
        lock = os.open(directory / f"{stem}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, _LOCK_MODE)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        path = directory / (stem + SUFFIX)
        if keep_previous and path.exists():
            path.replace(directory / (stem + PREVIOUS))
        return path, lock
    raise OSError(0, f"{_NAMES} gateways with the name {name} are already running")


def _make(path: Path, layout: RingLayout) -> mmap.mmap:
    """The file, whole in memory before anything is written to it: a full file system is an error now, not in a cycle."""
    new = path.with_suffix(".new")
    new.unlink(missing_ok=True)
    descriptor = os.open(new, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, _MODE)
    try:
        os.fchmod(descriptor, _MODE)
        os.posix_fallocate(descriptor, 0, layout.size)
        mapped = mmap.mmap(descriptor, layout.size, flags=mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0))
    except OSError:
        new.unlink(missing_ok=True)
        raise
    finally:
        os.close(descriptor)
    head = layout.head()
    mapped[: len(head)] = head
    new.replace(path)
    return mapped
