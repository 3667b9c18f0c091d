"""Parts of a ring as a pcapng file of both buses with the configuration, as `pdgw run --record` writes it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from pdgw.durations import SECOND
from pdgw.gateway.errors import GatewayError, writing
from pdgw.gateway.trace import blocks
from pdgw.gateway.trace.place import PREVIOUS, rings, run_directory
from pdgw.gateway.trace.reader import RingReader, is_alive


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
            fitting = [path for path in fitting if _is_written(path)] or fitting
    if len(fitting) == 1:
        return fitting[0]
    place = directory or run_directory() or "no run directory"
    names = ", ".join(path.name.removesuffix(".ring") for path in found) or "none"
    if name is not None:
        raise GatewayError(f"--ring {name}: not found, expected a path or one of these in {place}: {names}")
    why = "several ring files" if fitting else "no ring file of a gateway"
    raise GatewayError(f"{why}: give --ring a path or one of these in {place}: {names}")


def _is_written(path: Path) -> bool:
    with RingReader(path) as reader:
        return is_alive(reader)


def captured(ring: Path, seconds: float) -> bytes:
    """The last seconds of a ring as the bytes of such a file."""
    with RingReader(ring) as reader:
        newest = reader.cycles(at_most=1)
        return part_of(reader, newest[0].time_ns - int(seconds * SECOND) if newest else None)[0]


def save(reader: RingReader, path: Path, begin_ns: int | None = None, end_ns: int | None = None) -> int:
    """Write what a ring has between two monotonic times; the number of frames. GatewayError when the file cannot be written.

    The file begins up to a second earlier, where all values are recorded.
    """
    data, count = part_of(reader, begin_ns, end_ns)
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
    for kind, at, length in blocks.walk(data):
        end = at + length
        cycle = blocks.cycle_at(data, at) if kind == blocks.CUSTOM else None
        if kind == blocks.PACKET:
            frames += 1
        elif cycle is not None:
            pieces.append(_Piece(end, frames, cycle[0], bool(cycle[1] & blocks.WHOLE)))
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
