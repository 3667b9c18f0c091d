"""Captures as tables of Apache Arrow, Parquet files and data sets.

Many captures are one Parquet data set, partitioned by file and axis, in any number of processes or on a cluster:
``ROOT/file=<path, percent-encoded>/axis=<number, 0: of none>/part.parquet``.

``write_part`` is the whole work on one file: it takes and gives plain picklable values and needs nothing but the file and
the place to write to, so that a process pool, Dask or any other scheduler runs it. A part is complete or not there.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from pdgw.base.extras import missing
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.trace import pcapng
from pdgw.tools.decoder.capture.knowledge import Knowledge, known_beforehand, look_ahead
from pdgw.tools.decoder.capture.pcap import CaptureError, configuration_in
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.frames.engine import Decoder
from pdgw.tools.decoder.view.filter import Filter
from pdgw.tools.decoder.view.names import Names
from pdgw.tools.decoder.view.render import Columns, Row

if TYPE_CHECKING:
    import pyarrow


_ROWS_AT_ONCE: Final = 1 << 16


def _pyarrow(asked_by: str) -> Any:
    try:
        import pyarrow  # noqa: PLC0415
    except ImportError as error:
        raise GatewayError(missing("pyarrow", asked_by)) from error
    return pyarrow


def arrow_schema(titles: Sequence[str], names: Names, asked_by: str) -> Any:
    """``time_ns`` (integer) and a column for each title; GatewayError when pyarrow is not installed."""
    pyarrow = _pyarrow(asked_by)
    kinds = [pyarrow.string() if names.is_text(title) else pyarrow.float64() for title in titles]
    return pyarrow.schema([("time_ns", pyarrow.int64()), *zip(titles, kinds, strict=True)])


def arrow_table(schema: Any, rows: Sequence[tuple[int, Row]]) -> Any:
    """Rows with their times as a table."""
    pyarrow = _pyarrow("a table")
    columns = [pyarrow.array([time_ns for time_ns, _ in rows], pyarrow.int64())]
    for position, field in enumerate(list(schema)[1:]):
        values: list[Any] = [row[position] for _, row in rows]
        if field.type == pyarrow.float64():
            values = [None if value is None else float(value) for value in values]
        columns.append(pyarrow.array(values, field.type))
    return pyarrow.Table.from_arrays(columns, schema=schema)


class ParquetTable:
    """A file with the columns of ``arrow_schema``; GatewayError when pyarrow is not there or the file not writable."""

    def __init__(self, path: Path, titles: Sequence[str], names: Names) -> None:
        self.rows = 0
        self._schema = arrow_schema(titles, names, "--parquet")
        self._waiting: list[tuple[int, Row]] = []
        try:
            from pyarrow import parquet  # noqa: PLC0415

            self._file = parquet.ParquetWriter(str(path), self._schema)
        except OSError as error:
            raise GatewayError(f"--parquet {path}: cannot be written ({error})") from error

    def add(self, rows: Iterable[tuple[int, Row]]) -> None:
        """Rows with their times."""
        self._waiting += rows
        if len(self._waiting) >= _ROWS_AT_ONCE:
            self._flush()

    def _flush(self) -> None:
        rows, self._waiting = self._waiting, []
        self.rows += len(rows)
        self._file.write_table(arrow_table(self._schema, rows))

    def close(self) -> None:
        """Everything is in the file afterwards."""
        self._flush()
        self._file.close()


ENDINGS: Final = frozenset((".pcap", ".pcapng", ".log", ".asc", ".blf", ".trc", ".csv", ".mf4", ".db"))
"""Suffixes of the files in a folder that count as captures, also compressed."""
_SINGLE: Final = ".parquet"
_UNFINISHED: Final = ".unfinished"


@dataclass(frozen=True, slots=True)
class ArchiveOptions:
    """Columns and options for each file; ``signals`` are the columns, the others as in ``pdgw decode``."""

    signals: tuple[str, ...]
    telegrams: tuple[int, ...] = ()
    config: Path | None = None
    eds: tuple[str, ...] = ()
    filter_text: str | None = None

    def knowledge(self, embedded: str = "") -> Knowledge:
        """Known facts, with the configuration ``embedded`` in a capture; GatewayError or ProfidriveError if something cannot
        be used."""
        known = known_beforehand(self.telegrams, self.config, self.eds, embedded=embedded)
        if not self.signals:
            raise GatewayError("--parquet: name the signals of the table, like --signal NSOLL_A --signal NIST_A")
        for name in self.signals:
            known.names.split(name)
        if self.filter_text is not None:
            Filter(self.filter_text, known.names)
        return known


@dataclass(frozen=True, slots=True)
class Part:
    """Result for one file: its rows by axis; ``error`` when it is damaged, with everything before the damage written."""

    file: str
    axes: dict[int, int]
    notices: tuple[str, ...] = ()
    error: str = ""

    @property
    def rows(self) -> int:
        return sum(self.axes.values())


def is_data_set(path: Path) -> bool:
    """Whether ``--parquet`` means a folder."""
    return path.is_dir() or path.suffix.lower() != _SINGLE


def _ending(path: Path) -> str:
    return Path(path.name.lower().removesuffix(pcapng.GZIP)).suffix


def captures_of(paths: Sequence[str]) -> list[str]:
    """The files, and those in the folders among them, each once; GatewayError when there are none."""
    found: dict[str, None] = {}
    for text in paths:
        path = Path(text)
        inside = sorted(item for item in path.rglob("*") if _ending(item) in ENDINGS and item.is_file())
        found |= dict.fromkeys(str(item) for item in (inside if path.is_dir() else [path]))
    if not found:
        raise GatewayError(
            f"{', '.join(paths)}: no captures, expected files that end with {', '.join(sorted(ENDINGS))}"
        )
    return list(found)


def write_data_set(files: Sequence[str], root: Path, options: ArchiveOptions) -> Iterator[Part]:
    """Write the parts of all files, one for each core at a time; results come in the order of the files."""
    options.knowledge()
    root.mkdir(parents=True, exist_ok=True)
    jobs = min(os.cpu_count() or 1, len(files))
    work = partial(write_part, root=root, options=options)
    if jobs == 1:
        yield from map(work, files)
        return
    from concurrent.futures import ProcessPoolExecutor  # noqa: PLC0415 (slow to load, and for several files only)

    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(work, files)


def _known(file: str, options: ArchiveOptions) -> tuple[Knowledge, str]:
    """Known facts of a file and notes for the user; without other options from its embedded configuration."""
    embedded = configuration_in(Path(file)) if options.config is None and not options.telegrams else ""
    if not embedded:
        return options.knowledge(), ""
    try:
        return options.knowledge(embedded), "the configuration of the gateway is read from the capture"
    except GatewayError as error:
        return options.knowledge(), f"the configuration in the capture is ignored: {error}"


def read_table(path: str | os.PathLike[str], signals: Sequence[str], telegrams: Sequence[int] = ()) -> pyarrow.Table:
    """Read signals of a capture of either bus: ``time_ns``, ``axis``, ``node``, then a column for each signal.

    ``signals``: names as in ``pdgw decode --signal``, such as ``NIST_A`` or ``ZSW1.FAULT``. The metadata of a column's field has
    its unit: ``table.field("NIST_A").metadata[b"unit"]``. ``telegrams``: those of the axes in the order of the frame; without
    them from the configuration in the capture, else inferred. Raises CaptureError for a file that cannot be opened, has an
    unknown format or ends early, ProfidriveError for an unknown name, GatewayError without pyarrow or signals.
    """
    if not signals:
        raise GatewayError("signals: none is given; name at least one, such as NIST_A")
    file = os.fspath(path)
    known, _ = _known(file, ArchiveOptions(tuple(signals), tuple(telegrams)))
    columns = Columns(["axis", "node", *signals], known.names)
    schema = arrow_schema(columns.titles, known.names, "read_table")
    decoder = Decoder(look_ahead(file, known.settings)[0])
    layouts, rows = {}, []
    with open_source(file) as source:
        for packet in source.packets:
            record = decoder.decode(packet)
            for unit, row in columns.rows(record):
                rows.append((record.time_ns, row))
                if unit is not None:
                    layouts[id(unit.layout)] = unit.layout
    units = {field.identifier: field.unit for layout in layouts.values() for field in layout.fields}
    for position, title in enumerate(columns.titles, 1):
        name, part = known.names.split(title)
        schema = schema.set(
            position, schema.field(position).with_metadata({"unit": "" if part else units.get(name, "")})
        )
    return arrow_table(schema, rows)


def write_part(file: str, root: Path, options: ArchiveOptions) -> Part:
    """Decode one file into its part of the data set, in place of an older one. Never raises for what a file contains."""
    known, notice = _known(file, options)
    settings, _, inference = look_ahead(file, known.settings)
    decoder = Decoder(settings)
    notices = dict.fromkeys(text for text in (notice, inference) if text)
    chosen = [name for name in options.signals if name.lower() not in {"axis", "node", "time"}]
    columns = Columns(["axis", "node", *chosen], known.names)
    selection = Filter(options.filter_text, known.names) if options.filter_text is not None else None
    folder = root / f"file={quote(file.lstrip('/'), safe='')}"
    unfinished = folder.with_name(folder.name + _UNFINISHED)
    shutil.rmtree(unfinished, ignore_errors=True)
    tables: dict[int, ParquetTable] = {}
    error = ""
    try:
        with open_source(file) as source:
            for packet in source.packets:
                record = decoder.decode(packet)
                units = selection.select(record) if selection is not None else record.units
                if units is None:
                    continue
                for _, row in columns.rows(record) if selection is None else columns.unit_rows(record, units):
                    axis = int(row[0] or 0)
                    table = tables.get(axis)
                    if table is None:
                        place = unfinished / f"axis={axis}"
                        place.mkdir(parents=True)
                        table = tables[axis] = ParquetTable(place / "part.parquet", columns.titles[1:], known.names)
                    table.add([(record.time_ns, row[1:])])
            notices |= dict.fromkeys(source.notices)
    except CaptureError as damage:
        error = str(damage)
    finally:
        for table in tables.values():
            table.close()
    shutil.rmtree(folder, ignore_errors=True)
    if tables:
        unfinished.rename(folder)
    notices |= dict.fromkeys(decoder.notices)
    return Part(file, {axis: table.rows for axis, table in tables.items()}, tuple(notices), error)
