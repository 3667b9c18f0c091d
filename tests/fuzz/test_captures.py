"""Damaged and truncated captures of every format: decoded up to the damage, which is reported with its place; no traceback."""

from __future__ import annotations

import io
import random
from collections.abc import Callable
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import can
import pytest

from pdgw.ds301.aborts import CanopenError
from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.errors import ProfidriveError
from pdgw.tools.commands.capture.decode import decode
from pdgw.tools.decoder.capture.source import Source, source_of_stream
from pdgw.tools.decoder.frames.engine import CanPacket, Decoder, Packet, Settings, given_axes
from pdgw.tools.decoder.frames.records import LinkType
from pdgw.tools.decoder.view.filter import Changes
from pdgw.tools.decoder.view.names import Names
from pdgw.tools.decoder.view.render import Columns, record_line, record_tree
from pdgw.tools.decoder.view.statistics import Statistics
from tests.fuzz.amount import INPUTS, SEED, damage
from tests.support.readers import captures

CAPTURES = INPUTS // 50
"""Damaged captures of a format: each is many packets."""
OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {"as_json": True},
    {"csv": "stw1,statusword"},
    {"stats": True},
    {"changes_only": True},
)
NAMES = Names()
TITLES = ["kind", "frame_id", "stw1", "stw1.on", "statusword.text", "latency_ms", "object"]
EXCHANGE = [(bytes.fromhex("030201011000039A000042010009"), bytes.fromhex("03020101"))]
WRITERS: dict[str, Callable[..., Any]] = {
    ".asc": can.ASCWriter,
    ".blf": can.BLFWriter,
    ".csv": can.CSVWriter,
    ".trc": can.TRCWriter,
}


@cache
def original(ending: str) -> bytes:
    """A small sound capture of a format."""
    packets = captures.both_buses()
    plc = [packet for packet in packets if packet[1] == captures.ETHERNET]
    plc += [(captures.BEGIN_NS, captures.ETHERNET, data) for data in captures.parameter_packets(EXCHANGE)]
    if ending == ".pcap":
        return captures.pcap(plc)
    if ending == ".pcapng":
        return captures.pcapng(packets)
    if ending == ".log":
        return captures.candump()
    with TemporaryDirectory() as directory:
        path = Path(directory) / f"a{ending}"
        with WRITERS[ending](str(path)) as writer:
            for message in captures.messages(channel="1"):
                writer.on_message_received(message)
        return path.read_bytes()


def opened(content: bytes, ending: str) -> Source:
    """As standard input or a file of this name would be."""
    stream = io.BufferedReader(io.BytesIO(content))  # type: ignore[type-var]
    return source_of_stream("capture", ending, stream, len(content), ExitStack())


ENDINGS = [".pcap", ".pcapng", ".log", *WRITERS]


def read_all(packets: Any, decoder: Decoder) -> int:
    """Decode and show every packet in every way."""
    columns, changes, statistics = Columns(TITLES, NAMES), Changes(), Statistics()
    count = 0
    for packet in packets:
        record = decoder.decode(packet)
        assert record_line(record, 0)
        assert list(record_tree(record)) is not None
        assert record.document()
        for _, row in columns.rows(record):
            assert len(row) == len(TITLES)
        changes.select(record, record.units)
        statistics.add(record)
        count += 1
    assert statistics.document(1_000_000)["packets"] == count
    return count


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_damaged_capture_is_decoded_up_to_its_damage(ending: str) -> None:
    chance = random.Random(f"{SEED} {ending}")
    for _ in range(CAPTURES):
        content = damage(original(ending), chance)
        decoder = Decoder(Settings(given_axes(chance.choice(((), (1,), (1, 9))))))
        message = "capture: "
        try:
            with opened(content, ending) as source:
                read_all(source.packets, decoder)
        except GatewayError as error:
            message = str(error)
        assert message.startswith("capture: ")
        assert "\n" not in message


def test_any_packet_of_any_link_layer_is_a_record() -> None:
    chance = random.Random(SEED)
    links = [*LinkType, 147]
    known = captures.cyclic_packets(1) + captures.parameter_packets(EXCHANGE)
    stream = []
    for number in range(1, INPUTS // 10 + 1):
        if chance.random() < 0.5:
            link, content = LinkType.ETHERNET, damage(chance.choice(known), chance)
        else:
            link, content = chance.choice(links), chance.randbytes(chance.randrange(81))
        stream.append(Packet(number, number, link, "", content))
    assert read_all(stream, Decoder()) == len(stream)


@pytest.mark.parametrize("ending", [".pcap", ".pcapng", ".log"])
def test_the_command_ends_with_one_error_and_prints_what_came_before(ending: str, tmp_path: Path) -> None:
    chance = random.Random(f"{SEED} command {ending}")
    path = tmp_path / f"a{ending}"
    for number in range(CAPTURES // 3):
        path.write_bytes(damage(original(ending), chance))
        message = ""
        try:
            decode([str(path)], **OPTIONS[number % len(OPTIONS)])
        except (GatewayError, CanopenError, ProfidriveError) as error:
            message = str(error)
        assert not message or str(path) in message


def test_the_originals_are_sound() -> None:
    for ending in ENDINGS:
        content = original(ending)
        packets = list(opened(content, ending).packets)
        assert read_all(packets, Decoder()) == len(packets) >= 12
        assert all(isinstance(packet, Packet | CanPacket) for packet in packets)
