"""The PROFINET device over a pair of virtual Ethernet interfaces, measured in a capture with the kernel's time stamps.

In the namespace of ``eth1`` run the gateway with one simulated axis and, as the floor, a process that only sends frames of
the same size and cycle, and a plain UDP echo. In the other namespace a controller (``profinet_controller``) connects,
exchanges data, reads records alternating with the echo, connects again with a short data hold time, and ends without a
release.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from bisect import bisect
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

from pdgw.decoder.capture.source import open_source
from pdgw.decoder.frames.engine import CanPacket, Decoder
from pdgw.decoder.frames.profinet.records import Change, DcpRecord, RelationRecord
from pdgw.decoder.frames.records import AcyclicRecord, CyclicRecord, Record
from pdgw.durations import MS, SECOND
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.profinet.native import is_built
from pdgw.profidrive.frame import COUNTER_UNIT_NS, IOPS_GOOD
from pdgw.profidrive.telegrams import Direction
from pdgw.recording.ethernet_capture import EthernetCapture
from pdgw.tools.demo.namespaces import HERE, VethPair
from tests.long.bench.processes.processes import USUAL_SCHEDULING, cpu_ns

CYCLES_MS: Final = (0.25, 0.5, 1, 2, 4, 32)
STATION: Final = "press-1"
FLOOR_FRAME_ID: Final = 0xBBFF
"""FrameID of the process that only sends."""
ECHO_PORT: Final = 34_980
ECHO_BYTES: Final = 240
"""About the size of a record request."""
_HOLD_MS: Final = 200
"""Shortest hold time of the measured exchange: the benchmark's controller is not a real-time system."""
_KILLED_HOLD_MS: Final = 24
"""Shortest hold time of the relationship whose controller is killed."""
_CYCLES_HELD: Final = 3
_PATIENCE_S: Final = 60
_UDP: Final = re.compile(
    rb"(?s).{12}\x08\x00\x45.{8}\x11.{10}(?P<source>.{2})(?P<target>.{2}).{4}(?P<data>.{%d})" % ECHO_BYTES
)
"""A UDP datagram in an Ethernet frame."""

_CONFIG: Final = f"""\
[can]
interface = "virtual"
channel = "pdgw"

[transport]
type = "profinet"
interface = "{HERE}"
station_name = "{STATION}"
status_port = 0
watchdog_factor = 100
cycle_time_ms = {{cycle_ms}}
{{realtime}}
[[axis]]
do_id = 1
node_id = 1
telegram = 1
simulate = true
"""
_PRIORITY: Final = 40
_REALTIME: Final = f"\n[realtime]\npriority = {_PRIORITY}\n"
_NATIVE: Final = "native = {}\n"
_BESIDE: Final = Path(__file__).parent
"""Folder of the floor processes. They are run as files, because the modules that a process loads affect its figures."""


@dataclass(frozen=True, slots=True)
class Period:
    """Time between frames in milliseconds."""

    frames: int
    p50_ms: float
    p99_ms: float
    max_ms: float


@dataclass(frozen=True, slots=True)
class Cost:
    """Resources of a process."""

    cpu_share: float
    """Share of one core, while data is exchanged."""
    resident_bytes: int
    start_s: float
    """Seconds from its start to its first DCP answer; for the floor process, to its first frame."""


@dataclass(frozen=True, slots=True)
class ProfinetRow:
    """The figures of one cycle time."""

    cycle_ms: float
    native: bool
    """Whether the native engine exchanged the frames."""
    gateway: Period
    floor: Period
    """Of the process that only sends, in the same run."""
    missed: int
    """Cycles without a frame, from the cycle counter."""
    cost: Cost
    floor_cost: Cost
    connect_ms: float
    """Connect request to response."""
    data_ms: float
    """Identify request to the first input frame with valid data, with the drive online."""
    record_ms: float
    """Read request to response, median."""
    echo_ms: float
    """Round trip of a datagram to the UDP echo, median, alternating with the records."""
    hold_ms: float
    killed_ms: float
    """From the last frame of a killed controller to the last frame of the gateway. The data hold time is ``hold_ms``."""

    @property
    def name(self) -> str:
        """Name in a table."""
        return "gateway, native" if self.native else "gateway"

    @property
    def ratio_record(self) -> float:
        """Time of a record relative to the echo."""
        return self.record_ms / max(self.echo_ms, 0.001)

    @property
    def ratio_p99(self) -> float:
        """Delay of the gateway's p99 beyond the cycle, relative to the floor's."""
        floor = max(self.floor.p99_ms - self.cycle_ms, 0.001)
        return (self.gateway.p99_ms - self.cycle_ms) / floor


