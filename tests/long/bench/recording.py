"""Cost of the flight recorder and of the time statistics in each cycle."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pdgw.durations import MS
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.example import simulated
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.peers.world import World
from tests.long.bench.measuring.measure import nanoseconds_per_call

_AXES = (1, 32)
_CYCLE_NS = MS
_ANSWER_NS = 150_000
_FRAME = bytes(8)


@dataclass(frozen=True, slots=True)
class RecordingCost:
    """Nanoseconds of a cycle without axes, of each axis, of a CAN frame; and of a cycle without the recorder."""

    cycle_ns: float
    axis_ns: float
    frame_ns: float
    times_ns: float


def run() -> RecordingCost:
    """Fit a straight line through the costs with few and with many axes."""
    few, many = (_cost(count) for count in _AXES)
    axis_ns = (many[0] - few[0]) / (_AXES[1] - _AXES[0])
    return RecordingCost(few[0] - axis_ns * _AXES[0], axis_ns, few[1], few[2])


def _cost(axes: int) -> tuple[float, float, float]:
    with tempfile.TemporaryDirectory(prefix="pdgw-") as directory:
        daemon = build_gateway(simulated([1] * axes), World(0))
        try:
            times = nanoseconds_per_call(_cycles(daemon))
            recorder = FlightRecorder(daemon, Path(directory), "bench")
            try:
                cycle = nanoseconds_per_call(_cycles(daemon)) - times
                network = next(iter(daemon.networks.values()))
                tap = network.tap
                assert tap is not None
                frame = nanoseconds_per_call(lambda: tap(0x181, _FRAME, 0, _CYCLE_NS))
            finally:
                recorder.stop()
        finally:
            daemon.release()
    return cycle, frame, times


def _cycles(daemon: Daemon) -> Callable[[], object]:
    """The function that the cyclic loop calls, with a new time each."""
    watch, now = daemon.watch, daemon.loop.now()

    def run() -> None:
        nonlocal now
        now += _CYCLE_NS
        watch.cycle(now, True, now + _ANSWER_NS)

    return run
