"""The cyclic exchange over UDP with ideal drives, compared with a floor of the same run: a C program that echoes the datagram and
then has the same frames of the buses, without any work.

The client has a fixed schedule: it sends each cycle's frame when it is due, whatever the result of the last one. An answer
counts if it arrives before the next frame is sent; later the cycle is missed and counts with the whole period. So a slow
gateway cannot hide its delay by slowing the client (coordinated omission). The floor gets its datagram half a period later.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from pdgw.base.durations import MS, SECOND, US
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.service.status_client import fetch
from pdgw.peers.bus import INTERFACE
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.demo.links import free_ports

ROWS = ((1, 3, 1), (8, 3, 1), (1, 3, 4), (8, 3, 4), (64, 3, 4), (30, 30, 10))
"""Axes, axes on each bus, and cycle time in milliseconds."""
TITLES = ("axes", "on a bus", "cycle", "", "p50", "p99", "p99.9", "missed", "CPU a cycle", "memory")
_OFF, _ON = 0x047E, 0x047F
_STATE, _READY, _OPERATION = 0x4F, 0x01, 0x07
_SPEEDS, _SPEED_STEP = 64, 128
"""Setpoints used in turn, far enough apart to be distinguished in the actual values."""
_PATIENCE_S = 120
_LARGEST = 2048


class Echo:
    """Numbered datagrams of a size. ``answers``: data can only be an answer to the last one."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._number = 0

    def datagram(self) -> bytes:
        self._number += 1
        return self._number.to_bytes(self._size, "big")

    def answers(self, data: bytes) -> bool:
        return int.from_bytes(data, "big") == self._number


def _speed(cycle: int) -> int:
    """Each setpoint follows its negative, so that the shafts stay in place: the gateway compares speed and position."""
    size = cycle % _SPEEDS // 2 + 1
    return (size if cycle % 2 else -size) * _SPEED_STEP


class Axes:
    """A PLC with telegram 1 on every axis, that sends another speed in each cycle."""

    def __init__(self, axes: int, period_ns: int) -> None:
        self._endpoint = PlcEndpoint([telegram(1)] * axes, period_ns)
        self._cycle = 0
        self._words = [_OFF] * axes

    def datagram(self) -> bytearray:
        self._cycle += 1
        self._endpoint.setpoints = [{"STW1": word, "NSOLL_A": _speed(self._cycle)} for word in self._words]
        return self._endpoint.build(time.monotonic_ns())

    def answers(self, data: bytes) -> bool:
        """Whether the drives have the speed of the last cycle: then the gateway has processed this cycle's frame."""
        self._endpoint.receive(data, time.monotonic_ns())
        first = self._endpoint.actuals[0]
        return first is not None and abs(first["NIST_A"] - _speed(self._cycle - 1)) < _SPEED_STEP / 2

    @property
    def _states(self) -> list[int]:
        return [0 if item is None else item["ZSW1"] & _STATE for item in self._endpoint.actuals]

    @property
    def operating(self) -> bool:
        """Whether every axis is in operation."""
        return all(state == _OPERATION for state in self._states)

    def enable(self) -> None:
        """Send ON to the axes that are ready or on, OFF to the others."""
        self._words = [_ON if state & _READY else _OFF for state in self._states]


