"""One row of the benchmark: a number of axes at one cycle time, compared with a plain echo of the same run.

From 1 ms on the echo is queried in every cycle, half a period after the gateway. With shorter cycles they would disturb each
other, so the echo is measured alone before and after. A row is rejected if its axes are not in operation, or if its drives
did not get an RPDO for each answered cycle.
"""

from __future__ import annotations

import bisect
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import Protocol

from pdgw.durations import MS, SECOND, SECONDS_PER_MINUTE
from pdgw.gateway.errors import GatewayError
from tests.long.bench.measuring.dialogues import SPEEDS, EchoDialogue, PlcDialogue
from tests.long.bench.measuring.histogram import Histogram
from tests.long.bench.measuring.measure import Latency, latency
from tests.long.bench.measuring.schedule import Peer, flat_out, run
from tests.long.bench.processes import processes
from tests.long.bench.processes.processes import USUAL_SCHEDULING, running

ROWS = (
    (1, MS),
    (4, 4 * MS),
    (8, MS),
    (1, MS // 2),
    (1, MS // 4),
    (16, 2 * MS),
    (32, 4 * MS),
    (64, 4 * MS),
)
"""Axes and cycle time of ``python -m tests.long bench``."""
_SIDE_BY_SIDE_NS = 1 * MS
_FLAT_OUT_SHARE = 0.3
"""Share of a row's time without a fixed cycle."""
_MINUTE_NS = SECONDS_PER_MINUTE * SECOND


@dataclass(frozen=True, slots=True)
class Row:
    """The figures of a row. ``missed`` of a latency: cycles whose answer (or RPDO) did not arrive within the period."""

    axes: int
    period_ns: int
    echo_in: str
    """Language of the echo: C, or Python without a compiler."""
    echo: Latency
    gateway: Latency
    echo_at_socket: Latency
    gateway_at_socket: Latency
    """From the kernel's time stamps of the answers at the client's socket, without the delay of the client."""
    to_can: Latency
    """From the PLC's send to the RPDO at the drive of the last axis."""
    slept: int
    """Cycles without a frame because the client was not running."""
    echo_per_s: float
    """Cycles per second without a fixed cycle."""
    gateway_per_s: float
    lost_flat_out: int
    """Cycles of these without an RPDO at a drive."""
    cpu_ns_per_cycle: float | None
    """CPU time of the gateway, all threads; None where the system has no figure."""
    resident_bytes: int | None
    start_s: float
    """From the start of the process until all axes are online."""

    @property
    def ratio_p50(self) -> float:
        """p50 of the gateway divided by p50 of the echo."""
        return self.gateway.p50 / self.echo.p50

    @property
    def ratio_p99(self) -> float:
        """p99 of the gateway divided by p99 of the echo."""
        return self.gateway.p99 / self.echo.p99

    @property
    def cpu_share(self) -> float | None:
        """Share of one core, 0 and up."""
        return None if self.cpu_ns_per_cycle is None else self.cpu_ns_per_cycle / self.period_ns


@dataclass(frozen=True, slots=True)
class Refused:
    """A rejected row and the reason."""

    axes: int
    period_ns: int
    why: str


def measure(
    axes: int, period_ns: int, seconds: float, more: str = USUAL_SCHEDULING, interfaces: Sequence[str] = ()
) -> Row:
    """Measure a row for about ``seconds``. GatewayError when the axes do not follow.

    ``more``: further tables of the gateway's configuration. ``interfaces``: CAN interfaces of the kernel for the drives.
    """
    cycles = max(2 * SPEEDS, int(seconds * SECOND) // period_ns)
    plc = PlcDialogue(axes, period_ns)
    side_by_side = period_ns >= _SIDE_BY_SIDE_NS
    with ExitStack() as at_end:
        port, language = at_end.enter_context(processes.echo())
        echo = at_end.enter_context(closing(Peer(port, EchoDialogue(plc.size))))
        echo_per_s = flat_out(echo, seconds * _FLAT_OUT_SHARE).per_s
        echo.begin()
        if not side_by_side:
            run([echo], cycles // 2, period_ns)
        with running(axes, period_ns, more, interfaces) as (drives, daemon):
            start_s = daemon.wait_online(axes)
            with closing(Peer(daemon.cyclic_port, plc)) as peer:
                plc.enable(peer, period_ns)
                peer.begin()
                drives.mark()
                cpu = daemon.cpu_ns()
                run([peer, echo] if side_by_side else [peer], cycles, period_ns)
                used = None if cpu is None else (daemon.cpu_ns() or 0) - cpu
                to_can = setpoints_to_can(peer, plc, drives, period_ns)
                answers, at_socket, slept = peer.latency(period_ns), peer.socket_latency(period_ns), peer.slept
                drives.mark()
                fastest = flat_out(peer, seconds * _FLAT_OUT_SHARE)
                drives.report()  # after this answer, all earlier frames have reached the drives
                lost = max(0, fastest.cycles - min(drives.report()[0]))
            resident = daemon.resident_bytes()
        if not side_by_side:
            run([echo], cycles // 2, period_ns)
        return Row(
            axes=axes,
            period_ns=period_ns,
            echo_in=language,
            echo_at_socket=echo.socket_latency(period_ns),
            gateway_at_socket=at_socket,
            echo=echo.latency(period_ns),
            gateway=answers,
            to_can=to_can,
            slept=slept,
            echo_per_s=echo_per_s,
            gateway_per_s=fastest.per_s,
            lost_flat_out=lost,
            cpu_ns_per_cycle=None if used is None else used / cycles,
            resident_bytes=resident,
            start_s=start_s,
        )


class Report(Protocol):
    """The drives' report of a measurement."""

    def report(self) -> tuple[list[int], list[tuple[int, int]]]: ...


def setpoints_to_can(peer: Peer, plc: PlcDialogue, drives: Report, period_ns: int) -> Latency:
    """Latency of each cycle's setpoint at the last drive. GatewayError unless all drives got setpoints and operate."""
    rpdos, log = drives.report()
    if not plc.operating(peer.newest):
        words = ", ".join(f"{word:04X}h" for word in plc.states(peer.newest))
        raise GatewayError(f"benchmark: axes left operation: ZSW1 {words}")
    # On a disturbed machine a frame can arrive after the next one, and a spontaneous answer of the gateway look like its
    # answer.
    if min(rpdos) < len(peer.samples) - peer.missed - peer.slept:
        raise GatewayError(f"benchmark: {len(peer.samples)} cycles were answered, RPDOs of the axes: {rpdos}")
    highest = max(velocity for _, velocity in log)
    if highest <= 0:
        raise GatewayError("benchmark: the axes do not turn")
    # The speeds repeat: an RPDO belongs to the latest cycle with its speed.
    sent: list[list[int]] = [[] for _ in range(SPEEDS)]
    for cycle, when in peer.sent.items():
        sent[cycle % SPEEDS].append(when)
    arrived: dict[int, int] = {}
    for when, velocity in log:
        times = sent[round(velocity * (SPEEDS - 1) / highest)]
        if position := bisect.bisect_right(times, when):
            arrived.setdefault(times[position - 1], when)
    return latency([when - begin for begin, when in arrived.items()], len(peer.sent) - len(arrived), period_ns)


def idle(axes: int, period_ns: int, seconds: float) -> float | None:
    """Share of a core used by a gateway with ``axes`` online and no PLC. None where the system has no figure."""
    with running(axes, period_ns) as (_, daemon):
        daemon.wait_online(axes)
        begin, cpu = time.monotonic_ns(), daemon.cpu_ns()
        time.sleep(seconds)
        used = daemon.cpu_ns()
        return None if cpu is None or used is None else (used - cpu) / (time.monotonic_ns() - begin)


@dataclass(frozen=True, slots=True)
class Endurance:
    """A measurement of hours: the latencies at the client."""

    echo: Histogram
    gateway: Histogram
    stops: int
    """Minutes at whose end an axis was not in operation."""
    slept: int
    """Cycles without a frame because the client was not running."""
    resident_bytes: tuple[int | None, int | None]
    """Memory of the gateway after the first minute and at the end."""


def endure(axes: int, period_ns: int, minutes: int, progress: Callable[[str], None]) -> Endurance:
    """Measure minute after minute on one gateway, with the echo half a period after it.

    The axes are enabled again before each minute: evaluating the minute before takes longer than the watchdog time.
    """
    plc, histograms = PlcDialogue(axes, period_ns), (Histogram(), Histogram())
    stops = slept = 0
    memory: list[int | None] = []
    with ExitStack() as at_end:
        port, _ = at_end.enter_context(processes.echo())
        echo = at_end.enter_context(closing(Peer(port, EchoDialogue(plc.size))))
        _, daemon = at_end.enter_context(running(axes, period_ns))
        daemon.wait_online(axes)
        peer = at_end.enter_context(closing(Peer(daemon.cyclic_port, plc)))
        for minute in range(minutes):
            progress(f"minute {minute + 1} of {minutes}")
            plc.enable(peer, period_ns)
            peer.begin()
            echo.begin()
            run([peer, echo], _MINUTE_NS // period_ns, period_ns)
            stops += not plc.operating(peer.newest)
            slept += peer.slept
            for histogram, measured in zip(histograms, (echo, peer), strict=True):
                histogram.add(measured.samples, measured.missed, period_ns)
            memory.append(daemon.resident_bytes())
    return Endurance(*histograms, stops, slept, (memory[0], memory[-1]))
