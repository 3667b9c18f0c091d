"""The PROFINET device over a pair of virtual Ethernet interfaces: period of its frames and its CPU.

The gateway and, as the floor, a process that only sends frames of the same size and cycle are in one network namespace; a
controller in the other exchanges data. The times are the kernel's time stamps of a capture.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from ipaddress import IPv4Interface
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from pdgw.base.durations import MS
from pdgw.gateway.base.errors import GatewayError
from pdgw.peers.controller.controller import Phase
from pdgw.peers.controller.plc import RunningController, project_of
from pdgw.profidrive.telegrams import Direction, telegram
from pdgw.profinet.model import TELEGRAM_SUBSLOT
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.frames.engine import Decoder
from pdgw.tools.decoder.frames.records import CyclicRecord
from pdgw.tools.demo.namespaces import ADDRESS_HERE, HERE, THERE, VethPair
from tests.long.bench.exchange import cpu_ns
from tests.support.readers.ethernet_capture import EthernetCapture

TITLES = ("cycle", "", "p50", "p99", "max", "frames", "of a core")
STATION: Final = "press-1"
_CYCLES_MS: Final = (0.5, 1, 4, 32)
_FLOOR_FRAME_ID: Final = 0xBBFF
_PATIENCE_S: Final = 60
_AXIS: Final = (1, TELEGRAM_SUBSLOT)
_HOLD_MS: Final = 200
"""Shortest data hold time: this controller is not a real-time system."""
_CYCLES_HELD: Final = 3
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

[[axis]]
do_id = 1
node_id = 1
telegram = 1
simulate = true
"""


class Cost(NamedTuple):
    """Period between frames (50 %, 99 %, longest) in milliseconds, frames, and share of a core."""

    period_ms: tuple[float, float, float]
    frames: int
    cpu_share: float


def measure(cycle_ms: float, seconds: float) -> tuple[Cost, Cost]:
    """Gateway and floor, in a namespace of their own (``namespaces.enter``). GatewayError if the relationship ends early."""
    with tempfile.TemporaryDirectory() as folder, VethPair() as pair:
        capture, config = Path(folder) / "bench.pcapng", Path(folder) / "gateway.toml"
        text = _CONFIG.format(cycle_ms=cycle_ms)
        config.write_text(f'store = "{folder}/store.json"\n{text}', encoding="utf-8")
        plc = pair.command(sys.executable, "-m", "tests.long.bench.profinet", str(cycle_ms), str(seconds))
        # Run as a file: the modules that a process loads affect its figures.
        sender = [sys.executable, "-P", str(Path(__file__).with_name("sends_only.py")), HERE]
        with (
            EthernetCapture(HERE, capture) as recording,
            _process([*sender, str(round(cycle_ms * MS)), f"{_FLOOR_FRAME_ID:04x}"]) as floor,
            _process([sys.executable, "-m", "pdgw", "run", str(config)]) as gateway,
            _process(plc) as controller,
        ):
            _expect(controller, "data")
            begin, before = time.time_ns(), [cpu_ns(process.pid) for process in (gateway, floor)]
            _expect(controller, "measured")
            end, after = time.time_ns(), [cpu_ns(process.pid) for process in (gateway, floor)]
            controller.wait(_PATIENCE_S)
        if recording.lost:
            raise GatewayError(f"{recording.lost} frames were not recorded: the machine is too busy to be measured")
        shares = [(late - early) / (end - begin) for early, late in zip(before, after, strict=True)]
        frames = list(_cyclic(capture, begin, end))
        ours = [r.time_ns for r in frames if r.direction is Direction.ACTUAL and r.frame_id != _FLOOR_FRAME_ID]
        theirs = [r.time_ns for r in frames if r.frame_id == _FLOOR_FRAME_ID]
        return Cost(period(ours), len(ours), shares[0]), Cost(period(theirs), len(theirs), shares[1])


def period(times: Sequence[int]) -> tuple[float, float, float]:
    """Milliseconds between frames: 50 %, 99 % and the longest. GatewayError for too few."""
    gaps = sorted((later - earlier) / MS for earlier, later in pairwise(times))
    if len(gaps) < 2:
        raise GatewayError(f"{len(times)} frames are too few to measure a period")
    return gaps[len(gaps) // 2], gaps[round(0.99 * (len(gaps) - 1))], gaps[-1]


def rows(seconds: float) -> Iterator[tuple[str, ...]]:
    """The lines of the table: the gateway and the floor."""
    for cycle_ms in _CYCLES_MS:
        try:
            found = measure(cycle_ms, seconds)
        except GatewayError as error:
            yield (f"{cycle_ms:g} ms", f"refused: {error}")
            continue
        for name, cost in zip(("gateway", "only sends"), found, strict=True):
            times = (f"{value:.3f} ms" for value in cost.period_ms)
            yield (f"{cycle_ms:g} ms", name, *times, str(cost.frames), f"{100 * cost.cpu_share:.1f} %")


def _cyclic(capture: Path, begin: int, end: int) -> Iterator[CyclicRecord]:
    decoder = Decoder()
    with open_source(str(capture)) as source:
        for packet in source.packets:
            record = decoder.decode(packet)
            if isinstance(record, CyclicRecord) and begin < record.time_ns < end:
                yield record


@contextmanager
def _process(command: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()


def _expect(controller: subprocess.Popen[str], word: str) -> None:
    assert controller.stdout is not None
    line = controller.stdout.readline().strip()
    if line != word:
        raise GatewayError(f"the controller did not come to {word!r}: {line or 'it ended'}")


def _control(cycle_ms: float, seconds: float) -> None:
    """The controller's process: connect, exchange data for a time, release the relationship; print the phases."""
    project = project_of(STATION, [telegram(1)], round(cycle_ms * MS))
    project = replace(project, data_hold=max(_CYCLES_HELD, round(_HOLD_MS / cycle_ms)))
    runner = RunningController(THERE, project, IPv4Interface(ADDRESS_HERE))
    plc = runner.controller
    end = time.monotonic() + _PATIENCE_S
    while plc.input(_AXIS) is None and time.monotonic() < end:
        if plc.phase in {Phase.IDLE, Phase.IDENTIFY, Phase.ENDED}:
            plc.start(time.monotonic_ns())
        runner.run(0.1, lambda: plc.input(_AXIS) is not None)
    print("data", flush=True)
    runner.run(seconds)
    print("measured" if plc.phase is Phase.DATA else plc.learned.ended or plc.phase.value, flush=True)
    plc.release(time.monotonic_ns())
    runner.run(3, lambda: plc.phase is Phase.ENDED)


if __name__ == "__main__":
    _control(*map(float, sys.argv[1:]))
