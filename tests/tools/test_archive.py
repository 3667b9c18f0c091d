"""Many captures as one data set: every row of every file, in any number of processes, with DuckDB and on Dask."""

from __future__ import annotations

import os
import pickle
import runpy
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import typer

import pdgw
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.file import config_text, simulated
from pdgw.profidrive.errors import ProfidriveError
from pdgw.tools.commands.capture.decode import decode
from pdgw.tools.decoder.export.archive import ArchiveOptions, Part, captures_of, is_data_set, write_part
from pdgw.tools.decoder.frames.records import LinkType
from tests.support.readers import captures
from tests.support.readers.ethernet_capture import PcapngWriter

pyarrow = pytest.importorskip("pyarrow", reason="the extra archive is not installed")
EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
PACKETS = captures.both_buses()
SIGNALS = ["NSOLL_A", "NIST_A", "ZSW1.FAULT"]


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    """A folder with captures in two days' folders, and something that is none."""
    for day, name in (("monday", "a.pcapng"), ("monday", "b.pcapng"), ("tuesday", "a.pcapng")):
        folder = tmp_path / "plant" / day
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(captures.pcapng(PACKETS))
    (tmp_path / "plant" / "notes.txt").write_text("no capture")
    return tmp_path / "plant"


@pytest.mark.parametrize(
    ("text", "axis", "told"),
    [
        (
            config_text(simulated([1])).replace("do_id = 1", "do_id = 7"),
            7,
            "the configuration of the gateway is read from",
        ),
        ("[can]\n", 1, "the configuration in the capture is ignored"),
    ],
)
def test_a_capture_with_its_configuration_is_known_by_it(tmp_path: Path, text: str, axis: int, told: str) -> None:
    path = tmp_path / "x.pcapng"
    writer = PcapngWriter(path, text)
    for time_ns, link, data in PACKETS:
        writer.write(LinkType(link), "plc" if link == captures.ETHERNET else "can0", time_ns, data)
    writer.close()
    part = write_part(str(path), tmp_path / "set", ArchiveOptions(("NSOLL_A",)))
    assert not part.error
    assert axis in part.axes
    assert part.notices[0].startswith(told)


def test_signals_of_a_capture_are_a_table_with_units(plant: Path) -> None:
    file = plant / "monday" / "a.pcapng"
    table = pdgw.read_table(file, SIGNALS, telegrams=[1])
    assert table.column_names == ["time_ns", "axis", "node", *SIGNALS]
    assert [table.field(name).metadata[b"unit"] for name in SIGNALS] == [b"%", b"%", b""]
    expected = [
        (record.time_ns, field.value(raw))
        for record in pdgw.read_records(file, [1])
        for unit in record.units
        for field, raw in unit.items()
        if field.name == "NIST_A"
    ]
    times, speeds = table["time_ns"].to_pylist(), table["NIST_A"].to_pylist()
    assert [(time, speed) for time, speed in zip(times, speeds, strict=True) if speed is not None] == expected
    with pytest.raises(GatewayError, match="name at least one"):
        pdgw.read_table(file, [])
    with pytest.raises(ProfidriveError, match="nist_a"):
        pdgw.read_table(file, ["NIST_X"])


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)


def rows(root: Path) -> list[dict[str, Any]]:
    import pyarrow.dataset  # noqa: PLC0415

    found: list[dict[str, Any]] = pyarrow.dataset.dataset(root, partitioning="hive").to_table().to_pylist()
    return found


