"""Parts of the ring as files: on request, and around a fault or a stop.

Parts of a ring as a pcapng file of both buses with the configuration, as `pdgw run --record` writes it. Save the ring around a
fault or a stop: a process beside the gateway that reads its ring and writes files. It does not delay the exchange, and it
continues after the end of the gateway.
"""

from __future__ import annotations

import contextlib
import gzip
import logging
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from pdgw.base.durations import SECOND
from pdgw.gateway.base.errors import GatewayError, writing
from pdgw.gateway.base.reasons import Enable, Reason
from pdgw.gateway.base.run_directory import PREVIOUS, rings, run_directory
from pdgw.gateway.configuration.defaults import Trigger
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.reader import Cycle, RingReader
from pdgw.tools.recording.recorder import delete_oldest


def chosen_ring(name: str | None, directory: Path | None = None) -> Path:
    """The ring of a path or a gateway's name; without one that of the only gateway that runs, else the only one there is.

    GatewayError lists what can be chosen.
    """
    if name is not None and (os.sep in name or Path(name).is_file()):
        return Path(name)
    found = rings(directory)
    if name is not None:
        fitting = [path for path in found if path.name.removesuffix(".ring") == name]
    else:
        fitting = [path for path in found if not path.name.endswith(PREVIOUS)]
        if len(fitting) > 1:
            fitting = [path for path in fitting if RingReader(path).is_alive] or fitting
    if len(fitting) == 1:
        return fitting[0]
    place = directory or run_directory() or "no run directory"
    names = ", ".join(path.name.removesuffix(".ring") for path in found) or "none"
    if name is not None:
        raise GatewayError(f"--ring {name}: not found, expected a path or one of these in {place}: {names}")
    why = "several ring files" if fitting else "no ring file of a gateway"
    raise GatewayError(f"{why}: give --ring a path or one of these in {place}: {names}")


_GZIP_LEVEL = 6
"""A higher level takes eight times as long for a twentieth of the size."""


def captured(ring: Path, seconds: float) -> bytes:
    """The last seconds of a ring as the bytes of such a file."""
    reader = RingReader(ring)
    newest = reader.cycles(at_most=1)
    return part_of(reader, newest[0].time_ns - int(seconds * SECOND) if newest else None)[0]


def save(reader: RingReader, path: Path, begin_ns: int | None = None, end_ns: int | None = None) -> int:
    """Write what a ring has between two monotonic times; the number of frames. GatewayError when the file cannot be written.

    The file begins up to a second earlier, where all values are recorded. A name with .gz: compressed by gzip.
    """
    data, count = part_of(reader, begin_ns, end_ns)
    if path.suffix == pcapng.GZIP:
        data = gzip.compress(data, _GZIP_LEVEL)
    with writing(path):
        path.write_bytes(data)
    return count


def part_of(reader: RingReader, begin_ns: int | None = None, end_ns: int | None = None) -> tuple[bytes, int]:
    """The bytes of a part and the number of its frames."""
    parts = [_part(file, begin_ns, end_ns) for file in reader.segments()]
    return b"".join(data for data, _ in parts), sum(count for _, count in parts)


class _Piece(NamedTuple):
    """The blocks of one cycle."""

    end: int
    """Place after it in the segment."""
    frames: int
    """Frames of the segment until then."""
    time_ns: int
    is_whole: bool


def _part(file: Path, begin_ns: int | None, end_ns: int | None) -> tuple[bytes, int]:
    data = file.read_bytes() if file.exists() else b""
    head, end, frames = 0, 0, 0
    pieces: list[_Piece] = []
    for kind, at, length in pcapng.walk(data):
        end = at + length
        cycle = pcapng.cycle_at(data, at) if kind == pcapng.CUSTOM else None
        if kind == pcapng.PACKET:
            frames += 1
        elif cycle is not None:
            pieces.append(_Piece(end, frames, cycle[0], bool(cycle[1] & pcapng.WHOLE)))
        elif not pieces and not frames:
            head = end
    first = max((n for n, piece in enumerate(pieces) if piece.is_whole and piece.time_ns <= (begin_ns or 0)), default=0)
    if pieces and begin_ns is not None and pieces[-1].time_ns < begin_ns:
        return b"", 0
    start, before = (pieces[first - 1].end, pieces[first - 1].frames) if first else (head, 0)
    if end_ns is not None:
        kept = [piece for piece in pieces if piece.time_ns <= end_ns]
        if not kept:
            return b"", 0
        end, frames = kept[-1].end, kept[-1].frames
    return data[:head] + data[start:end], frames - before


log = logging.getLogger("trace")

_SILENT_S = 1.0
"""After this time without a cycle, check whether the process still exists."""
_NOT_ASKED = frozenset(
    reason.name
    for reason in Reason
    if reason.enable in (Enable.PLC, Enable.CONTROL, Enable.NODE, Enable.NO_FAULT) or reason is Reason.NEEDS_OFF
)
"""Reasons that take the operation of an axis away without an OFF of the PLC."""


