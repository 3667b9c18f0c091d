"""The trend of a drive object: columns from the flight recorder's ring, at cycle rate or smallest and largest value of each bin.

The ring is read, never held up. Values are scaled here: speeds to rpm where the gateway knows what 100 % is, else percent.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pdgw.base.durations import SECOND
from pdgw.dsp402.drive_type import Quantity
from pdgw.gateway.axis.settings import quantity_of
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.trace.pcapng import TracedObject
from pdgw.gateway.trace.reader import Cycle, RingReader
from pdgw.profidrive.signal_text import Rated, scale
from pdgw.profidrive.signals import Signal, SignalQuantity
from pdgw.profidrive.telegrams import ApplicationMode, Telegram
from pdgw.tools.web.status.feed import Document
from pdgw.tools.web.support import RequestError

SECONDS_MAX = 600
BINS_MAX = 5000
_LIVE_BIN_S = 0.02
_LIVE_MAX_S = 2.0
"""A stream that was not served for longer has a gap."""
_RETRY_TICKS = 10
"""Ticks after which a ring that cannot be read is opened again."""
Column = list[float | None]
Value = Callable[[Cycle], float | None]


@dataclass(frozen=True, slots=True)
class Curve:
    """One line of a trend; ``label`` for people, ``name`` as the interface takes it."""

    name: str
    label: str
    unit: str
    of: Value

    def document(self) -> Document:
        """Without its function."""
        return {"name": self.name, "label": self.label, "unit": self.unit}


def curves(reader: RingReader, number: int, item: Document) -> dict[str, Curve]:
    """Every curve of drive object ``number`` of the ring by its name; ``item``: the object in the status, for its scaling."""
    traced = reader.layout.objects[number]
    chosen = traced.chosen
    found = [*_signals(reader, number, chosen, item), *_device(reader, number, traced, item)]
    return {curve.name: curve for curve in found}


def _signals(reader: RingReader, number: int, chosen: Telegram, item: Document) -> Iterator[Curve]:
    def actuals(cycle: Cycle, number: int) -> Sequence[int] | None:
        """None while the device is lost: the PLC receives its last values, marked as bad."""
        return reader.actuals(cycle, number) if reader.value(cycle, number, "decided", "good") else None

    for half, get in ((chosen.setpoints, reader.setpoints), (chosen.actuals, actuals)):
        for place, signal in enumerate(half.signals):
            if signal.bits:
                continue
            factor, unit = scale(
                signal, Rated(item["rated_speed"], item["rated_speed_unit"]) if item["rated_speed"] else None
            )

            def value(
                cycle: Cycle, place: int = place, get: Any = get, signal: Signal = signal, factor: float = factor
            ) -> float | None:
                values = get(cycle, number)
                return None if values is None else signal.value_of(values[place]) * factor

            yield Curve(signal.name, signal.name, unit, value)


def _device(reader: RingReader, number: int, traced: TracedObject, item: Document) -> Iterator[Curve]:
    def feedback(name: str, factor: float) -> Value:
        def value(cycle: Cycle) -> float | None:
            """None while the drive does not send it: the curve ends."""
            if not reader.value(cycle, number, "flags", "drive_ok"):
                return None
            return (reader.value(cycle, number, "feedback", name) or 0) * factor

        return value

    if traced.place("feedback", "velocity_actual") is not None:
        per_rpm = item.get("velocity_per_rpm")
        factor, unit = (1 / per_rpm, "rpm") if per_rpm else (1.0, "velocity units")
        yield Curve("velocity", "Drive's speed", unit, feedback("velocity_actual", factor))
    if traced.place("feedback", "position_actual") is not None:
        unit = item.get("position_unit") or "position units"
        yield Curve("position", "Drive's position", unit, feedback("position_actual", 1.0))


def usual(found: dict[str, Curve], chosen: Telegram) -> list[str]:
    """Actual value and setpoint of the speed, with a positioning telegram of the position, where the telegram has both; else what
    the device reports, else what is sent. The page draws the last one on top.
    """
    positioning = chosen.mode is ApplicationMode.POSITIONING

    def shown(item: Signal) -> bool:
        return item.quantity is SignalQuantity.POSITION if positioning else quantity_of(item) is Quantity.SPEED

    halves = (chosen.actuals, chosen.setpoints)
    pair = [next((item.name for item in half.signals if shown(item)), None) for half in halves]
    if None not in pair:
        return [name for name in pair if name is not None]
    preferred = ("velocity", "position", "NIST_B", "NIST_A", "G1_XIST1")
    return [name for name in found if name in preferred][:2]


def columns(cycles: Sequence[Cycle], chosen: Sequence[Curve]) -> list[Column]:
    """A column for each curve."""
    return [[curve.of(cycle) for cycle in cycles] for curve in chosen]


def binned(times: Sequence[float], values: Sequence[Column], bin_s: float) -> tuple[list[float], list[Column]]:
    """Smallest and largest value of each bin: two points where they differ in any column, so that no peak is lost.

    A bin without any value of a column has None there.
    """
    new_times: list[float] = []
    new_values: list[Column] = [[] for _ in values]
    begin = 0
    while begin < len(times):
        end, place = begin, math.floor(times[begin] / bin_s)
        while end < len(times) and math.floor(times[end] / bin_s) == place:
            end += 1
        pairs = [_extremes(column[begin:end]) for column in values]
        flat = all(first == second for first, second in pairs)
        for half in range(1 if flat else 2):
            new_times.append(times[begin] if half == 0 else max(times[end - 1], math.nextafter(times[begin], math.inf)))
            for column, pair in zip(new_values, pairs, strict=True):
                column.append(pair[half])
        begin = end
    return new_times, new_values


def _extremes(column: Column) -> tuple[float | None, float | None]:
    """Smallest and largest value in the order in which they came."""
    known = [(value, place) for place, value in enumerate(column) if value is not None]
    if not known:
        return None, None
    low, high = min(known), max(known, key=lambda item: item[0])
    return (low[0], high[0]) if low[1] <= high[1] else (high[0], low[0])


class Traces:
    """The ring of a gateway. A reader belongs to one thread: ``live`` keeps one, ``history`` opens its own.

    ``status``: the newest status; its ``trace`` has the path. GatewayError when there is no ring or no such drive object.
    """

    def __init__(self, status: Callable[[], Document]) -> None:
        self._status = status
        self._reader: RingReader | None = None
        self._live: dict[int, _Live] = {}

    @property
    def path(self) -> Path:
        """The ring that is written now, or was last."""
        path = self._status().get("trace")
        if not path:
            raise GatewayError("the gateway has no flight recorder; set [trace] enabled and a directory in RAM")
        return Path(path)

    def _follow(self) -> RingReader:
        """The reader of ``live``, a new one when the daemon has made a new ring."""
        path = self.path
        if self._reader is None or self._reader.path != path or self._reader.replaced:
            self._reader = RingReader(path)
        return self._reader

    def item(self, reader: RingReader, do_id: int) -> tuple[int, Document]:
        """Number of a drive object in the ring, and its part of the status."""
        status = self._status()
        items = {item["do_id"]: item for item in (*status["axes"], *status["encoders"])}
        for number, traced in enumerate(reader.layout.objects):
            if traced.do_id == do_id and do_id in items:
                return number, items[do_id]
        raise GatewayError(f"do_id {do_id}: the flight recorder has no drive object with this number")

    def chosen(self, reader: RingReader, do_id: int, names: Sequence[str]) -> list[Curve]:
        """The curves with these names, or the usual ones; RequestError names one that does not exist."""
        number, item = self.item(reader, do_id)
        found = curves(reader, number, item)
        unknown = [name for name in names if name not in found]
        if unknown:
            raise RequestError("signals", f"signals {', '.join(unknown)}: unknown, allowed: {', '.join(found)}")
        return [found[name] for name in names or usual(found, reader.layout.objects[number].chosen)]

    def history(self, do_id: int, seconds: float, names: Sequence[str], bins: int | None) -> Document:
        """The last ``seconds`` as far as the ring has them, on any thread."""
        reader = RingReader(self.path)
        chosen = self.chosen(reader, do_id, names)
        newest = reader.cycles(at_most=1)
        times: list[float] = []
        values: list[Column] = [[] for _ in chosen]
        if newest:
            begin = newest[0].time_ns - int(seconds * SECOND)
            at_most = max(1, int(seconds * SECOND / reader.layout.cycle_ns * 2))
            for part in _parts(reader, max(0, newest[0].number - at_most), newest[0].number):
                kept = [cycle for cycle in part if cycle.time_ns >= begin]
                times += [cycle.wall_ns / SECOND for cycle in kept]
                for column, more in zip(values, columns(kept, chosen), strict=True):
                    column.extend(more)
        if bins is not None and len(times) > 2 * bins:
            times, values = binned(times, values, seconds / bins)
        return _document(do_id, chosen, times, values)

    def live(self, do_id: int, tick: int) -> bytes:
        """New samples since the last tick as an event, the same for all streams, or why there are none; empty without news.

        Called on one thread. It raises nothing, because the status of the stream must not end with the trend.
        """
        known = self._live.get(do_id)
        if known is None or tick >= known.due:
            try:
                known = self._next(do_id, tick + 1, known)
            except Exception as error:  # another process writes the ring
                self._reader = None
                known = _Live(None, tick + _RETRY_TICKS, 0, _message({"do_id": do_id, "error": str(error)}))
            self._live[do_id] = known
        return known.message

    def _next(self, do_id: int, due: int, known: _Live | None) -> _Live:
        reader = self._follow()
        chosen = self.chosen(reader, do_id, ())
        newest = reader.newest_cycle
        after = known.after if known is not None and known.reader is reader else newest
        cycles = reader.cycles(after, int(_LIVE_MAX_S * SECOND / reader.layout.cycle_ns))
        if not cycles:
            return _Live(reader, due, after, b"")
        times = [cycle.wall_ns / SECOND for cycle in cycles]
        document = _document(do_id, chosen, *binned(times, columns(cycles, chosen), _LIVE_BIN_S))
        return _Live(reader, due, cycles[-1].number, _message(document))


@dataclass(frozen=True, slots=True)
class _Live:
    """The last samples sent to the streams of a drive object."""

    reader: RingReader | None
    due: int
    """The tick from which newer ones are read."""
    after: int
    message: bytes


def _message(document: Document) -> bytes:
    return b"event: trace\ndata: " + json.dumps(document).encode() + b"\n\n"


def _parts(reader: RingReader, after: int, last: int) -> Iterator[list[Cycle]]:
    """The cycles after ``after`` in pieces: other threads run between them, and only one piece is in memory."""
    while after < last:
        upto = min(after + 2000, last)
        yield reader.cycles(after, upto=upto)
        after = upto


def csv_text(document: Document) -> str:
    """The columns for a spreadsheet: seconds since 1970, then each signal."""
    head = [
        "time_s",
        *(f"{item['name']} ({item['unit']})" if item["unit"] else item["name"] for item in document["signals"]),
    ]
    made = io.StringIO()
    writer = csv.writer(made, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(zip(document["time"], *document["values"], strict=True))
    return made.getvalue()


def _document(do_id: int, chosen: Sequence[Curve], times: list[float], values: list[Column]) -> Document:
    return {
        "do_id": do_id,
        "signals": [curve.document() for curve in chosen],
        "time": [round(moment, 4) for moment in times],
        "values": [[None if value is None else round(value, 4) for value in column] for column in values],
    }
