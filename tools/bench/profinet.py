"""The PROFINET device over a pair of virtual Ethernet interfaces, all from a capture with the kernel's time stamps.

In the namespace of ``eth1`` run the gateway with one simulated axis and, as the floor, a process that does nothing but send
frames of the same size at the same cycle; in the other one a controller (``profinet_controller``) that connects, exchanges data,
reads records and ends without a word.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

from pdgw.decoder.capture.source import open_source
from pdgw.decoder.engine import Decoder
from pdgw.decoder.profinet_records import Change, DcpRecord, RelationRecord
from pdgw.decoder.records import AcyclicRecord, CyclicRecord, Record
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.frame import COUNTER_UNIT_NS, IOPS_GOOD
from pdgw.profidrive.telegrams import Direction
from pdgw.tools.ethernet_capture import EthernetCapture
from pdgw.tools.namespaces import HERE, VethPair

CYCLES_MS: Final = (1, 2, 4, 32)
STATION: Final = "press-1"
FLOOR_FRAME_ID: Final = 0xBBFF
"""Of the frames of the process that only sends."""
_HOLD_MS: Final = 200
"""At least; the controller of the benchmark is no real-time system."""
_PATIENCE_S: Final = 60
_NS_PER_MS: Final = 1e6
_TICKS: Final = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100

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
_REALTIME: Final = "\n[realtime]\npriority = 40\nlock_memory = true\n"
_SENDER: Final = """
import os, socket, sys, time
sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
sock.bind((sys.argv[1], 0))
frame = bytes.fromhex("02000000007f") + sock.getsockname()[4] + bytes.fromhex("8892" + sys.argv[3]) + bytes(44)
cycle = int(sys.argv[2])
if len(sys.argv) > 4:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))
due = time.monotonic_ns()
while True:
    due += cycle
    left = due - time.monotonic_ns()
    if left > 0:
        time.sleep(left / 1e9)
    sock.send(frame)
"""


@dataclass(frozen=True, slots=True)
class Period:
    """Time between frames, milliseconds."""

    frames: int
    p50_ms: float
    p99_ms: float
    max_ms: float


@dataclass(frozen=True, slots=True)
class ProfinetRow:
    """What was measured at one cycle time."""

    cycle_ms: int
    gateway: Period
    floor: Period
    """Of the process that only sends, in the same run."""
    missed: int
    """Cycles without a frame, by the cycle counter."""
    cpu_share: float
    """Of one core, the gateway's process while data is exchanged."""
    resident_bytes: int
    start_s: float
    """From the start of the process to its first DCP answer."""
    connect_ms: float
    """Connect request to response."""
    data_ms: float
    """Identify request to the first input frame with valid data, with the drive online."""
    record_ms: float
    """Read request to response, median."""
    hold_ms: float
    killed_ms: float
    """From the last frame of a controller that was killed to the last frame of the gateway; the data hold time is ``hold_ms``."""

    @property
    def ratio_p99(self) -> float:
        """How far the gateway's p99 is beyond the cycle, against the floor's."""
        floor = max(self.floor.p99_ms - self.cycle_ms, 0.001)
        return (self.gateway.p99_ms - self.cycle_ms) / floor