class Peer:
    """The datagrams to a port of this machine, and the latencies of its answers in nanoseconds."""

    def __init__(self, port: int, dialogue: Echo | Axes) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.setblocking(False)
        self._dialogue = dialogue
        self.begin()
        self._sent = 0
        self._late = False
        """The answer to an earlier cycle may still arrive."""
        self._arrived: list[tuple[int, bytes]] = []

    def begin(self) -> None:
        """Start a new measurement."""
        self.samples: list[int] = []
        self.missed = 0

    def send(self) -> None:
        self.run_out()
        datagram = self._dialogue.datagram()
        self._sent = time.monotonic_ns()
        with contextlib.suppress(ConnectionRefusedError):
            self.socket.send(datagram)

    def take(self) -> None:
        """Read what has arrived."""
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            while True:
                data = self.socket.recv(_LARGEST)
                self._arrived.append((time.monotonic_ns(), data))

    def run_out(self) -> None:
        """End the period of the last datagram."""
        self.take()
        if self._sent:
            sure = [when for when, data in self._arrived if self._dialogue.answers(data) or not self._late]
            if sure:
                self.samples.append(sure[0] - self._sent)
            else:
                self.missed += 1
            self._late = not sure
        self._arrived.clear()
        self._sent = 0

    def percentiles(self, period_ns: int) -> list[float]:
        """Microseconds of 50 %, 99 % and 99.9 % of the cycles."""
        ordered = sorted([*self.samples, *[period_ns] * self.missed])
        return [ordered[int(share * len(ordered))] / US for share in (0.5, 0.99, 0.999)]


def run(peers: Sequence[Peer], cycles: int, period_ns: int) -> None:
    """Run cycles with each peer, spread over the period so that they do not disturb each other."""
    by_socket = {peer.socket: peer for peer in peers}
    gc.disable()
    start = time.monotonic_ns() + period_ns
    for number in range(cycles * len(peers)):
        due = start + number * period_ns // len(peers)
        while (left := due - time.monotonic_ns()) > 0:
            for ready in select.select(list(by_socket), [], [], left / SECOND)[0]:
                by_socket[ready].take()
        peers[number % len(peers)].send()
    time.sleep(period_ns / SECOND)
    for peer in peers:
        peer.run_out()
    gc.enable()


class Taken(NamedTuple):
    """What a process takes: latencies in microseconds (50 %, 99 %, 99.9 %), cycles without an answer in their period, CPU of a
    cycle of all its threads.
    """

    latencies: list[float]
    missed: int
    cpu_us: float

    def cells(self) -> tuple[str, ...]:
        """As the table has it."""
        return (*(f"{value:.0f} us" for value in self.latencies), str(self.missed), f"{self.cpu_us:.0f} us")


class Row(NamedTuple):
    """Floor and gateway with as many axes, and the gateway's memory."""

    floor: Taken
    gateway: Taken
    resident_mib: float


