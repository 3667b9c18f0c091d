"""Reading captures: every format gives the same packets; damage is reported with its offset after the packets before it."""

from __future__ import annotations

import gzip
import io
import itertools
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Dot1Q, Ether
from scapy.utils import PcapNgWriter, wrpcap

from pdgw.base.durations import MS
from pdgw.ds301.bus.interfaces import open_bus
from pdgw.profidrive.scapy_layers import cyclic_frame
from pdgw.profidrive.telegrams import Direction
from pdgw.tools.decoder.capture import live
from pdgw.tools.decoder.capture.canlog import MAX_LINE, message_packet, read_candump
from pdgw.tools.decoder.capture.pcap import MAX_PACKET, CaptureError, read_capture
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.export.archive import captures_of
from pdgw.tools.decoder.frames.engine import CanPacket, Decoder, Packet
from pdgw.tools.decoder.frames.records import CyclicRecord
from tests.support.buses import PATIENCE_S, channel
from tests.support.readers import captures
from tests.support.readers.captures import BEGIN_NS, CANOPEN

BOTH = captures.both_buses()
PLC = [packet for packet in BOTH if packet[1] == captures.ETHERNET]


def read(data: bytes) -> list[Packet]:
    return list(read_capture(io.BytesIO(data), "test.pcap"))


def until_damage(packets: Iterator[Any]) -> tuple[list[Any], CaptureError | None]:
    found = []
    try:
        for packet in packets:
            found.append(packet)
    except CaptureError as error:
        return found, error
    return found, None


class Dribble(io.BytesIO):
    """A pipe that gives a few bytes at a time."""

    def read1(self, size: int = -1, /) -> bytes:
        return super().read1(min(size, 7))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nanoseconds", [False, True])
def test_pcap_in_every_byte_order_and_resolution(order: str, nanoseconds: bool) -> None:
    packets = read(captures.pcap(PLC, order=order, nanoseconds=nanoseconds))
    assert [(p.number, p.time_ns, p.link, p.data) for p in packets] == [
        (number, time_ns, link, data) for number, (time_ns, link, data) in enumerate(PLC, 1)
    ]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("resolution", [6, 8, 9, 0x80 | 20])
