"""``pdgw run --record``: copy the recording of a running gateway from RAM to a folder, on a thread of its own."""

from __future__ import annotations

import logging
import threading
from datetime import datetime
from pathlib import Path
from typing import BinaryIO, Final

from pdgw.ds301.counters import Counters
from pdgw.gateway.base.errors import writing

log = logging.getLogger("gateway")

CONFIGURATION: Final = "gateway.toml"
"""Beside captures: the configuration they were made with."""
CAPTURE: Final = "gateway.pcapng"
CAPTURE_SIZE: Final = 256 << 20
"""Bytes after which another capture begins."""
CAPTURES: Final = 20
"""Full ones that are kept."""
_POLL_S: Final = 0.25
END_S = 2.0
"""Longest time that the end of the gateway waits for unwritten data."""
_WAITS: Final = 20


def wait_for_end(thread: threading.Thread) -> None:
    """Two seconds in short waits: if the process itself is paused, the thread loses only one of them."""
    for _ in range(_WAITS):
        thread.join(END_S / _WAITS)
        if not thread.is_alive():
            return


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
        delete_oldest(self._folder, f"{self._path.stem}-*{self._path.suffix}", self._files)


def delete_oldest(folder: Path, pattern: str, kept: int) -> None:
    """Keep this number of the files of a pattern. OSError when one cannot be deleted."""
    for path in sorted(folder.glob(pattern), key=lambda path: path.stat().st_mtime_ns)[:-kept]:
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
