"""The benchmarks run and measure what they say; their figures belong to ``python -m tests.long bench``, not to a test."""

from __future__ import annotations

import io
import json
import re
import selectors
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TypeVar

import pytest
from rich.console import Console
from typer.testing import CliRunner

from pdgw.ds301.bus.can_frame import CAN_FRAME, pack_frame, unpack_frame
from pdgw.ds301.connection_set import NMT
from pdgw.ds301.nmt import NmtCommand
from pdgw.durations import MS
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.new_frames import Verdict
from pdgw.gateway.trace.reader import RingReader
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.profidrive.frame import RtFrame
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.rpc.server import RecordServer
from tests.fuzz.test_parameters import Memory
from tests.long.bench import command_line, flood, killed, recording, settings, stops, storm
from tests.long.bench import rows as bench_rows
from tests.long.bench.measuring.dialogues import SPEEDS, EchoDialogue, PlcDialogue, speed
from tests.long.bench.measuring.histogram import Histogram, octaves
from tests.long.bench.measuring.measure import Latency, latency
from tests.long.bench.measuring.schedule import Peer
from tests.long.bench.processes import drives, processes
from tests.long.bench.processes.drives import IdealDrives
from tests.long.bench.rows import ROWS, Refused, Row, setpoints_to_can
from tests.long.bench.translation import axis_cycle
from tests.long.commands import bench
from tests.long.commands.bench import app
from tests.support.cli import workshop

T = TypeVar("T")


@pytest.mark.parametrize(("number", "enabled"), [(1, 0x07), (9, 0x07), (100, 0x27)])
def test_the_measured_axis_cycle_is_one_in_operation(number: int, enabled: int) -> None:
    cycle = axis_cycle(number)
    frames = [RtFrame.decode(bytes(cycle())) for _ in range(20)]  # type: ignore[call-overload]
    word = int.from_bytes(frames[-1].c_sdu[:2], "big")
    assert word & enabled == enabled
    assert len({frame.c_sdu for frame in frames}) > 8, "the values change from cycle to cycle"


def test_percentiles_count_a_missed_cycle_as_one_that_took_the_whole_period() -> None:
    result = latency([n * 1000 for n in range(1, 991)], 10, 5_000_000)
    assert (result.p50, result.p99, result.p999) == (501, 5000, 5000)
    assert (result.samples, result.missed, result.missed_share) == (990, 10, 0.01)
    with pytest.raises(GatewayError, match="no answer in 7 cycles"):
        latency([], 7, 1)


def test_a_histogram_has_the_percentiles_of_its_samples() -> None:
    histogram = Histogram()
    histogram.add([n * 1000 for n in range(1, 9_001)], 0, 5_000_000)
    histogram.add([2_004_999], 999, 5_000_000)
    assert (histogram.cycles, histogram.missed) == (10_000, 999)
    assert histogram.percentiles() == [4_992, 8_896, 8_960, 8_992, 8_992], "rounded down by 32 us at most"
    assert sum(counts[0] for _, counts in octaves([histogram])) == 10_000
    assert dict(octaves([histogram]))[4_096] == [4_096 + 999]


class _Numbers:
    """Datagrams that carry their cycle; an answer is certain when its number is its own."""

    def datagram(self, cycle: int, newest: bytes = b"") -> bytes:
        return bytes((cycle,))

    def answers(self, data: bytes, cycle: int) -> bool:
        return data == bytes((cycle,))