def test_pcapng_in_every_byte_order_and_resolution(order: str, resolution: int) -> None:
    packets = read(captures.pcapng(BOTH, order=order, resolution=resolution))
    assert [(p.link, p.data) for p in packets] == [(link, data) for _, link, data in BOTH]
    assert [p.channel for p in packets] == [f"if{link}" for _, link, _ in BOTH]
    ticks = 2**20 if resolution & 0x80 else 10**resolution
    assert all(0 <= due - p.time_ns <= max(1, 10**9 // ticks) for p, (due, _, _) in zip(packets, BOTH, strict=True))


def test_pcapng_with_several_sections_simple_and_foreign_blocks() -> None:
    data = captures.pcapng(PLC[:1]) + captures.block(0x0BAD, b"x" * 8) + captures.pcapng(PLC[1:2], order=">")
    simple = captures.block(3, struct.pack(">I", len(PLC[2][2])) + PLC[2][2], ">")
    packets = read(data + simple)
    assert [p.data for p in packets] == [data for _, _, data in PLC[:3]]
    assert packets[2].time_ns == packets[1].time_ns


def test_captures_of_scapy_are_read(tmp_path: Path) -> None:
    packets = [Ether(data) for data in captures.cyclic_packets()]
    wrpcap(str(tmp_path / "a.pcap"), packets)
    with PcapNgWriter(str(tmp_path / "a.pcapng")) as writer:
        writer.write(packets)
    for name in ("a.pcap", "a.pcapng"):
        with open_source(str(tmp_path / name)) as source:
            assert [p.data for p in source.packets] == captures.cyclic_packets()


FRAME = cyclic_frame([1], Direction.SETPOINT, [{"STW1": 0x047F, "NSOLL_A": 7}], counter=5)
DATAGRAM = IP(src="10.0.0.1", dst="10.0.0.2") / UDP(sport=4000, dport=34962) / FRAME


@pytest.mark.parametrize(
    ("link", "data"),
    [
        (1, bytes(Ether() / DATAGRAM)),
        (1, bytes(Ether() / Dot1Q(prio=6) / DATAGRAM)),
        (1, bytes(Ether() / Dot1Q() / Dot1Q() / DATAGRAM)),
        (1, bytes(Ether(type=0x8892) / FRAME)),
        (1, bytes(Ether() / Dot1Q(prio=6, type=0x8892) / FRAME)),
        (1, bytes(Ether() / IP(options=[b"\x01\x01\x01\x01"]) / UDP(sport=4000, dport=34962) / FRAME)),
        (101, bytes(DATAGRAM)),
        (228, bytes(DATAGRAM)),
        (0, b"\x02\0\0\0" + bytes(DATAGRAM)),
        (108, b"\0\0\0\x02" + bytes(DATAGRAM)),
        (113, bytes.fromhex("0000 0001 0006 02aa000000010000 0800") + bytes(DATAGRAM)),
        (276, bytes.fromhex("0800 0000 00000001 0001 00 06 02aa000000010000") + bytes(DATAGRAM)),
        (113, bytes.fromhex("0000 0001 0006 02aa000000010000 8892") + bytes(FRAME)),
    ],
)
def test_cyclic_frame_is_found_with_every_link_layer(link: int, data: bytes) -> None:
    record = Decoder().decode(Packet(1, 0, link, "", data))
    assert isinstance(record, CyclicRecord)
    assert record.data == bytes(FRAME)


def test_slow_pipe_gives_the_same_packets() -> None:
    for data in (captures.pcap(PLC), captures.pcapng(BOTH)):
        assert list(read_capture(Dribble(data), "pipe")) == read(data)
    assert list(read_candump(Dribble(captures.candump()), "pipe", [])) == can_packets(captures.candump())


@pytest.mark.parametrize("make", [captures.pcap, captures.pcapng])
def test_packets_before_a_cut_at_any_byte_are_read(make: Callable[..., bytes]) -> None:
    whole = make(PLC[:3])
    complete = read(whole)
    ends = {len(make(PLC[:count])) for count in (1, 2, 3)} | {24 if make is captures.pcap else 0}
    for size in range(len(whole)):
        try:
            packets, error = until_damage(read_capture(io.BytesIO(whole[:size]), "cut"))
        except CaptureError as refused:
            packets, error = [], refused
        assert packets == complete[: len(packets)]
        if error is None:
            assert size in ends or make is captures.pcapng
        else:
            assert error.offset is not None
            assert error.offset <= size
            assert f"offset {error.offset}" in str(error)


def test_damaged_lengths_are_refused_before_memory_is_taken() -> None:
    data = bytearray(captures.pcap(PLC))
    struct.pack_into("<I", data, 24 + 8, 0x7FFFFFFF)
    with pytest.raises(
        CaptureError, match=f"offset 24: packet 1 has 2147483647 bytes .*, allowed: at most {MAX_PACKET}"
    ):
        read(bytes(data))
    data = bytearray(captures.pcapng(PLC))
    struct.pack_into("<I", data, 4, 0xFFFFFFFC)
    with pytest.raises(CaptureError, match="offset 0: block length 4294967292"):
        read(bytes(data))


# -- CAN logs ---------------------------------------------------------------------------------------------------------


def can_packets(data: bytes) -> list[CanPacket]:
    return list(read_candump(io.BytesIO(data), "can.log", []))


def test_candump_log() -> None:
    packets = can_packets(captures.candump())
    assert [(p.frame.cob_id, p.frame.data) for p in packets] == list(CANOPEN)
    assert [p.time_ns for p in packets] == [BEGIN_NS + number * MS for number in range(len(CANOPEN))]
    assert {p.channel for p in packets} == {"can0"}


@pytest.mark.parametrize(
    ("line", "cob_id", "data", "flags"),
    [
        ("(1.5) can0 181#0102 R", 0x181, "0102", ""),
        ("(1.500000000) can0 7FF#", 0x7FF, "", ""),
        ("(1.5) can0 701#R", 0x701, "", "remote"),
        ("(1.5) can0 701#R2", 0x701, "0000", "remote"),
        ("(1.5) can0 00000123#AA", 0x123, "AA", "extended"),
        ("(1.5) can0 20000040#0000000000000000", 0x40, "00" * 8, "error"),
        ("(1.5) can0 123##1AABB", 0x123, "AABB", ""),
        (" (1.500000)  can0  181   [2]  01 02", 0x181, "0102", ""),
        (" (1.500000)  can0  RX - -  181   [2]  01 02", 0x181, "0102", ""),
        (" (1970-01-01 00:00:01.500000)  can0  181   [2]  01 02", 0x181, "0102", ""),
        ("  can0  181   [2]  01 02   '..'", 0x181, "0102", ""),
        ("> > (1.5) can0 181#0102", 0x181, "0102", ""),
        (">(1.5) can0 181#0102 <-- here", 0x181, "0102", ""),
        ("12:  can0  181   [2]  01 02 ab", 0x181, "0102", ""),
        ("user@host:~$   can0  181   [2]  01 02\r", 0x181, "0102", ""),
        ("  can0  00000123   [1]  AA", 0x123, "AA", "extended"),
        ("  can0  701   [0]  remote request", 0x701, "", "remote"),
    ],
)
def test_forms_of_candump_lines(line: str, cob_id: int, data: str, flags: str) -> None:
    (packet,) = can_packets(line.encode())
    frame = packet.frame
    assert (frame.cob_id, frame.data) == (cob_id, bytes.fromhex(data))
    assert "".join(name for name in ("extended", "remote", "error") if getattr(frame, name)) == flags
    assert packet.time_ns == (1_500_000_000 if "(" in line else 0)


def test_bad_line_is_reported_with_its_offset() -> None:
    good = captures.candump()
    packets, error = until_damage(read_candump(io.BytesIO(good + b"(1.0) can0 181#1\n"), "can.log", []))
    assert len(packets) == len(CANOPEN)
    assert error is not None
    assert error.offset == len(good)
    _, error = until_damage(read_candump(io.BytesIO(good + b"x" * (MAX_LINE + 2)), "can.log", []))
    assert error is not None
    assert "no line end" in str(error)
    _, error = until_damage(read_candump(io.BytesIO(b" (2026-13-01 00:00:00.5)  can0  181   [1]  01\n"), "can.log", []))
    assert error is not None
    assert "month must be in 1..12" in str(error)
    _, error = until_damage(read_candump(io.BytesIO(good[:-2]), "can.log", []))
    assert error is not None
    assert "half a byte" in str(error)


PASTED = b"""$ candump can0   # with a drive
  can0  701   [1]  00
= after the reset =
  can0  181   [2]  31 02
^C
"""


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_text_around_the_frames_is_ignored_and_counted(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "pasted.txt"
    path.write_bytes(PASTED.decode().encode(encoding))
    with open_source(str(path)) as source:
        frames = [packet.frame for packet in source.packets if isinstance(packet, CanPacket)]
    assert [(frame.cob_id, frame.data) for frame in frames] == [(0x701, b"\0"), (0x181, b"\x31\x02")]
    assert source.notices == [
        "3 lines without a frame ignored, the first at offset 0: b'$ candump can0   # with a drive'"
    ]


SAVVYCAN = b"""Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
1500000,00000701,false,Rx,0,1,00,,,,,,,
1500100,00000181,false,Rx,0,2,31,02
1500200,18DA00F1,true,Tx,1,0
"""


def test_csv_of_savvycan(tmp_path: Path) -> None:
    path = tmp_path / "savvy.csv"
    path.write_bytes(SAVVYCAN)
    with open_source(str(path)) as source:
        packets = [packet for packet in source.packets if isinstance(packet, CanPacket)]
    assert [
        (item.time_ns, item.channel, item.frame.cob_id, item.frame.data, item.frame.extended) for item in packets
    ] == [
        (1_500_000_000, "0", 0x701, b"\0", False),
        (1_500_100_000, "0", 0x181, b"\x31\x02", False),
        (1_500_200_000, "1", 0x18DA00F1, b"", True),
    ]


WRITERS = {
    ".asc": can.ASCWriter,
    ".blf": can.BLFWriter,
    ".csv": can.CSVWriter,
    ".db": can.SqliteWriter,
    ".log": can.CanutilsLogWriter,
    ".trc": can.TRCWriter,
}


@pytest.mark.parametrize("ending", WRITERS)
def test_every_format_of_python_can_gives_the_same_frames(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"log{ending}"
    with WRITERS[ending](str(path)) as writer:
        for message in captures.messages(channel="1" if ending == ".trc" else "can0"):
            writer.on_message_received(message)
    with open_source(str(path)) as source:
        packets = list(source.packets)
    assert all(isinstance(packet, CanPacket) for packet in packets)
    assert [(p.frame.cob_id, p.frame.data) for p in packets if isinstance(p, CanPacket)] == list(CANOPEN)
    steps = [(b.time_ns - a.time_ns) / MS for a, b in itertools.pairwise(packets)]
    assert steps == pytest.approx([1.0] * len(steps), abs=0.11)


@pytest.mark.parametrize(
    ("ending", "damage"),
    [
        (".asc", b"0.02 1 181 Rx d 2 zz zz\n"),
        (".csv", b"1.0,0xZZ,0,0,0,2,AAAA\n"),
        (".log", b"(1.0) can0 181#1\n"),
        (".trc", b"99) 1.0 DT 1 0181 Rx - 2 ZZ 01\n"),
    ],
)
def test_damaged_text_log_is_reported_after_its_good_packets(ending: str, damage: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"log{ending}"
    with WRITERS[ending](str(path)) as writer:
        for message in captures.messages(channel="1"):
            writer.on_message_received(message)
    path.write_bytes(path.read_bytes() + damage)
    with open_source(str(path)) as source:
        packets, error = until_damage(source.packets)
    assert len(packets) == len(CANOPEN)
    assert error is not None
    assert str(path) in str(error)
    assert "offset" in str(error)


def test_shortened_blf_file_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "log.blf"
    with can.BLFWriter(str(path)) as writer:
        for message in captures.messages(channel="1") * 3000:
            writer.on_message_received(message)
    whole = path.read_bytes()
    for size in (300, len(whole) // 2, len(whole) - 3):
        path.write_bytes(whole[:size])
        with open_source(str(path)) as source:
            packets, error = until_damage(source.packets)
        assert error is not None
        assert f"offset {size}" in str(error)
        assert len(packets) <= 45_000


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.pcap", b"", "is empty"),
        ("a.xyz", b"hello, world", r"offset 0: unknown format: the file begins with 68 65 6c"),
        ("a.blf", b"LOGG" + bytes(200), "cannot be read"),
        ("a.db", b"no database", "cannot be read"),
        ("a.mf4", b"MDF     4.10" + bytes(100), "needs another Python package|cannot be read"),
        ("a.log", b"nonsense\n", "not a candump log: no frame in 1 lines"),
        ("a.csv", b"time;id\n", r"its first line must be timestamp,.*python-can.* or Time Stamp,.*SavvyCAN"),
        (
            "b.csv",
            b"Time Stamp,ID,Extended,Dir,Bus,LEN\n5,181,false,Rx,0,two\n",
            "offset 35: .*: not a frame of SavvyCAN",
        ),
    ],
)
def test_unreadable_file_is_reported(name: str, data: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(CaptureError, match=message), open_source(str(tmp_path / name)) as source:
        list(source.packets)


@pytest.mark.parametrize("data", [captures.pcapng(BOTH), captures.pcap(PLC), captures.candump()])
def test_compressed_capture_is_read_until_its_damage(data: bytes, tmp_path: Path) -> None:
    plain, packed = tmp_path / "plain", tmp_path / "packed.gz"
    plain.write_bytes(data)
    packed.write_bytes(whole := gzip.compress(data))
    with open_source(str(plain)) as source:
        packets = list(source.packets)
    with open_source(str(packed)) as source:
        assert list(source.packets) == packets
    packed.write_bytes(whole[:-4])
    with open_source(str(packed)) as source:
        found, error = until_damage(source.packets)
    assert found == packets
    assert str(error).startswith(f"{packed}: offset {len(data)}: the compressed data is damaged or ends early")
    for damaged in (whole[:5], whole[:10] + b"?" * 40):
        packed.write_bytes(damaged)
        with pytest.raises(CaptureError, match=r"offset 0: .* run gzip --test"):
            open_source(str(packed))


def test_compressed_blf_log_has_the_size_of_its_content(tmp_path: Path) -> None:
    log, packed = tmp_path / "a.blf", tmp_path / "a.blf.gz"
    with can.BLFWriter(str(log)) as writer:
        for message in captures.messages():
            writer.on_message_received(message)
    packed.write_bytes(gzip.compress(log.read_bytes()))
    with open_source(str(log)) as source, open_source(str(packed)) as other:
        assert list(other.packets) == list(source.packets)


def test_captures_of_a_folder_include_compressed_ones(tmp_path: Path) -> None:
    for name in ("a.pcapng", "b.PCAPNG.gz", "c.tar.gz", "d.gz"):
        (tmp_path / name).touch()
    assert [Path(file).name for file in captures_of([str(tmp_path)])] == ["a.pcapng", "b.PCAPNG.gz"]


def test_missing_capture_file_is_reported() -> None:
    with pytest.raises(CaptureError, match=r"nowhere\.pcap: cannot be read"):
        open_source("nowhere.pcap")


def test_memory_does_not_grow_with_the_file() -> None:
    class Endless(io.RawIOBase):
        """A capture that repeats itself."""

        def __init__(self) -> None:
            self.largest = 0
            whole = captures.pcap(PLC)
            self.head, self.body = whole[:24], whole[24:] * 1000

        def read1(self, size: int, /) -> bytes:
            part, self.head = self.head or self.body, b""
            return part

    source = Endless()
    packets = read_capture(source, "endless")
    count = sum(1 for _ in zip(range(100_000), packets, strict=False))
    assert count == 100_000


# -- live -------------------------------------------------------------------------------------------------------------


def test_a_python_can_bus_is_read_live() -> None:
    name = channel()
    with open_bus("virtual", name) as sender, live.open_can(f"virtual:{name}") as source:
        for message in captures.messages():
            sender.send(message)
        packets = [next(source.packets) for _ in CANOPEN]
    assert [(p.frame.cob_id, p.frame.data) for p in packets if isinstance(p, CanPacket)] == list(CANOPEN)


@pytest.mark.parametrize("text", ["can0", ":can0", "socketcan:", "socketcan:can0@fast"])
def test_a_bus_is_given_as_interface_and_channel(text: str) -> None:
    with pytest.raises(Exception, match="expected interface:channel"):
        live.open_can(text)


def test_a_network_interface_is_read_live_or_refused_with_the_reason() -> None:
    try:
        source = live.open_interface("lo")
    except Exception as error:
        assert "--live lo: cannot be opened" in str(error)  # noqa: PT017 (without privileges this is right)
        return
    # Other programs may use the loopback: the FrameID identifies these frames. They are sent again if the kernel had no room.
    sent = [bytes(FRAME)[:-4] + bytes((0, counter, 0x35, 0)) for counter in range(3)]
    sent = [b"\xf7\xfe" + frame[2:] for frame in sent]
    received: set[bytes] = set()
    ended = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not ended.is_set():
                for frame in sent:
                    sender.sendto(frame, ("127.0.0.1", 34962))
                ended.wait(1)

    thread = threading.Thread(target=send, daemon=True)
    deadline = time.monotonic() + PATIENCE_S
    with source:
        thread.start()
        for packet in map(Decoder().decode, source.packets):
            if isinstance(packet, CyclicRecord) and packet.frame_id == 0xF7FE:
                received.add(packet.data)
            if len(received) == len(sent) or time.monotonic() > deadline:
                break
        ended.set()
        thread.join()
    assert received == set(sent)


def test_no_such_interface() -> None:
    with pytest.raises(Exception, match="--live nosuch0: cannot be opened"):
        live.open_interface("nosuch0")


def test_format_of_standard_input_is_detected_from_its_content(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    log = tmp_path / "a.asc"
    with can.ASCWriter(str(log)) as writer:
        for message in captures.messages():
            writer.on_message_received(message)
    for data in (captures.candump(), log.read_bytes()):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BufferedReader(io.BytesIO(data))))  # type: ignore[type-var]
        with open_source("-") as source:
            packets = list(source.packets)
        assert [(p.frame.cob_id, p.frame.data) for p in packets if isinstance(p, CanPacket)] == list(CANOPEN)


MESSAGES = (
    can.Message(1700000000.000001, 0x181, False, channel="can0", data=bytes.fromhex("31020000")),
    can.Message(1700000000.123456, 0x7FF, False, channel="can0", data=b""),
    can.Message(1700000001.5, 0x12345678, True, channel="can1", data=bytes(8)),
    can.Message(1700000002.0, 0x701, False, is_remote_frame=True, dlc=0, channel="can0"),
    can.Message(1700000003.0, 0x80, True, is_error_frame=True, dlc=8, data=bytes(8), channel="can0"),
)


def test_candump_log_of_python_can_is_read(tmp_path: Path) -> None:
    path = tmp_path / "can.log"
    with can.CanutilsLogWriter(path) as writer:
        for message in MESSAGES:
            writer.on_message_received(message)
    with open_source(str(path)) as source:
        found = list(source.packets)
    expected = [message_packet(number, message) for number, message in enumerate(MESSAGES, 1)]
    assert [(p.number, p.channel) for p in found] == [(p.number, p.channel) for p in expected]
    assert all(abs(a.time_ns - b.time_ns) < 1000 for a, b in zip(found, expected, strict=True))
    frames = [packet.frame for packet in found if isinstance(packet, CanPacket)]
    assert [(f.cob_id, f.extended, f.remote, f.error) for f in frames] == [
        (p.frame.cob_id, p.frame.extended, p.frame.remote, p.frame.error) for p in expected
    ]
    assert [frame.data for frame in frames[:4]] == [packet.frame.data for packet in expected[:4]]
