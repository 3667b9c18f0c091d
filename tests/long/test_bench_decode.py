"""The decoder's benchmark: its capture holds what it says, and the comparison runs."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pdgw.decoder.capture.source import open_source
from pdgw.decoder.frames.canopen.records import PdoRecord
from pdgw.decoder.frames.engine import Decoder, Settings, given_axes
from pdgw.decoder.frames.records import CyclicRecord
from pdgw.decoder.timeline.entries import Anomaly, Edge, WordKind
from pdgw.recording.recordings import followed, known_from, look_ahead
from tests.long.bench.decoding import decoding, following
from tests.long.bench.decoding.captures import AXES, write_capture, write_recording


def test_the_measured_capture_is_of_both_buses_and_every_packet_carries_values(tmp_path: Path) -> None:
    path = tmp_path / "bench.pcapng"
    write_capture(path, 4000)
    decoder = Decoder(Settings(given_axes([1])))
    with open_source(str(path)) as source:
        records = [decoder.decode(packet) for packet in source.packets]
    assert len(records) == 4000
    assert [type(record) for record in records[:4]] == [CyclicRecord, PdoRecord, PdoRecord, CyclicRecord]
    assert all(len(record.units) == 1 for record in records)
    speeds = {record.units[0].raw("NSOLL_A") for record in records if isinstance(record, CyclicRecord)}
    assert len(speeds) > 900
    assert records[-1].time_ns - records[0].time_ns == 3999 * 250_000


@pytest.mark.e2e
def test_a_short_comparison_measures_every_reader_and_the_timeline() -> None:
    speeds = decoding.run(packets=400, rounds=1)
    expected = ["pdgw decode --csv", *(["tshark -T fields"] if shutil.which("tshark") else []), "scapy"]
    assert [speed.name for speed in speeds] == expected
    assert all(speed.packets == 400 and speed.seconds > 0 for speed in speeds)
    told = following.run(2)
    assert (told.recorded_s, told.cpu_s > 0, told.first_line_s > 0, told.peak_mib > 1) == (2, True, True, True)


def test_the_measured_recording_starts_and_stops_four_axes_once_a_second(tmp_path: Path) -> None:
    opening = look_ahead(write_recording(tmp_path, 3), known_from(None, [1] * AXES, []), 0, lambda _: None)
    entries = list(followed(opening))
    ons = [item for item in entries if isinstance(item, Edge) and item.kind is WordKind.CONTROL and item.after & 1]
    assert len(ons) == 3 * AXES
    assert not [item for item in entries if isinstance(item, Anomaly)]
