"""End-to-end latency of the gateway against a plain UDP echo, in turn in the same run."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.bench.measure import Latency, Peer, paced
from pdgw.tools.commands.status import fetch

PERIOD_NS = 1_000_000
GOAL_RATIO = 3.0
_READY_S = 60
_ENABLED = 0x0637


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """One comparison."""

    axes: int
    echo: Latency
    gateway: Latency
    cycles_per_s: float
    can_frames_per_s: float

    @property
    def ratio(self) -> float:
        """p50 of the gateway over p50 of the echo."""
        return self.gateway.p50 / self.echo.p50


@contextmanager
def background(module: str, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A helper process that prints a line when it is ready and ends with its standard input."""
    with subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as child:
        if child.stdin is None or child.stdout is None:
            raise GatewayError(f"{module}: no pipes")
        try:
            line = child.stdout.readline()
            if not line:
                raise GatewayError(f"{module} did not start")
            yield child, line
        finally:
            child.stdin.close()
            child.wait(30)


@contextmanager
def process(module: str, *arguments: str) -> Iterator[list[int]]:
    """As ``background``, for one whose line has the ports it listens on."""
    with background(module, *arguments) as (_, line):
        yield [int(port) for port in line.split()]


class Plc:
    """A PLC with telegram 1 on every axis, whose speed changes with every frame."""

    def __init__(self, axes: int) -> None:
        self.endpoint = PlcEndpoint([telegram(1)] * axes, PERIOD_NS)
        self.word = 0x047E
        self.speed = 0

    def frame(self) -> bytearray:
        self.speed = (self.speed + 7) & 0x1FFF
        for axis in self.endpoint.setpoints:
            axis["STW1"] = self.word
            axis["NSOLL_A"] = self.speed
        return self.endpoint.build()

    def enable(self, peer: Peer) -> None:
        deadline = time.monotonic() + _READY_S
        while True:
            answer = peer.exchange()
            if answer is not None and self.endpoint.receive(answer):
                words = [axis["ZSW1"] if axis else 0 for axis in self.endpoint.actuals]
                if all(word & 0x4F == 0x01 for word in words):
                    self.word = 0x047F
                elif all(word & 0x4F == 0x07 for word in words):
                    return
                elif any(word & 0x40 for word in words):
                    self.word = 0x047E  # inhibited, by a watchdog on a busy machine: OFF is needed again
            if time.monotonic() > deadline:
                raise GatewayError("benchmark: the axes did not reach operation")


def run(axes: int, cycles: int) -> RoundTrip:
    """Compare at 1 kHz, then count cycles flat out for about a second."""
    with process("pdgw.tools.bench.echo") as (echo_port,), process("pdgw.tools.bench.instant", str(axes)) as ports:
        plc = Plc(axes)
        gateway = Peer(ports[0], plc.frame)
        size = len(plc.frame())
        echo = Peer(echo_port, lambda: bytes(size))
        try:
            plc.enable(gateway)
            gateway.samples.clear()
            paced([echo, gateway], cycles, PERIOD_NS)
            at_pace = gateway.latency()
            before = _can_frames(ports[1])
            start = time.perf_counter()
            count = max(1, cycles)
            for _ in range(count):
                gateway.exchange()
            elapsed = time.perf_counter() - start
            after = _can_frames(ports[1])
        finally:
            gateway.close()
            echo.close()
    return RoundTrip(axes, echo.latency(), at_pace, count / elapsed, (after - before) / elapsed)


def _can_frames(status_port: int) -> int:
    """Frames of all buses in both directions so far."""
    return sum(int(bus["sent"]) + int(bus["received"]) for bus in fetch(status_port)["buses"])
