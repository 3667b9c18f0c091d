"""Outputs of decoded packets: text, JSON lines, CSV, Parquet, statistics.

Every writer gets the packets one by one and stores none.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Protocol, TextIO

from pdgw.base.durations import SECOND, US
from pdgw.gateway.base.errors import GatewayError
from pdgw.tools.decoder.export.archive import ParquetTable
from pdgw.tools.decoder.frames.canopen.can_records import (
    CanRecord,
    EmcyRecord,
    HeartbeatRecord,
    NmtRecord,
    PdoRecord,
    SdoRecord,
)
from pdgw.tools.decoder.frames.records import AcyclicRecord, BusKind, ProcessData, Record
from pdgw.tools.decoder.view.names import Names
from pdgw.tools.decoder.view.render import Columns, line_parts, record_line, record_tree
from pdgw.tools.decoder.view.statistics import Statistics

Units = tuple[ProcessData, ...] | None
"""The units to show; None for all there are."""


class Writer(Protocol):
    """Write packets; ``finish`` is called once, also after an error in the capture."""

    def take(self, record: Record, units: Units) -> None: ...

    def finish(self) -> None: ...


_RESET: Final = "\x1b[0m"
_DIM: Final = "\x1b[2m"
_RED, _GREEN, _YELLOW, _BLUE, _MAGENTA, _CYAN = (f"\x1b[{code}m" for code in range(31, 37))


def _colour(record: Record) -> str:
    if isinstance(record, EmcyRecord) or (isinstance(record, SdoRecord) and record.abort is not None):
        return _RED
    if isinstance(record, NmtRecord) or (isinstance(record, HeartbeatRecord) and record.changed):
        return _YELLOW
    if isinstance(record, SdoRecord | AcyclicRecord):
        return _MAGENTA
    if isinstance(record, PdoRecord):
        return _GREEN
    if isinstance(record, CanRecord):
        return _BLUE
    return _CYAN


class TextWriter:
    """One line for each packet, with ``verbose`` the tree below it."""

    def __init__(self, out: TextIO, *, colour: bool = False, verbose: bool = False) -> None:
        self._out = out
        self._plain = not colour
        self._verbose = verbose
        self.zero_ns: int | None = None
        """The time lines count from; the first packet's unless set before."""

    def take(self, record: Record, units: Units) -> None:
        zero = self.zero_ns
        if zero is None:
            zero = self.zero_ns = record.time_ns
        if self._plain:
            self._out.write(record_line(record, zero, units) + "\n")
        else:
            source, text, values = line_parts(record, units)
            seconds = (record.time_ns - zero) / SECOND
            said = " | ".join(part for part in (text, values) if part)
            head = f"{_DIM}{record.number:6d} {seconds:12.6f}{_RESET}"
            self._out.write(f"{head} {record.bus.value} {_colour(record)}{source:<7}{_RESET} {said}\n")
        if self._verbose:
            for line in record_tree(record, units):
                self._out.write(line + "\n")

    def finish(self) -> None:
        self._out.flush()


class JsonWriter:
    """One object on each line."""

    def __init__(self, out: TextIO) -> None:
        self._out = out

    def take(self, record: Record, units: Units) -> None:
        self._out.write(json.dumps(record.document(units)) + "\n")

    def finish(self) -> None:
        self._out.flush()


_LEADING: Final = ("axis", "node")
"""Columns of every table after the time."""


def _table(titles: Sequence[str], names: Names) -> Columns:
    chosen = [title for title in titles if title.lower() not in {*_LEADING, "time"}]
    return Columns([*_LEADING, *chosen], names)


class CsvWriter:
    """A table: time in seconds, axis, node, then the chosen names."""

    def __init__(self, out: TextIO, titles: Sequence[str], names: Names) -> None:
        self._out = out
        self._columns = _table(titles, names)
        self._write = csv.writer(out, lineterminator="\n").writerow
        self._write(["time", *self._columns.titles])

    def take(self, record: Record, units: Units) -> None:
        rows = self._columns.rows(record) if units is None else self._columns.unit_rows(record, units)
        for _, row in rows:
            seconds, rest = divmod(record.time_ns, SECOND)
            self._write([f"{seconds}.{rest:09d}", *row])

    def finish(self) -> None:
        self._out.flush()


class ParquetWriter:
    """The table of ``CsvWriter`` as a Parquet file; GatewayError when pyarrow is not installed or the file not writable."""

    def __init__(self, path: Path, titles: Sequence[str], names: Names) -> None:
        if not titles:
            raise GatewayError("--parquet: name the signals of the table, like --signal NSOLL_A --signal NIST_A")
        self._columns = _table(titles, names)
        self._file = ParquetTable(path, self._columns.titles, names)

    def take(self, record: Record, units: Units) -> None:
        rows = self._columns.rows(record) if units is None else self._columns.unit_rows(record, units)
        self._file.add((record.time_ns, row) for _, row in rows)

    def finish(self) -> None:
        self._file.close()


class StatsWriter:
    """Statistics of everything shown, printed at the end as tables or as one JSON object."""

    def __init__(self, out: TextIO, bitrate: int, *, as_json: bool) -> None:
        self._out = out
        self._bitrate = bitrate
        self._json = as_json
        self._statistics = Statistics()

    def take(self, record: Record, _units: Units) -> None:
        self._statistics.add(record)

    def finish(self) -> None:
        if self._json:
            self._out.write(json.dumps(self._statistics.document(self._bitrate)) + "\n")
            self._out.flush()
            return
        for line in _stats_lines(self._statistics, self._bitrate):
            self._out.write(line + "\n")
        self._out.flush()


def _stats_lines(statistics: Statistics, bitrate: int) -> list[str]:
    lines = [f"{statistics.packets} packets in {statistics.seconds:.6f} s"]
    plc = [stream for stream in statistics.streams if stream.bus == BusKind.PLC]
    can = [stream for stream in statistics.streams if stream.bus == BusKind.CAN]
    head = (
        f"{'':8} {'':18} {'packets':>8} {'rate/s':>9} {'mean us':>10} {'jitter us':>10} {'min us':>10} {'max us':>10}"
    )
    for title, streams in (("PLC", plc), ("CAN", can)):
        if not streams:
            continue
        extra = "   step us   gaps missing  stale" if title == "PLC" else f"   load at {bitrate} bit/s"
        lines += ["", title, head + extra]
        for stream in streams:
            i = stream.intervals
            line = (
                f"{stream.identifier:8} {stream.name:18.18} {stream.count:8d} {stream.rate:9.1f} {i.mean / US:10.1f} "
                f"{i.deviation / US:10.1f} {i.shortest / US:10.1f} {i.longest / US:10.1f}"
            )
            document = stream.document()
            if document.get("counter_step_us") is not None:
                line += (
                    f" {document['counter_step_us']:9.1f} {document['counter_gaps']:6d} "
                    f"{document['missing_frames']:7d} {document['stale_frames']:6d}"
                )
            if stream.bits:
                low, high = statistics.load(stream, bitrate)
                line += f"   {low:7.2%} to {high:.2%}"
            lines.append(line)
    for channel in sorted({stream.channel for stream in can}):
        loads = [statistics.load(stream, bitrate) for stream in can if stream.channel == channel]
        low, high = (sum(load[i] for load in loads) for i in (0, 1))
        lines.append(f"bus load {channel}: {low:.2%} to {high:.2%}".replace(" :", ":"))
    return lines
