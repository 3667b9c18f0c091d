"""Motions of a simulated encoder: profiles, recordings, the position of another node on the bus, or a simulated shaft.

A motion is a function from nanoseconds since its start to the mechanical position, in revolutions (rotary encoder) or
millimetres (linear encoder). Any callable is accepted, for example one that reads a simulated drive of this process.
"""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from pdgw.base.durations import SECOND
from pdgw.ds301.bus.can_frame import STANDARD_ID
from pdgw.dsp406.kinds import Dsp406Error
from pdgw.peers.option_values import MOTIONS

Motion = Callable[[int], float]
NO_SHAFTS: Mapping[int, Motion] = MappingProxyType({})
LARGEST = 1e9
"""Limit of positions, speeds and times read from text."""


@dataclass(frozen=True, slots=True)
class Standstill:
    """No motion: an encoder needs to read it only once."""

    position: float

    def __call__(self, time: int) -> float:
        return self.position


def still(position: float = 0.0) -> Motion:
    """Standstill."""
    return Standstill(position)


def constant_speed(speed: float, start: float = 0.0) -> Motion:
    """``speed`` in revolutions or millimetres per second."""
    return lambda time: start + speed * time / SECOND


def sine(amplitude: float, period: float, centre: float = 0.0) -> Motion:
    """Oscillate around ``centre`` with a period of ``period`` seconds; Dsp406Error unless it is above 0."""
    if period <= 0:
        raise Dsp406Error("period of a sine motion", period, "above 0 s")
    return lambda time: centre + amplitude * math.sin(2 * math.pi * time / SECOND / period)


def points(path: Sequence[tuple[float, float]]) -> Motion:
    """Straight lines between (seconds, position), constant before the first and after the last point.

    Dsp406Error without points, for a number beyond ``LARGEST``, or for times that do not increase.
    """
    if not path:
        raise Dsp406Error("points of a motion", 0, "at least one")
    for before, point in zip((None, *path), path, strict=False):
        if not all(abs(number) <= LARGEST for number in point) or (before is not None and point[0] <= before[0]):
            raise Dsp406Error("point of a motion", point, f"numbers within +-{LARGEST:g}, each time after the last")
    times = [time for time, _ in path]

    def motion(time: int) -> float:
        seconds = time / SECOND
        number = bisect_right(times, seconds)
        if number == 0:
            return path[0][1]
        if number == len(path):
            return path[-1][1]
        (t0, p0), (t1, p1) = path[number - 1], path[number]
        return p0 + (p1 - p0) * (seconds - t0) / (t1 - t0)

    return motion


def recorded(file: Path) -> Motion:
    """Read a CSV file with time in seconds and position in its first two columns. A first line of names is skipped.

    Dsp406Error names file and line of an error.
    """
    try:
        rows = list(csv.reader(file.read_text(encoding="utf-8").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise Dsp406Error("recorded motion", str(file), f"a readable CSV file ({error})") from error
    path: list[tuple[float, float]] = []
    for number, row in enumerate(rows, 1):
        if not row:
            continue
        try:
            path.append((float(row[0]), float(row[1])))
        except (ValueError, IndexError):
            if number == 1:
                continue
            raise Dsp406Error(f"{file} line {number}", ",".join(row), "time in s and position") from None
    try:
        return points(path)
    except Dsp406Error as error:
        raise Dsp406Error(f"{file}: {error.field}", error.value, error.allowed) from error


class Follower:
    """The position that another node sends: a signed 32-bit value in one of its PDOs.

    ``cob_id`` (1..7FFh) and ``offset`` (byte, 0..4) locate the value. ``increments`` (magnitude 0.001..1e9): per revolution
    or millimetre. The position is 0 until the first frame. Dsp406Error for values out of range.
    """

    def __init__(self, cob_id: int, offset: int, increments: float) -> None:
        for what, value, valid, allowed in (
            ("COB-ID to follow", cob_id, 1 <= cob_id <= STANDARD_ID, "1..2047"),
            ("byte of the position to follow", offset, 0 <= offset <= 4, "0..4"),
            ("increments to follow", increments, 1e-3 <= abs(increments) <= LARGEST, "0.001..1e9 or negative"),
        ):
            if not valid:
                raise Dsp406Error(what, value, allowed)
        self._cob_id = cob_id
        self._offset = offset
        self._increments = increments
        self._position = 0.0

    def __call__(self, time: int) -> float:
        return self._position

    def receive(self, can_id: int, data: bytes) -> None:
        """Process a frame from the bus. Frames of other nodes and shorter ones have no effect."""
        value = data[self._offset : self._offset + 4]
        if can_id == self._cob_id and len(value) == 4:
            self._position = int.from_bytes(value, "little", signed=True) / self._increments


def _number(text: str) -> float:
    value = float(text)
    if not abs(value) <= LARGEST:
        raise ValueError(text)
    return value


def parse_motion(text: str, start: float = 0.0, shafts: Mapping[int, Motion] = NO_SHAFTS) -> Motion:
    """Parse a motion in one word: ``speed=1.5``, see ``MOTIONS``; Dsp406Error for anything else.

    Standstill, speed and sine start at ``start``. ``shafts``: those of the drives simulated in this process, by node-ID.
    """
    kind, _, rest = text.partition("=")
    values = rest.split(",") if rest else []
    try:
        match kind, values:
            case "still", []:
                return still(start)
            case "still", [position]:
                return still(_number(position))
            case "speed", [speed]:
                return constant_speed(_number(speed), start)
            case "sine", [amplitude, period]:
                return sine(_number(amplitude), _number(period), start)
            case "csv", [_, *_]:
                return recorded(Path(rest))
            case "follow", [cob_id, offset, increments]:
                return Follower(int(cob_id, 0), int(offset), _number(increments))
            case "shaft", [number]:
                node_id = int(number)
                if node_id in shafts:
                    return shafts[node_id]
                raise Dsp406Error(
                    "node whose shaft turns the encoder", node_id, f"a drive simulated beside it: {list(shafts)}"
                )
    except ValueError:
        pass
    raise Dsp406Error("motion", text, MOTIONS)
