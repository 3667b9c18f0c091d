"""``pdgw run --record``: one file with both buses and the configuration, which timeline and replay need nothing else for."""

from __future__ import annotations

from pathlib import Path

import can
import pytest

from pdgw.decoder.capture.pcapng_file import PcapngWriter, can_packet, configuration_in, udp_packet
from pdgw.decoder.capture.source import open_source
from pdgw.decoder.frames.engine import Decoder, Packet, Settings, given_axes
from pdgw.decoder.frames.records import CyclicRecord, LinkType
from pdgw.gateway.configuration.example import example, simulated
from pdgw.gateway.configuration.file import config_text, parse_config
from pdgw.gateway.errors import GatewayError
from pdgw.recording.recorder import CAPTURE, Captures, Recorder
from pdgw.recording.recordings import CONFIGURATION, known_from
from pdgw.tools.commands.capture.decode import decode
from tests.decoder.replay.test_replay import speed
from tests.support.readers import tshark

FULL = """
store = "p.json"
[[can]]
name = "a"
interface = "virtual"
channel = "l"
receive_own_messages = true
[[can]]
name = "b"
interface = "socketcan"
channel = "can1"
bitrate = 500000
[transport]
cycle_time_ms = 2.5
listen = "0.0.0.0"
peer = "192.168.0.10"
[[axis]]
do_id = 7
node_id = 3
telegram = 3
can = "b"
g1 = 9
on_plc_loss = "ramp"
standstill_window_percent = 2.5
rated_speed_rpm = "10000/3"
velocity_unit = "0.1 rpm"
[[encoder]]
do_id = 9
node_id = 20
telegram = 83
can = "a"
motion = "speed=1.5"
reference_speed = 1500.5
"""


@pytest.mark.parametrize("text", [FULL, example(), config_text(simulated([9] * 3, 2))])
def test_a_configuration_as_text_is_the_same_configuration(text: str) -> None:
    config = parse_config(text)
    assert parse_config(config_text(config)) == config