@dataclass(frozen=True)
class Choice:
    """What to save, and where. ``files``: maximum number; the oldest are deleted."""

    directory: Path
    triggers: frozenset[Trigger]
    before_s: int = 10
    after_s: int = 5
    files: int = 20


class Keeper:
    """Follows one ring; ``poll`` it about four times a second, or less often than the ring is long."""

    def __init__(self, reader: RingReader, choice: Choice) -> None:
        self._reader = reader
        self._choice = choice
        self._name = reader.layout.name
        self._seen = reader.newest_cycle
        """A stop that was already there is not reported."""
        self._last: Cycle | None = None
        self._pending: tuple[int, str] | None = None
        """When, and what happened first."""
        self.kept: list[Path] = []

    def poll(self) -> None:
        """Read new records; write the files that are due."""
        for cycle in self._reader.cycles(after=self._seen):
            self._seen = cycle.number
            last, self._last = self._last, cycle
            if last is not None and self._pending is None:
                what = self._happened(last, cycle)
                if what:
                    self._pending = cycle.time_ns, what
        pending, newest = self._pending, self._last
        if pending is None or newest is None:
            return
        if newest.time_ns >= pending[0] + self._choice.after_s * SECOND or self._reader.ended:
            self._keep(*pending)

    def ended(self) -> None:
        """The daemon has ended: save what is pending. An end without its stop sequence is a stop with its own file."""
        self.poll()
        if self._pending is not None:
            self._keep(*self._pending)
        if Trigger.STOP in self._choice.triggers and not self._reader.ended and self._last is not None:
            self._keep(self._last.time_ns, "killed")

    def _happened(self, last: Cycle, cycle: Cycle) -> str:
        reader = self._reader
        for place, item in enumerate(reader.layout.objects):
            faults = (reader.value(each, place, "decided", "faults") for each in (last, cycle))
            if Trigger.FAULT in self._choice.triggers and len(set(faults)) > 1:
                return f"fault-{item.kind}-{item.do_id}"
            if Trigger.STOP in self._choice.triggers and item.kind == "axis" and self._was_stopped(last, cycle, place):
                return f"stop-{item.kind}-{item.do_id}"
        return ""

    def _was_stopped(self, before: Cycle, now: Cycle, place: int) -> bool:
        return not self._reader.reason(before, place) and self._reader.reason(now, place) in _NOT_ASKED

    def _wall_ns(self, time_ns: int) -> int:
        offset = 0 if self._last is None else self._last.wall_ns - self._last.time_ns
        return time_ns + offset

    def _keep(self, time_ns: int, what: str) -> None:
        self._pending = None
        choice = self._choice
        moment = datetime.fromtimestamp(self._wall_ns(time_ns) / SECOND).strftime("%Y%m%d-%H%M%S")
        path = choice.directory / f"{self._name}-{moment}-{what}.pcapng"
        begin, end = time_ns - choice.before_s * SECOND, time_ns + choice.after_s * SECOND
        part = path.with_suffix(".part")
        try:
            choice.directory.mkdir(parents=True, exist_ok=True)
            # The file gets its name when it is complete.
            save(self._reader, part, begin, end)
            part.replace(path)
        except Exception as error:  # the next fault is still kept
            log.error("%s: not kept (%s)", path, error, exc_info=not isinstance(error, (OSError, GatewayError)))
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)  # an incomplete file would occupy the full disk
            return
        log.warning("%s: kept", path)
        self.kept.append(path)
        try:
            delete_oldest(choice.directory, f"{self._name}-*.pcapng", choice.files)
        except OSError as error:  # deleted by another process just now, or not deletable: try again the next time
            log.error("%s: old files could not be deleted (%s)", choice.directory, error)


def follow(path: Path, choice: Choice, wait: Callable[[float], bool], pause_s: float = 0.25) -> None:
    """Save the events of the ring at ``path``, also of those that replace it. ``wait`` sleeps this number of seconds; True:
    end requested."""
    while True:
        try:
            reader = RingReader(path)
        except GatewayError:
            if wait(pause_s):
                return
            continue  # no gateway yet, or between two gateways
        keeper = Keeper(reader, choice)
        asked = _follow_one(reader, keeper, wait, pause_s)
        if asked:
            return
        while not reader.replaced:
            if wait(pause_s):
                return


def _follow_one(reader: RingReader, keeper: Keeper, wait: Callable[[float], bool], pause_s: float) -> bool:
    """Follow until the daemon of this ring has ended, or until the end is requested (True)."""
    newest, silent = reader.newest_cycle, 0.0
    while True:
        asked = wait(pause_s)
        keeper.poll()
        silent = silent + pause_s if reader.newest_cycle == newest else 0.0
        newest = reader.newest_cycle
        if asked or reader.ended or reader.replaced or (silent >= _SILENT_S and not reader.is_alive):
            keeper.ended()
            return asked


def sleeping(seconds: float) -> bool:
    """``wait`` of a process that ends by a signal."""
    time.sleep(seconds)
    return False