def period(times: Sequence[int]) -> Period:
    """Of frames at these times, nanoseconds; GatewayError for too few."""
    gaps = sorted(later - earlier for earlier, later in pairwise(times))
    if len(gaps) < 2:
        raise GatewayError(f"{len(times)} frames are too few to measure a period")
    last = len(gaps) - 1
    return Period(
        len(times), gaps[last // 2] / _NS_PER_MS, gaps[round(0.99 * last)] / _NS_PER_MS, gaps[last] / _NS_PER_MS
    )


def measure(cycle_ms: int, seconds: float, *, realtime: bool) -> ProfinetRow:
    """One row; inside a namespace of its own (``namespaces.enter``)."""
    hold_ms = max(3, -(-_HOLD_MS // cycle_ms)) * cycle_ms
    with tempfile.TemporaryDirectory() as folder, VethPair() as pair:
        capture = Path(folder) / "bench.pcapng"
        config = Path(folder) / "gateway.toml"
        text = _CONFIG.format(cycle_ms=cycle_ms, realtime=_REALTIME if realtime else "")
        config.write_text(f'store = "{folder}/store.json"\n{text}', encoding="utf-8")
        bare = config.with_name("bare.toml")
        bare.write_text(config.read_text(encoding="utf-8").replace("simulate = true\n", ""), encoding="utf-8")
        controller = pair.command(
            *(sys.executable, "-m", "pdgw.tools.bench.profinet_controller"),
            *(str(cycle_ms), str(hold_ms), str(seconds), "realtime" if realtime else ""),
        )
        floor = [sys.executable, "-c", _SENDER, HERE, str(cycle_ms * 1_000_000), f"{FLOOR_FRAME_ID:04x}"]
        with (
            EthernetCapture(HERE, capture),
            _process(floor + (["realtime"] if realtime else [])),
            subprocess.Popen(controller, stdout=subprocess.PIPE, text=True) as plc,
        ):
            _expect(plc, "ready")
            started = time.time_ns()
            # Without its simulated drive, whose process it would start and wait for first.
            with _process([sys.executable, "-m", "pdgw", "run", str(bare)]):
                _expect(plc, "found")
            with _process([sys.executable, "-m", "pdgw", "run", str(config)]) as gateway:
                _expect(plc, "data")
                cpu, begun = _cpu_s(gateway.pid), time.monotonic()
                _expect(plc, "done")
                share = (_cpu_s(gateway.pid) - cpu) / (time.monotonic() - begun)
                resident = _resident_bytes(gateway.pid)
                plc.wait(_PATIENCE_S)
                time.sleep(2 * hold_ms / 1000)
        return row_of(cycle_ms, hold_ms, list(records_in(capture)), started, share, resident)


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
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _resident_bytes(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def records_in(capture: Path) -> Iterator[Record]:
    """What a capture tells."""
    decoder = Decoder()
    with open_source(str(capture)) as source:
        for packet in source.packets:
            yield decoder.decode(packet)


def row_of(
    cycle_ms: int, hold_ms: int, records: Sequence[Record], started: int, share: float, resident: int
) -> ProfinetRow:
    """A row out of the records of a capture; ``started`` on its clock. The last Connect is the one measured."""
    answers = [r.time_ns for r in records if isinstance(r, DcpRecord) and r.details()["packet"] == "response"]
    granted = [r for r in records if isinstance(r, RelationRecord) and r.change is Change.GRANTED]
    cyclic = [r for r in records if isinstance(r, CyclicRecord)]
    if not answers or not granted:
        raise GatewayError("the capture has no DCP answer or no Connect")
    session = granted[-1]
    asked = max(
        r.time_ns
        for r in records
        if isinstance(r, DcpRecord) and r.details()["packet"] == "request" and r.time_ns < session.time_ns
    )
    inputs = [r for r in cyclic if r.direction is Direction.ACTUAL and r.time_ns > session.time_ns]
    outputs = [r for r in cyclic if r.direction is Direction.SETPOINT and r.time_ns > session.time_ns]
    valid = [r for r in inputs if any((unit.iops or 0) & IOPS_GOOD for unit in r.units)]
    exchanged = [r for r in valid if r.time_ns <= outputs[-1].time_ns]
    reads = sorted(
        r.latency_ns
        for r in records
        if isinstance(r, AcyclicRecord) and r.latency_ns is not None and r.details().get("operation") == "read"
    )
    usual = cycle_ms * 1_000_000 // COUNTER_UNIT_NS
    steps = [(later.cycle_counter - earlier.cycle_counter) & 0xFFFF for earlier, later in pairwise(exchanged)]
    return ProfinetRow(
        cycle_ms,
        period([r.time_ns for r in exchanged]),
        period([r.time_ns for r in cyclic if r.frame_id == FLOOR_FRAME_ID and r.time_ns > session.time_ns]),
        sum(step // usual - 1 for step in steps),
        share,
        resident,
        (answers[0] - started) / 1e9,
        (session.latency_ns or 0) / _NS_PER_MS,
        (valid[0].time_ns - asked) / _NS_PER_MS,
        reads[len(reads) // 2] / _NS_PER_MS if reads else 0.0,
        hold_ms,
        (inputs[-1].time_ns - outputs[-1].time_ns) / _NS_PER_MS,
    )