def test_the_file_carries_the_configuration(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r", simulated([1]))
    recorder.stop()
    text = configuration_in(tmp_path / "r" / CAPTURE)
    assert parse_config(text) == simulated([1])
    assert (tmp_path / "r" / CONFIGURATION).read_text() == text
    with pytest.raises(GatewayError, match=r"--record .*cannot be written"):
        Recorder(tmp_path / "r" / CAPTURE / "x", simulated([1]))


@pytest.mark.parametrize(
    "content", [b"", b"\x0a\x0d\x0d\x0a", b"\x0a\x0d\x0d\x0a" + b"\xff" * 200, b"(1.0) can0 1#00\n" * 9]
)
def test_a_file_without_a_configuration_has_none(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(content)
    assert configuration_in(path) == ""
    assert configuration_in(tmp_path / "none") == ""


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "x.pcapng"
    frame = speed().frames.plc[0][1]
    writer = PcapngWriter(path, "a" * 70_000)
    datagram = udp_packet(("192.168.0.10", 50000), ("192.168.0.5", 34962), frame)
    writer.write(LinkType.ETHERNET, "plc", 1_700_000_000_123_456_789, datagram)
    writer.write(LinkType.CAN_SOCKETCAN, "can0", 1_700_000_000_123_456_790, b"\0\0\x01\x81\x02\0\0\0\x31\x02")
    writer.close()
    with open_source(str(path)) as source:
        packets = [packet for packet in source.packets if isinstance(packet, Packet)]
    assert [(p.link, p.channel, p.time_ns % 1000) for p in packets] == [(1, "plc", 789), (227, "can0", 790)]
    record = Decoder(Settings(given_axes([1]))).decode(packets[0])
    assert isinstance(record, CyclicRecord)
    assert record.data == frame


def test_decode_knows_the_axes_of_a_capture_that_has_its_configuration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.pcapng"
    writer = PcapngWriter(path, config_text(simulated([1])))
    datagram = udp_packet(("192.168.0.10", 50000), ("192.168.0.5", 34962), speed().frames.plc[0][1])
    writer.write(LinkType.ETHERNET, "plc", 1_700_000_000_123_456_789, datagram)
    writer.close()
    decode([str(path)])
    shown = capsys.readouterr()
    assert "axis 1 T1 " in shown.out
    assert shown.err == f"note: the configuration of the gateway is read from {path}\n"
    decode([str(path)], telegram=[20])
    assert "configuration of the gateway" not in capsys.readouterr().err


@pytest.mark.tshark
@tshark.needs_tshark
def test_tshark_reads_frames_checksums_and_comment(tmp_path: Path) -> None:
    path = tmp_path / "x.pcapng"
    writer = PcapngWriter(path, "[can]\n")
    datagram = udp_packet(("10.255.255.255", 40000), ("10.0.0.2", 34962), speed().frames.plc[0][1])
    writer.write(LinkType.ETHERNET, "plc", 1_700_000_000_000_000_000, datagram)
    writer.close()
    (row,) = tshark.fields(path, ["pn_rt.frame_id", "ip.checksum.status"], ["-o", "ip.check_checksum:TRUE"])
    assert (int(row["pn_rt.frame_id"], 0), row["ip.checksum.status"]) == (0xC001, "1")


def test_configuration_is_read_from_the_capture_or_its_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = speed().frames.write(tmp_path)
    assert not known_from(None, [], [], files).settings.axes
    (tmp_path / CONFIGURATION).write_text(config_text(simulated([9] * 2)))
    assert [axis.telegram for axis in known_from(None, [], [], files).settings.axes] == [9, 9]
    assert f"configuration of the gateway is read from {tmp_path / CONFIGURATION}" in capsys.readouterr().err
    Recorder(tmp_path, simulated([1])).stop()
    carried = known_from(None, [], [], [*files, str(tmp_path / CAPTURE)])
    assert [axis.telegram for axis in carried.settings.axes] == [1]
    assert [axis.telegram for axis in known_from(None, [2], [], files).settings.axes] == [2]


def test_can_frames_keep_their_kind(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, simulated([1]))
    for message in (
        can.Message(5.5, 0x181, False, data=b"\x31\x02"),
        can.Message(6.0, 0x12345678, True, data=b"\x01"),
        can.Message(7.0, 0x701, False, is_remote_frame=True),
    ):
        recorder.frame("can0", message)
    recorder.stop()
    with open_source(str(tmp_path / CAPTURE)) as source:
        records = [Decoder().decode(packet) for packet in source.packets]
    assert [record.time_ns for record in records] == [5_500_000_000, 6_000_000_000, 7_000_000_000]
    texts = [record.summary for record in records]
    assert texts[1].startswith("extended identifier 12345678h")
    assert texts[2] == "node guarding request"


def test_full_recording_is_rotated_and_the_oldest_are_deleted(tmp_path: Path) -> None:
    captures = Captures(tmp_path, config_text(simulated([1])), size=2000, files=2)
    for number in range(200):
        captures.write(LinkType.CAN_SOCKETCAN, "can0", number, can_packet(0x181, number.to_bytes(8, "big")))
    captures.close()
    files = sorted(tmp_path.glob("gateway-*.pcapng"), key=lambda path: path.stat().st_mtime_ns)
    assert len(files) == 2
    assert all(2000 <= path.stat().st_size < 2200 for path in files)
    # Each can be read alone: it has its interfaces and the configuration. Together they are what came last, without a gap.
    numbers: list[int] = []
    for path in (*files, tmp_path / CAPTURE):
        assert parse_config(configuration_in(path)) == simulated([1])
        with open_source(str(path)) as source:
            numbers += [packet.time_ns for packet in source.packets if isinstance(packet, Packet)]
    assert numbers == list(range(numbers[0], 200))
    assert len(numbers) > 40


def test_removed_recording_is_followed_by_a_new_one(tmp_path: Path) -> None:
    captures = Captures(tmp_path, config_text(simulated([1])), size=2000, files=2)
    packet = can_packet(0x181, bytes(8))
    captures.write(LinkType.CAN_SOCKETCAN, "can0", 1, packet)
    (tmp_path / CAPTURE).unlink()
    while not (tmp_path / CAPTURE).exists():
        captures.write(LinkType.CAN_SOCKETCAN, "can0", 2, packet)
    captures.close()
    assert parse_config(configuration_in(tmp_path / CAPTURE)) == simulated([1])
    assert list(tmp_path.glob("gateway-*.pcapng")) == []


def test_what_an_earlier_run_recorded_is_kept(tmp_path: Path) -> None:
    for number in range(3):
        recorder = Recorder(tmp_path, simulated([1]))
        recorder.frame("can0", can.Message(float(number + 1), 0x181, False, data=b"\x01"))
        recorder.stop()
    assert len(list(tmp_path.glob("gateway-*.pcapng"))) == 2
    assert (tmp_path / CAPTURE).exists()