def measure(axes: int, per_bus: int, cycle_ms: float, seconds: float) -> Row:
    """Measure a row. GatewayError when the axes do not stay in operation."""
    period_ns = round(cycle_ms * MS)
    cycles = max(_SPEEDS, int(seconds * SECOND) // period_ns)
    plc = Axes(axes, period_ns)
    with ExitStack() as at_end:
        floor_pid, floor_port = at_end.enter_context(_floor(axes, per_bus))
        floor = Peer(floor_port, Echo(len(plc.datagram())))
        pid, port = at_end.enter_context(_gateway(axes, per_bus, cycle_ms))
        peer = Peer(port, plc)
        for _ in range(_PATIENCE_S * SECOND // (10 * period_ns)):
            run([peer], 10, period_ns)
            if plc.operating:
                break
            plc.enable()
        peer.begin()
        peers = {floor_pid: floor, pid: peer}
        before = {process: cpu_ns(process) for process in peers}
        run([peer, floor], cycles, period_ns)
        used = {process: (cpu_ns(process) - before[process]) / cycles / US for process in peers}
        if not plc.operating or not peer.samples:
            raise GatewayError(f"the axes left operation; {peer.missed} of {cycles} cycles had no answer")
        pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
        memory = pages * os.sysconf("SC_PAGE_SIZE") / (1 << 20)
        least, ours = (
            Taken(item.percentiles(period_ns), item.missed, used[process]) for process, item in peers.items()
        )
        return Row(least, ours, memory)


def rows(seconds: float) -> Iterator[tuple[str, ...]]:
    """The lines of the table: gateway and floor of each row, then how many times as much the gateway takes."""
    for axes, per_bus, cycle_ms in ROWS:
        place = (str(axes), str(per_bus), f"{cycle_ms:g} ms")
        try:
            row = measure(axes, per_bus, cycle_ms, seconds)
        except GatewayError as error:
            yield (*place, f"refused: {error}")
            continue
        yield (*place, "gateway", *row.gateway.cells(), f"{row.resident_mib:.0f} MiB")
        yield ("", "", "", "floor", *row.floor.cells())
        ratios = (f"{ours / least:.2f}" for ours, least in zip(row.gateway.latencies, row.floor.latencies, strict=True))
        yield ("", "", "", "ratio", *ratios, "", f"{row.gateway.cpu_us / row.floor.cpu_us:.2f}")


def cpu_ns(pid: int) -> int:
    """CPU time that a process used until now, all threads."""
    threads = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((thread / "schedstat").read_text(encoding="ascii").split()[0]) for thread in threads)


@contextmanager
def _started(*command: str) -> Iterator[tuple[int, str]]:
    """Start a process that prints a line when it is ready and ends with its standard input; its number and the line."""
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.pid, process.stdout.readline()
        finally:
            process.communicate(timeout=_PATIENCE_S)


@contextmanager
def _floor(axes: int, per_bus: int) -> Iterator[tuple[int, int]]:
    """Start the floor; its process and port. It needs a C compiler."""
    with tempfile.TemporaryDirectory() as folder:
        program = str(Path(folder) / "floor")
        subprocess.run(["cc", "-O2", "-o", program, str(Path(__file__).with_name("floor.c"))], check=True)
        with _started(program, str(axes), str(per_bus)) as (pid, line):
            yield pid, int(line)


@contextmanager
def _gateway(axes: int, per_bus: int, cycle_ms: float) -> Iterator[tuple[int, int]]:
    """Start ideal drives and ``pdgw run``; its process and port when all axes are online."""
    cyclic, acyclic = free_ports(socket.SOCK_DGRAM, 2)
    (status,) = free_ports(socket.SOCK_STREAM, 1)
    text = f"[transport]\ncycle_time_ms = {cycle_ms:g}\nwatchdog_factor = 255\n"
    text += f"cyclic_port = {cyclic}\nacyclic_port = {acyclic}\nstatus_port = {status}\n"
    with ExitStack() as at_end:
        folder = Path(at_end.enter_context(tempfile.TemporaryDirectory()))
        drives = (sys.executable, "-m", "tests.long.bench.drives", str(axes), str(per_bus))
        _, channels = at_end.enter_context(_started(*drives))
        for bus, channel in enumerate(channels.split()):
            text += f'[[can]]\nname = "can{bus}"\ninterface = "{INTERFACE}"\nchannel = "{channel}"\n'
        for axis in range(axes):
            text += f'[[axis]]\ndo_id = {axis + 1}\nnode_id = {axis % per_bus + 1}\ncan = "can{axis // per_bus}"\n'
            # The ideal drive sends TPDOs only as answers.
            text += "telegram = 1\ntpdo_event_ms = 10000\nheartbeat_ms = 1000\n"
        config, log = folder / "gateway.toml", folder / "gateway.log"
        config.write_text(text, encoding="utf-8")
        errors = at_end.enter_context(log.open("w"))
        command = [sys.executable, "-m", "pdgw", "run", str(config)]
        process = at_end.enter_context(subprocess.Popen(command, stdout=errors, stderr=errors))
        at_end.callback(process.terminate)
        deadline = time.monotonic() + _PATIENCE_S
        while _online(status) < axes:
            if process.poll() is not None or time.monotonic() > deadline:
                raise GatewayError(f"the gateway did not start: {log.read_text()[-500:]}")
            time.sleep(0.1)
        yield process.pid, cyclic


def _online(port: int) -> int:
    with contextlib.suppress(GatewayError):
        return sum(axis["drive"] == "online" for axis in fetch(port)["axes"])
    return 0
