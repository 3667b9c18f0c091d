"""Short runs of the benchmark's tables."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from pdgw.durations import MS
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.frames.engine import Decoder, Settings, given_axes
from tests.long.bench import decoding, exchange, profinet, stops
from tests.support.readers.both_buses import write_capture


@pytest.mark.parametrize("loss", stops.LOSSES, ids=lambda loss: loss.cause)
def test_every_loss_stops_the_drive_within_its_bound(loss: stops.Loss) -> None:
    assert 0 < stops.measure(loss, 0) / MS <= loss.bound_ms


@pytest.mark.e2e
def test_row_of_the_exchange_has_gateway_and_echo() -> None:
    row = exchange.measure(4, 3, 20, 2)
    assert len(row.gateway) == len(row.echo) == 3
    assert row.cpu_us > 0


def test_late_answer_is_missed_and_does_not_answer_the_next_cycle() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        peer = exchange.Peer(server.getsockname()[1], exchange.Echo(8))
        peer.send()
        peer.send()
        data, client = server.recvfrom(8)
        server.sendto(data, client)
        peer.settle()
        assert (peer.samples, peer.missed) == ([], 2)
        peer.send()
        for _ in range(2):
            data, client = server.recvfrom(8)
        server.sendto(data, client)
        peer.settle()
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


@pytest.mark.e2e
def test_table_of_the_decoder_has_each_program() -> None:
    names = [row[0] for row in decoding.rows(400)]
    assert {"pdgw decode --csv", "pdgw timeline", "scapy"} <= set(names)
