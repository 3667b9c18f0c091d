"""Rows as a table of Apache Arrow, and as a Parquet file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from pdgw.decoder.view.columns import Row
from pdgw.decoder.view.names import Names
from pdgw.extras import missing
from pdgw.gateway.errors import GatewayError

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