@pytest.fixture
def line() -> Iterator[tuple[Peer, Callable[..., None]]]:
    """A peer of the client, and what answers it with the given datagrams."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        peer = Peer(server.getsockname()[1], _Numbers())

        def answer(*datagrams: bytes) -> None:
            for data in datagrams:
                server.sendto(data, peer.socket.getsockname())

        yield peer, answer
        peer.close()


def counts(peer: Peer) -> tuple[int, int, int]:
    return len(peer.samples), peer.missed, peer.slept


def test_a_cycle_is_answered_by_the_first_datagram_of_its_period(line: tuple[Peer, Callable[..., None]]) -> None:
    peer, answer = line
    peer.send()
    answer(b"any", b"more")
    peer.settle()
    assert counts(peer) == (1, 0, 0)


def test_the_kernel_has_an_answer_before_the_client_has_it(line: tuple[Peer, Callable[..., None]]) -> None:
    peer, answer = line
    peer.send()
    answer(b"any")
    peer.settle()
    (at_client,), (at_socket,) = peer.samples, peer.socket_samples
    assert -MS < at_socket <= at_client + MS, "two clocks, one of which is read at the beginning of a measurement"


def test_a_late_answer_is_missed_and_does_not_answer_the_next_cycle(line: tuple[Peer, Callable[..., None]]) -> None:
    peer, answer = line
    peer.send()
    peer.send()
    answer(b"\x00")  # of cycle 0
    peer.settle()
    assert counts(peer) == (0, 2, 0)
    peer.send()
    answer(b"\x01", b"?")  # of cycle 1, then of cycle 2
    peer.settle()
    assert counts(peer) == (1, 2, 0)


def test_after_a_missed_cycle_only_a_newer_answer_counts(line: tuple[Peer, Callable[..., None]]) -> None:
    peer, answer = line
    peer.send()
    peer.send()
    answer(b"\x01")
    peer.send()
    answer(b"?")
    peer.settle()
    assert counts(peer) == (2, 1, 0)


def test_cycles_missed_by_the_client_do_not_count_for_the_peer(line: tuple[Peer, Callable[..., None]]) -> None:
    peer, answer = line
    peer.send()
    answer(b"\x00")
    peer.sleep_through()
    peer.send()
    answer(b"\x02")
    peer.settle()
    assert counts(peer) == (2, 0, 1)
    assert list(peer.sent) == [0, 2]


def test_echo_has_its_cycle_and_plc_answers_follow_the_speed() -> None:
    echo = EchoDialogue(40)
    assert len(echo.datagram(7)) == 40
    assert [echo.answers(echo.datagram(7), cycle) for cycle in (6, 7, 8)] == [False, True, False]
    plc = PlcDialogue(1, 1_000_000)
    gateway = CyclicEndpoint([telegram(1)], cycle_ns=1_000_000)
    turning_as_in_cycle_6 = bytes(gateway.build([(0x0637, speed(6) - 2)], [True]))
    assert [plc.answers(turning_as_in_cycle_6, cycle) for cycle in (6, 7, 8)] == [False, True, False]


class _Wire:
    """A bus with one member, whose frames are kept; ``deliver`` sends it one."""

    def __init__(self) -> None:
        self.frames: list[tuple[int, bytes]] = []

    def attach(self, deliver: Callable[[bytes], None]) -> Callable[[bytes], None]:
        self.deliver = deliver
        return lambda frame: self.frames.append(unpack_frame(frame))


def test_a_drive_that_starts_beside_one_in_operation_shows_its_first_tpdo() -> None:
    wire = _Wire()
    drives = IdealDrives(wire, 2)  # type: ignore[arg-type]
    rpdo = pack_frame(0x201, bytes(6))
    for frame in (pack_frame(NMT, bytes((NmtCommand.START, 1))), rpdo, pack_frame(NMT, bytes((NmtCommand.START, 2)))):
        wire.deliver(frame)
        wire.deliver(rpdo)
    drives.poll(time.monotonic_ns())
    assert 0x182 in [identifier for identifier, _ in wire.frames]


def test_stored_answers_of_an_ideal_drive_end_with_a_write() -> None:
    wire = _Wire()
    drives = IdealDrives(wire, 1)  # type: ignore[arg-type]
    read, write = bytes.fromhex("4017100000000000"), bytes.fromhex("2B171000E8030000")
    for request in (read, read, write, read):
        wire.deliver(pack_frame(0x601, request))
        drives.poll(time.monotonic_ns())
    answers = [data for identifier, data in wire.frames if identifier == 0x581]
    assert answers[0] == answers[1]
    assert [data[:6].hex() for data in answers[2:]] == ["601710000000", "4b171000e803"]


def test_ideal_drives_answer_on_a_can_interface_of_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    gateway, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    bound: list[tuple[str]] = []

    def can_socket(*_family: int) -> object:
        return SimpleNamespace(bind=bound.append, recv=theirs.recv, send=theirs.send, fileno=theirs.fileno)

    monkeypatch.setattr(drives, "socket", SimpleNamespace(socket=can_socket, AF_CAN=29, SOCK_RAW=3, CAN_RAW=1))
    with gateway, theirs, selectors.DefaultSelector() as selector:
        bus = drives.KernelBus(selector, "vcan0")
        IdealDrives(bus, 1)
        gateway.send(pack_frame(0x601, bytes.fromhex("4017100000000000")))
        for key, _ in selector.select():
            key.data()
        frames = [unpack_frame(gateway.recv(CAN_FRAME.size)) for _ in range(2)]
    assert bound == [("vcan0",)]
    assert [identifier for identifier, _ in frames] == [0x701, 0x581]
    config = parse_config(processes.configuration([bus.channel, "127.0.0.1:1"], 4, 4_000_000, (1, 2, 3)))
    assert [(item.interface, item.channel) for item in config.can] == [
        ("socketcan", "vcan0"),
        ("pdgw-bus", "127.0.0.1:1"),
    ]


def test_missing_can_interface_is_refused_before_anything_starts() -> None:
    for options, told in (
        (
            ("--interface", "no-such-can"),
            "no-such-can, allowed: 1 CAN interfaces of this machine; no-such-can does not exist",
        ),
        (("--axes", "4", "--interface", "lo"), "lo, allowed: 2 CAN interfaces"),
    ):
        result = workshop("bench", "cycle", *options)
        assert result.returncode == 1
        assert f"--interface: {told}" in result.stderr


class _Report:
    """Drives with the report that the test sets."""

    def __init__(self, rpdos: list[int], log: list[tuple[int, int]]) -> None:
        self._report = rpdos, log

    def report(self) -> tuple[list[int], list[tuple[int, int]]]:
        return self._report


def after(words: list[int], cycles: int) -> tuple[Peer, PlcDialogue]:
    """A peer after this number of answered cycles, the last with these ZSW1."""
    plc = PlcDialogue(len(words), 1_000_000)
    gateway = CyclicEndpoint([telegram(1)] * len(words), cycle_ns=1_000_000)
    peer = Peer(9, plc)
    peer.close()
    peer.newest = bytes(gateway.build([(word, 0) for word in words], [True] * len(words)))
    peer.sent = {cycle: 1000 * cycle for cycle in range(cycles)}
    peer.samples = [1] * cycles
    return peer, plc


def test_setpoints_are_matched_at_the_drive_by_their_speed() -> None:
    peer, plc = after([0x0637], 2 * SPEEDS)
    log = [(1000 * cycle + 5 + cycle // SPEEDS, 3 * speed(cycle)) for cycle in range(2 * SPEEDS) if cycle != 70]
    result = setpoints_to_can(peer, plc, _Report([2 * SPEEDS], log), 1_000_000)
    assert (result.samples, result.missed) == (2 * SPEEDS - 1, 1)
    assert result.p50 == 0.006


@pytest.mark.parametrize(
    ("words", "rpdos", "told"),
    [([0x0637, 0x0231], [5, 5], "0231h"), ([0x0637, 0x0637], [5, 4], r"\[5, 4\]")],
    ids=["an axis is not in operation", "a drive was left out"],
)
def test_row_with_idle_axes_is_rejected(words: list[int], rpdos: list[int], told: str) -> None:
    peer, plc = after(words, 5)
    with pytest.raises(GatewayError, match=told):
        setpoints_to_can(peer, plc, _Report(rpdos, [(1, 1)]), 1_000_000)


def test_rejected_row_has_its_reason_and_the_others_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    good = Latency(100, 1000, 1200, 900, 100)
    row = Row(1, MS, "C", good, good, good, good, good, 0, 50_000, 3000, 7, 1e5, None, 1.0)

    def measure(axes: int, period_ns: int, seconds: float) -> Row:
        if axes == 4:
            raise GatewayError("benchmark: the axes do not turn")
        return replace(row, axes=axes, period_ns=period_ns)

    monkeypatch.setattr(bench, "measure", measure)
    console = Console(record=True, width=120, file=io.StringIO())
    rows = bench._rows(console, console.status(""), 1)
    assert [item.axes for item in rows] == [axes for axes, _ in ROWS]
    assert [item.why for item in rows if isinstance(item, Refused)] == ["benchmark: the axes do not turn"]
    printed = console.export_text()
    assert "refused: benchmark: the axes do not turn" in printed
    assert re.search(r"│ 1 +│ 1 ms +│ echo in C +│ 100 us +│ >= 1000 us", printed)
    assert "3000/s, 7 lost" in printed, "cycles flat out whose RPDO did not come"


def measured(measurement: Callable[[], T], useful: Callable[[T], object] = lambda _: True) -> T:
    """Half a second is short: a measurement is refused, and made again, where a process was held up for most of it."""
    refused: list[str] = []
    while len(refused) < 10:
        try:
            if useful(result := measurement()):
                return result
            refused.append("of no use")
        except GatewayError as error:
            refused.append(str(error))
    raise AssertionError(refused)


@pytest.mark.e2e
def test_short_measurements_are_consistent_and_name_the_build(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ["cycle", "--axes", "4", "--cycle-time-ms", "4", "--seconds", "0.5", "--json"]
    result = measured(lambda: CliRunner().invoke(app, arguments, catch_exceptions=False))
    assert result.exit_code == 0, result.output
    document = json.loads(result.output)
    assert document["machine"]["build"].removesuffix(" with native engine") in {"pure Python", "compiled"}
    (row,) = document["rows"]
    assert (row["axes"], row["period_ns"]) == (4, 4_000_000)
    for name in ("gateway", "echo"):
        assert 0 < row[name]["samples"] <= 128
    assert row["gateway"]["samples"] + row["gateway"]["missed"] + row["slept"] == 128
    assert row["to_can"]["samples"] + row["to_can"]["missed"] + row["slept"] == 128
    assert min(row["start_s"], row["gateway_per_s"], row["echo_per_s"], row["ratio_p50"]) > 0
    assert command_line.cpu_s("--version") > 0
    with pytest.raises(subprocess.CalledProcessError):
        command_line.cpu_s("no-such-command")
    told = measured(lambda: storm.measure(seconds=0.5, phases=1), lambda storm: storm.requests_per_s)
    assert told.quiet.samples > 0
    assert told.storm.samples > 0
    monkeypatch.setattr(bench_rows, "_MINUTE_NS", 250 * MS)
    arguments = ["hours", "--hours", str(2 / 60), "--axes", "1", "--cycle-time-ms", "4", "--json"]
    result = measured(lambda: CliRunner().invoke(app, arguments, catch_exceptions=False))
    hours = json.loads(result.output)["hours"]
    for name in ("gateway", "echo"):
        assert 0 < sum(hours[name]["counts"].values()) == hours[name]["cycles"] <= 2 * 62


@pytest.mark.parametrize(("row", "loss"), stops.VIRTUAL, ids=lambda item: getattr(item, "cause", None))
def test_every_loss_stops_the_drive_within_its_bound(row: stops.Stop, loss: Callable[[stops.Site], int]) -> None:
    site = stops.Site(seed=3)
    with site.running():
        site.turn()
        took = loss(site)
        site.off()
    assert 0 < took <= row.bound_ms * 1_000_000


@pytest.mark.e2e
def test_killed_or_paused_gateway_leaves_the_drive_to_its_guarding() -> None:
    """It raises when the drive does not stop, or the standing ON starts it again; nothing else is left to stop it."""
    assert [len(row.times_ns) for row in killed.real(1)] == [1, 1]


def test_flood_sends_valid_datagrams_for_each_port() -> None:
    """Otherwise the flood would be dropped before it costs anything."""
    frame = flood.datagram(flood.CYCLIC)
    endpoint = CyclicEndpoint([telegram(1)] * flood.AXES, cycle_ns=flood.PERIOD_NS)
    assert endpoint.receive(frame, ("10.0.0.9", 1), 1) is Verdict.ACCEPTED
    server = RecordServer[object](Memory(), 2048)
    assert server.receive(flood.datagram(flood.ACYCLIC), "stranger", 1)


def test_the_same_exchange_is_measured_with_every_choice_that_is_granted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(settings, "_TURNS", 1)
    monkeypatch.setattr(settings, "may_be_real_time", lambda: False)
    asked: list[str] = []
    rows = {"": object(), "[trace]\nenabled = false\n": object(), "[realtime]\npriority = 0\n": object()}

    def measured(axes: int, period_ns: int, seconds: float, more: str) -> object:
        asked.append(more)
        return rows[more]

    monkeypatch.setattr(settings, "measure", measured)
    choices = settings.run(2, 4_000_000, 0.1, lambda text: None)
    assert [choice.name for choice in choices] == [settings.AS_SHIPPED, "without flight recorder", "usual scheduling"]
    assert [choice.rows for choice in choices] == [(row,) for row in rows.values()]
    for more in settings.SETTINGS.values():
        # What is added is a configuration the gateway takes.
        assert parse_config(processes.configuration(["x"], 1, 4_000_000, (1, 2, 3)) + more)


def test_the_cost_of_the_flight_recorder_is_measured_where_it_records(monkeypatch: pytest.MonkeyPatch) -> None:
    recorders: list[FlightRecorder] = []

    def recorder(daemon: Daemon, directory: Path, name: str) -> FlightRecorder:
        recorders.append(FlightRecorder(daemon, directory, name))
        return recorders[-1]

    def cost(call: Callable[[], object]) -> float:
        """As if each record of a cycle cost 1000 ns and 300 ns an axis, each of a frame 470 ns, everything else 50 ns."""
        path = recorders[-1].path if recorders else None
        if path is None:
            call()
            return 50
        with RingReader(path) as ring:
            cycles, frames = ring.newest_cycle, ring.newest_frame
            call()
            written = ring.cycles(cycles)
            return 50 + sum(1000 + 300 * len(cycle.objects) for cycle in written) + 470 * (ring.newest_frame - frames)

    monkeypatch.setattr(recording, "FlightRecorder", recorder)
    monkeypatch.setattr(recording, "nanoseconds_per_call", cost)
    assert recording.run() == recording.RecordingCost(cycle_ns=1000, axis_ns=300, frame_ns=50 + 470, times_ns=50)