def test_every_file_is_a_part(plant: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "set"
    decode([str(plant)], parquet=out, signal=SIGNALS, telegram=[1])
    found = rows(out)
    counts = Counter(row["file"] for row in found)
    assert len(counts) == 3
    assert set(counts.values()) == {8}
    assert {row["axis"] for row in found} == {1}
    setpoints = [row["NSOLL_A"] for row in found if row["NSOLL_A"] is not None and row["file"] == found[0]["file"]]
    assert setpoints == [pytest.approx(i * 100 * 100 / 16384) for i in range(4)]
    assert f"{out}: 24 rows from 3 files in " in capsys.readouterr().out


def test_part_is_rewritten_completely(plant: Path, tmp_path: Path) -> None:
    file = captures_of([str(plant)])[0]
    options = ArchiveOptions(tuple(SIGNALS), (1,))
    first = write_part(file, tmp_path, options)
    assert write_part(file, tmp_path, options) == first
    assert first.axes == {1: 8}
    assert not list(tmp_path.rglob("*unfinished*"))
    assert len(rows(next(tmp_path.glob("file=*")))) == 8


def test_work_on_a_file_can_be_distributed(plant: Path, tmp_path: Path) -> None:
    options = pickle.loads(pickle.dumps(ArchiveOptions(("NSOLL_A",), (1,), filter_text="nsoll_a > 0")))
    part = pickle.loads(pickle.dumps(write_part(captures_of([str(plant)])[0], tmp_path, options)))
    assert isinstance(part, Part)
    assert part.rows == 3


def test_damaged_file_is_reported_and_keeps_the_data_before_it(
    plant: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = captures.pcapng(PACKETS)
    (plant / "monday" / "b.pcapng").write_bytes(data[:-30])
    (plant / "monday" / "a.pcapng").write_bytes(b"")
    with pytest.raises(typer.Exit) as left:
        decode([str(plant)], parquet=tmp_path / "set", signal=SIGNALS, telegram=[1])
    assert left.value.exit_code == 1
    told = capsys.readouterr()
    assert [line.split(": ")[0] for line in told.err.splitlines()] == ["error", "error"]
    assert "16 rows from 3 files, 2 damaged" in told.out


def test_impossible_options_are_rejected_before_reading(plant: Path, tmp_path: Path) -> None:
    out = tmp_path / "set"
    assert is_data_set(out)
    assert not is_data_set(tmp_path / "one.parquet")
    for options, match in (
        ({"parquet": out}, "name the signals"),
        ({"parquet": out, "signal": ["STW1"], "csv": "STW1"}, r"--csv: not allowed with --parquet FOLDER"),
        ({}, "several files need --parquet FOLDER"),
    ):
        with pytest.raises(GatewayError, match=match):
            decode([str(plant)], **options)  # type: ignore[arg-type]
    with pytest.raises(ProfidriveError, match="nope"):
        decode([str(plant)], parquet=out, signal=["nope"])
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(GatewayError, match="no captures"):
        captures_of([str(empty)])
    assert not out.exists()


def test_duckdb_queries_the_data_set(
    plant: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("duckdb", reason="the extra archive is not installed")
    decode([str(plant)], parquet=tmp_path / "set", signal=SIGNALS, telegram=[1])
    capsys.readouterr()
    monkeypatch.setattr(sys, "argv", ["archive_duckdb.py", str(tmp_path / "set")])
    runpy.run_path(str(EXAMPLES / "archive_duckdb.py"), run_name="__main__")
    lines = [line.split("\t") for line in capsys.readouterr().out.splitlines()]
    assert [line[0].rsplit("plant/", 1)[1] for line in lines] == [
        "monday/a.pcapng",
        "monday/b.pcapng",
        "tuesday/a.pcapng",
    ]
    fastest = max(abs(row["NIST_A"] or 0) for row in rows(tmp_path / "set"))
    assert {(line[1], float(line[3]), line[4]) for line in lines} == {("1", round(fastest, 2), "0")}


@pytest.mark.e2e
def test_several_processes_and_dask_workers_write_the_same_data_set(
    plant: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("dask.distributed", reason="the extra archive is not installed")
    command = [sys.executable, str(EXAMPLES / "archive_dask.py"), str(plant), str(tmp_path / "dask")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    assert sorted(line.split("\t")[1:] for line in done.stdout.splitlines()) == [["8", "ok"]] * 3
    decode([str(plant)], parquet=tmp_path / "set", signal=SIGNALS)

    def ordered(root: Path) -> list[str]:
        return sorted(map(repr, rows(root)))

    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    decode([str(plant)], parquet=tmp_path / "three", signal=SIGNALS)
    assert ordered(tmp_path / "dask") == ordered(tmp_path / "three") == ordered(tmp_path / "set")
