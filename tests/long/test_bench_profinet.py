"""The rows of ``python -m tests.long bench profinet`` out of a capture whose times are known: a gateway in virtual time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pdgw.durations import MS
from pdgw.gateway.errors import GatewayError
from pdgw.tools.demo import namespaces
from tests.long.bench.profinet import profinet
from tests.long.bench.profinet.profinet import (
    ECHO_BYTES,
    ECHO_PORT,
    FLOOR_FRAME_ID,
    Cost,
    Period,
    ProfinetRow,
    echoes_in,
    first_answer,
    first_of_floor,
    period,
    records_in,
    row_of,
)
from tests.long.commands.bench import app
from tests.support.gateways.daemon import axis
from tests.support.gateways.profinet_daemon import configuration, plant
from tests.support.readers import captures
from tests.support.readers.tshark_frames import datagram
from tests.support.wire.profinet import DEVICE_MAC, PLC_IP

TURN_MS = 0.25
FLOOR = bytes.fromhex("02000000007f") + DEVICE_MAC + b"\x88\x92" + FLOOR_FRAME_ID.to_bytes(2, "big") + bytes(44)


def test_row_has_the_figures_of_the_capture(tmp_path: Path) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json"), data_hold=50) as site:
        started = captures.BEGIN_NS + site.loop.now()
        site.connect()
        site.run(400 * MS)
        site.plc.read((0, 0, 1), 0xAFF0, lambda result: None)
        site.run(20 * MS)
        begin = site.loop.now()
        site.plc.release(begin)
        site.run(20 * MS)
        site.plc.project = replace(site.plc.project, data_hold=6)
        site.connect()
        site.run(100 * MS)
        site.killed = True
        site.run(500 * MS)
        sent = [(begin - 400 * MS + number * 4 * MS, FLOOR) for number in range(100)]
        asked = datagram(b"echo" * (ECHO_BYTES // 4), (PLC_IP, 50_000), ("192.168.0.2", ECHO_PORT))
        answered = datagram(b"echo" * (ECHO_BYTES // 4), ("192.168.0.2", ECHO_PORT), (PLC_IP, 50_000))
        site.frames = sorted([*site.frames, *sent, (begin, asked), (begin + MS // 2, answered)])
        (capture, _) = site.write(tmp_path)
    records, echoes = list(records_in(Path(capture))), echoes_in(Path(capture))
    assert (first_answer(records) - started) / 1e9 < 0.1
    assert first_of_floor(records) == captures.BEGIN_NS + sent[0][0]
    row = row_of(4, 24, records, echoes, Cost(0.05, 1 << 20, 0.5), Cost(0.01, 1 << 20, 0.1))
    assert (row.gateway.p50_ms, row.missed) == (4, 0)
    # The device moves its frames to just after the controller's, which is seen in turns of the plant.
    assert 4 <= row.gateway.p99_ms <= row.gateway.max_ms <= 4 + TURN_MS
    assert (row.floor.frames, row.floor.p99_ms) == (100, 4)
    assert row.gateway.frames == pytest.approx(105, abs=3)
    assert row.killed_ms == pytest.approx(24, abs=4)
    assert row.data_ms <= 8 + TURN_MS
    assert row.connect_ms <= 1
    assert row.record_ms <= 1
    assert (row.echo_ms, row.ratio_record) == (0.5, row.record_ms / 0.5)


def test_the_percentiles_of_a_period_are_those_of_the_gaps() -> None:
    times = [number * MS for number in range(100)] + [99 * MS + 5 * MS]
    found = period(times)
    assert (found.frames, found.p50_ms, found.p99_ms, found.max_ms) == (101, 1, 1, 5)
    with pytest.raises(GatewayError, match="2 frames are too few"):
        period(times[:2])


def test_a_row_that_is_refused_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    def measure(cycle_ms: int, seconds: float, *, realtime: bool, native: bool) -> ProfinetRow:
        if native:
            raise GatewayError("the controller did not come to 'data'")
        period, cost = Period(9, 1.0, 1.1, 1.2), Cost(0.1, 1 << 20, 0.5)
        return ProfinetRow(cycle_ms, native, period, period, 0, cost, cost, 1, 1, 1, 1, 24, 24)

    monkeypatch.setattr(profinet, "measure", measure)
    monkeypatch.setattr(profinet, "exchanges", lambda: (False, True))
    monkeypatch.setattr(namespaces, "inside", lambda: True)
    result = CliRunner().invoke(app, ["profinet", "--cycle-time-ms", "2"])
    assert "refused: 2 ms, native: the controller did not come to 'data'" in result.output
    assert "1.100 ms" in result.output
