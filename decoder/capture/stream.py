"""A binary stream read in blocks, with a window that is cut from the front: constant memory for files of any size."""

from __future__ import annotations

from typing import Protocol

BLOCK = 1 << 20


class ByteSource(Protocol):
    """The interface of a file, pipe or standard input."""

    def read1(self, size: int, /) -> bytes:
        """Bytes as they come, at most ``size``; empty at the end."""


class Window:
    """``data[at:]`` has been read and is not used yet. ``base``: offset of ``data`` in the stream."""

    def __init__(self, source: ByteSource) -> None:
        self._source = source
        self.data = b""
        self.at = 0
        self.base = 0
        self.ended = False

    @property
    def offset(self) -> int:
        """Number of used bytes of the stream."""
        return self.base + self.at

    @property
    def left(self) -> int:
        return len(self.data) - self.at

    def need(self, size: int) -> bool:
        """Read until ``size`` bytes are there; False when the stream ends before."""
        while len(self.data) - self.at < size:
            if self.ended:
                return False
            part = self._source.read1(BLOCK)
            if not part:
                self.ended = True
                return False
            self.base += self.at
            self.data = self.data[self.at :] + part
            self.at = 0
        return True
