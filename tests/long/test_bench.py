"""Short runs of the benchmark's tables, and what a cycle of the gateway takes: at most 1 % more than ``bench/counts.toml`` says.

A change that needs more raises the number there, and its commit says what it bought.
"""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from pdgw.base.durations import MS
from pdgw.gateway.base.identity import COMPILED, kind
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.frames.engine import Decoder, Settings, given_axes
from tests.long.bench import counting, exchange, profinet, stops
from tests.support.readers.both_buses import write_capture


@pytest.mark.parametrize("loss", stops.LOSSES, ids=lambda loss: loss.cause)
def test_every_loss_stops_the_drive_within_its_bound(loss: stops.Loss) -> None:
    assert 0 < stops.measure(loss, 0) / MS <= loss.bound_ms


@pytest.mark.e2e
def test_row_of_the_exchange_has_gateway_and_floor() -> None:
    row = exchange.measure(4, 3, 20, 2)
    assert len(row.gateway.latencies) == len(row.floor.latencies) == 3
    assert row.gateway.cpu_us > 0
    assert row.floor.cpu_us > 0


def test_late_answer_is_missed_and_does_not_answer_the_next_cycle() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        peer = exchange.Peer(server.getsockname()[1], exchange.Echo(8))
        peer.send()
        peer.send()
        data, client = server.recvfrom(8)
        server.sendto(data, client)
        peer.run_out()
        assert (peer.samples, peer.missed) == ([], 2)
        peer.send()
        for _ in range(2):
            data, client = server.recvfrom(8)
        server.sendto(data, client)
        peer.run_out()
        assert (len(peer.samples), peer.missed) == (1, 2)
        peer.socket.close()


def test_percentiles_of_a_period_are_those_of_the_gaps() -> None:
    assert profinet.period([0, 1 * MS, 2 * MS, 5 * MS]) == (1.0, 3.0, 3.0)


def test_every_packet_of_the_measured_capture_has_values(tmp_path: Path) -> None:
    write_capture(tmp_path / "both.pcapng", 40)
    decoder = Decoder(Settings(given_axes([1])))
    with open_source(str(tmp_path / "both.pcapng")) as source:
        records = [decoder.decode(packet) for packet in source.packets]
    assert len(records) == 40
    assert {type(record).__name__ for record in records} == {"CyclicRecord", "PdoRecord"}


# -- counts of a cycle ------------------------------------------------------------------------------------------------


def test_written_counts_replace_those_of_this_build_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    before = counting.limits()
    copied = tmp_path / "counts.toml"
    copied.write_text(counting.LIMITS.read_text("utf-8"))
    monkeypatch.setattr(counting, "LIMITS", copied)
    monkeypatch.setattr(counting, "write_documents", lambda: None)
    monkeypatch.setattr(counting, "kind", lambda: COMPILED)
    monkeypatch.setattr(counting, "interpreter", lambda: next(iter(before["compiled"])))
    rows: dict[str, dict[str, float]] = {"1 axis, 1 ms": {"instructions": 100, "entries": 4.5, "recorder": 20}}
    counting.write(rows)
    assert counting.limits() == before | {"compiled": {counting.interpreter(): rows}}


def test_a_count_may_be_one_percent_above_its_limit_and_three_below() -> None:
    limit = {"instructions": 1000, "entries": 4.6, "recorder": 20}
    assert counting.excess({"instructions": 1010, "entries": 4.0, "recorder": 20}, limit) == {}
    assert counting.excess({"instructions": 970}, limit) == {}
    found = {"instructions": 969, "entries": 4.7, "recorder": 21}
    assert counting.excess(found, limit) == found


@pytest.mark.skipif(kind() == COMPILED, reason="a compiled gateway executes no bytecodes")
@pytest.mark.parametrize("name", counting.ROWS)
def test_a_cycle_takes_no_more_bytecodes_and_calls_into_c(name: str) -> None:
    found = counting.taken(counting.ROWS[name])
    if not counting.known():
        pytest.skip(f"{found}; not known for this Python")
    assert not counting.excess(found._asdict(), counting.known()[name]), found


@pytest.mark.parametrize("name", ["PROFINET, 1 ms", "PROFINET, 4 ms"])
def test_loop_seldom_wakes_beside_the_cycles_while_a_drive_moves(name: str) -> None:
    assert counting.wakes(counting.ROWS[name]) <= counting.limits()["wakes"][name]


@pytest.mark.e2e
@pytest.mark.skipif(bool(counting.missing()), reason=counting.missing())
def test_a_cycle_of_the_compiled_gateway_takes_no_more_instructions() -> None:
    # Of 8 axes, as all rows take minutes: `make bench COMPILED=1` and `python -m tests.long.bench counts` compare all of them.
    found = counting.compiled("8 axes, 1 ms")
    if not counting.known():
        pytest.skip(f"{found}; not known for {counting.interpreter()}")
    assert not counting.excess(found._asdict(), counting.known()["8 axes, 1 ms"]), found


@pytest.mark.e2e
@pytest.mark.skipif(bool(counting.missing()), reason=counting.missing())
def test_commands_take_no_more_instructions() -> None:
    limits = counting.limits()["commands"].get(counting.interpreter())
    if limits is None:
        pytest.skip(f"not known for {counting.interpreter()}")
    found = {arguments: counting.command(arguments) for arguments in limits}
    assert not any(counting.excess({"instructions": found[name]}, {"instructions": limits[name]}) for name in limits), (
        found
    )
