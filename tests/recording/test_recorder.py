"""``pdgw run --record``: one file with both buses and the configuration, which timeline and replay need nothing else for."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.defaults import example
from pdgw.gateway.configuration.file import config_text, parse_config, simulated
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.reader import RingReader
from pdgw.tools.commands.capture.decode import decode
from pdgw.tools.decoder.capture.pcap import configuration_in
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.frames.engine import Decoder, Packet, Settings, given_axes
from pdgw.tools.decoder.frames.records import CyclicRecord, LinkType
from pdgw.tools.recording.recorder import CAPTURE, Captures, Recording
from pdgw.tools.recording.recordings import CONFIGURATION, known_from
from tests.support.axis.recorded import speed
from tests.support.gateways.daemon import axis, configuration
from tests.support.gateways.recorded_daemon import recorded
from tests.support.readers import tshark
from tests.support.readers.ethernet_capture import PcapngWriter

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


def datagram(source: str, target: str) -> bytes:
    data = speed().frames.plc[0][1]
    return pcapng.udp_header(source, target, len(data)) + data


@pytest.mark.parametrize("text", [FULL, example(), config_text(simulated([9] * 3, 2))])
def test_a_configuration_as_text_is_the_same_configuration(text: str) -> None:
    config = parse_config(text)
    assert parse_config(config_text(config)) == config


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
    packet = pcapng.udp_header("192.168.0.10:50000", "192.168.0.5:34962", len(frame)) + frame
    writer.write(LinkType.ETHERNET, "plc", 1_700_000_000_123_456_789, packet)
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
    packet = datagram("192.168.0.10:50000", "192.168.0.5:34962")
    writer.write(LinkType.ETHERNET, "plc", 1_700_000_000_123_456_789, packet)
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
    packet = datagram("10.255.255.255:40000", "10.0.0.2:34962")
    writer.write(LinkType.ETHERNET, "plc", 1_700_000_000_000_000_000, packet)
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
    (tmp_path / CAPTURE).write_bytes(pcapng.section(config_text(simulated([1])), ()))
    carried = known_from(None, [], [], [*files, str(tmp_path / CAPTURE)])
    assert [axis.telegram for axis in carried.settings.axes] == [1]
    assert [axis.telegram for axis in known_from(None, [2], [], files).settings.axes] == [2]


def test_a_recording_has_every_cycle_the_configuration_and_what_an_earlier_run_recorded(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    for number in (1, 2):
        with recorded(configuration(axis(1)), tmp_path) as plc:
            ring = plc.daemon.recorder
            assert ring is not None
            recording = Recording(folder, ring.path, ring.configuration)
            for _ in range(100 * number):
                plc.exchange()
        recording.stop()
        assert recording.lost == 0
        reader = RingReader(folder / CAPTURE)
        assert [cycle.number for cycle in reader.cycles()] == list(range(1, plc.daemon.cycles + 1))
        assert configuration_in(folder / CAPTURE) == (folder / CONFIGURATION).read_text() == ring.configuration
    assert len(list(folder.glob("gateway-*.pcapng"))) == 1
    with pytest.raises(GatewayError, match=r"--record .*cannot be written"):
        Recording(folder / CAPTURE / "x", ring.path, "")


def test_a_full_recording_is_rotated_and_the_oldest_are_deleted(tmp_path: Path) -> None:
    captures = Captures(tmp_path, size=2000, files=2)
    for number in range(40):
        captures.begin()
        captures.write(number.to_bytes(500, "big"))
        if number == 5:
            (tmp_path / CAPTURE).unlink()
    captures.close()
    files = sorted(tmp_path.glob("gateway-*.pcapng"), key=lambda path: path.stat().st_mtime_ns)
    assert [path.stat().st_size for path in files] == [2000, 2000]
    numbers = [int.from_bytes(path.read_bytes()[at : at + 500], "big") for path in files for at in range(0, 2000, 500)]
    assert numbers == list(range(numbers[0], numbers[0] + 8))


def test_a_full_disk_ends_the_recording_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(captures: Captures, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Captures, "write", full)
    with recorded(configuration(axis(1)), tmp_path) as plc:
        ring = plc.daemon.recorder
        assert ring is not None
        recording = Recording(tmp_path / "r", ring.path, "")
        plc.enable()
    recording.stop()
    assert recording.lost == 1
    assert "No space left on device; the recording has stopped" in caplog.text


def test_segments_that_were_deleted_before_they_were_copied_are_counted(tmp_path: Path) -> None:
    for number in (1, 2, 5):
        (tmp_path / f"{number:08d}-{number:012d}.pcapng").write_bytes(b"%d" % number)
    recording = Recording(tmp_path / "r", tmp_path, "")
    recording.stop()
    assert recording.lost == 2
    assert (tmp_path / "r" / CAPTURE).read_bytes() == b"125"