def exchanges() -> tuple[bool, ...]:
    """The measured variants: Python alone, then the native engine if it was built."""
    return (False, True) if is_built() else (False,)


def period(times: Sequence[int]) -> Period:
    """Time between frames with these times in nanoseconds. GatewayError for too few."""
    gaps = sorted(later - earlier for earlier, later in pairwise(times))
    if len(gaps) < 2:
        raise GatewayError(f"{len(times)} frames are too few to measure a period")
    last = len(gaps) - 1
    return Period(len(times), gaps[last // 2] / MS, gaps[round(0.99 * last)] / MS, gaps[last] / MS)


def measure(cycle_ms: float, seconds: float, *, realtime: bool, native: bool) -> ProfinetRow:
    """Measure one row, in a namespace of its own (``namespaces.enter``). ``native``: with the native engine."""
    holds = [max(_CYCLES_HELD, -(-least // cycle_ms)) * cycle_ms for least in (_HOLD_MS, _KILLED_HOLD_MS)]
    as_asked = [str(_PRIORITY)] if realtime else []
    with tempfile.TemporaryDirectory() as folder, VethPair() as pair:
        capture = Path(folder) / "bench.pcapng"
        config = Path(folder) / "gateway.toml"
        scheduling = _REALTIME if realtime else f"\n{USUAL_SCHEDULING}"
        text = _CONFIG.format(cycle_ms=cycle_ms, realtime=scheduling + _NATIVE.format(str(native).lower()))
        config.write_text(f'store = "{folder}/store.json"\n{text}', encoding="utf-8")
        bare = config.with_name("bare.toml")
        bare.write_text(config.read_text(encoding="utf-8").replace("simulate = true\n", ""), encoding="utf-8")
        controller = pair.command(
            *(sys.executable, "-m", "tests.long.bench.profinet.controller"),
            *(str(cycle_ms), *map(str, holds), str(seconds), *as_asked),
        )
        echo = [sys.executable, "-P", str(_BESIDE / "echoes_only.py"), str(ECHO_PORT), *as_asked]
        sender = [sys.executable, "-P", str(_BESIDE / "sends_only.py")]
        floor = [*sender, HERE, str(round(cycle_ms * MS)), f"{FLOOR_FRAME_ID:04x}"]
        with (
            EthernetCapture(HERE, capture) as recording,
            ExitStack() as running,  # the senders must end before the capture, which waits for silence
            subprocess.Popen(controller, stdout=subprocess.PIPE, text=True) as plc,
            _process(echo),
        ):
            _expect(plc, "ready")
            floor_started = time.time_ns()
            only_sends = running.enter_context(_process(floor + as_asked))
            started = time.time_ns()
            # Without its simulated drive: its process would be started and awaited first.
            with _process([sys.executable, "-m", "pdgw", "run", str(bare)]):
                _expect(plc, "found")
            with _process([sys.executable, "-m", "pdgw", "run", str(config)]) as gateway:
                _expect(plc, "data")
                pids = (gateway.pid, only_sends.pid)
                before, begun = [_cpu_s(pid) for pid in pids], time.monotonic()
                _expect(plc, "measured")
                spent, lasted = [_cpu_s(pid) for pid in pids], time.monotonic() - begun
                taken = [
                    ((after - earlier) / lasted, _resident_bytes(pid))
                    for pid, earlier, after in zip(pids, before, spent, strict=True)
                ]
                _expect(plc, "done")
                plc.wait(_PATIENCE_S)
                time.sleep(2 * holds[1] / 1000)
        if recording.lost:
            raise GatewayError(f"{recording.lost} frames were not recorded: the machine is too busy to be measured")
        records = list(records_in(capture))
        costs = [
            Cost(*item, (first - start) / SECOND)
            for item, first, start in zip(
                taken, (first_answer(records), first_of_floor(records)), (started, floor_started), strict=True
            )
        ]
        return row_of(cycle_ms, holds[1], records, echoes_in(capture), costs[0], costs[1], native=native)


@contextmanager
def _process(command: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()


def _expect(plc: subprocess.Popen[str], word: str) -> None:
    assert plc.stdout is not None
    line = plc.stdout.readline()
    told = json.loads(line) if line else {}
    if told.get("phase") != word:
        raise GatewayError(f"the controller did not come to {word!r}: {told or 'it ended'}")


def _cpu_s(pid: int) -> float:
    return (cpu_ns(pid) or 0) / SECOND


def _resident_bytes(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def records_in(capture: Path) -> Iterator[Record]:
    """The measured moments in a capture."""
    decoder = Decoder()
    with open_source(str(capture)) as source:
        for packet in source.packets:
            yield decoder.decode(packet)


def echoes_in(capture: Path) -> list[int]:
    """Round trip of each datagram to the echo, in nanoseconds."""
    asked: dict[bytes, int] = {}
    took: list[int] = []
    with open_source(str(capture)) as source:
        for packet in source.packets:
            found = None if isinstance(packet, CanPacket) else _UDP.match(packet.data)
            if found is None:
                continue
            port_from, port_to = (int.from_bytes(found[name], "big") for name in ("source", "target"))
            if port_to == ECHO_PORT:
                asked[found["data"]] = packet.time_ns
            elif port_from == ECHO_PORT and found["data"] in asked:
                took.append(packet.time_ns - asked.pop(found["data"]))
    return took


def first_answer(records: Sequence[Record]) -> int:
    """Time of the first DCP answer; GatewayError without one."""
    return _first(r.time_ns for r in records if isinstance(r, DcpRecord) and r.details()["packet"] == "response")


def first_of_floor(records: Sequence[Record]) -> int:
    """Time of the floor process's first frame; GatewayError without one."""
    return _first(r.time_ns for r in records if isinstance(r, CyclicRecord) and r.frame_id == FLOOR_FRAME_ID)


def _first(times: Iterator[int]) -> int:
    found = next(times, None)
    if found is None:
        raise GatewayError("the capture has no DCP answer, or no frame of the process that only sends")
    return found


def _median_ms(times: Sequence[int]) -> float:
    return sorted(times)[len(times) // 2] / MS if times else 0.0


def row_of(
    cycle_ms: float,
    hold_ms: float,
    records: Sequence[Record],
    echoes: Sequence[int],
    cost: Cost,
    floor_cost: Cost,
    *,
    native: bool = False,
) -> ProfinetRow:
    """Compute a row from the records of a capture: the relationship with the record reads, and the end of the last one."""
    granted = [r for r in records if isinstance(r, RelationRecord) and r.change is Change.GRANTED]
    reads = [
        r
        for r in records
        if isinstance(r, AcyclicRecord) and r.latency_ns is not None and r.details().get("operation") == "read"
    ]
    at = bisect([r.time_ns for r in granted], reads[-1].time_ns) if reads else 0
    if not 0 < at < len(granted):
        raise GatewayError("the capture has no relationship with record reads, or none after it")
    session, last = granted[at - 1], granted[-1]
    measured_end = granted[at].time_ns
    cyclic = [r for r in records if isinstance(r, CyclicRecord)]
    asked = max(
        r.time_ns
        for r in records
        if isinstance(r, DcpRecord) and r.details()["packet"] == "request" and r.time_ns < session.time_ns
    )
    measured = [r for r in cyclic if session.time_ns < r.time_ns < measured_end]
    inputs = [r for r in measured if r.direction is Direction.ACTUAL]
    outputs = [r for r in measured if r.direction is Direction.SETPOINT]
    valid = [r for r in inputs if any((unit.iops or 0) & IOPS_GOOD for unit in r.units)]
    exchanged = [r for r in valid if r.time_ns <= outputs[-1].time_ns]
    ends = {
        direction: max(r.time_ns for r in cyclic if r.direction is direction and r.time_ns > last.time_ns)
        for direction in (Direction.ACTUAL, Direction.SETPOINT)
    }
    usual = round(cycle_ms * MS) // COUNTER_UNIT_NS
    steps = [(later.cycle_counter - earlier.cycle_counter) & 0xFFFF for earlier, later in pairwise(exchanged)]
    return ProfinetRow(
        cycle_ms,
        native,
        period([r.time_ns for r in exchanged]),
        period([r.time_ns for r in measured if r.frame_id == FLOOR_FRAME_ID]),
        sum(step // usual - 1 for step in steps),
        cost,
        floor_cost,
        (session.latency_ns or 0) / MS,
        (valid[0].time_ns - asked) / MS,
        _median_ms([r.latency_ns for r in reads if r.latency_ns is not None]),
        _median_ms(echoes),
        hold_ms,
        (ends[Direction.ACTUAL] - ends[Direction.SETPOINT]) / MS,
    )
