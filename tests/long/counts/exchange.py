"""System calls and bytecodes of the gateway in one cycle of the PLC, on real sockets in one thread.

Between the gateway's calls this thread simulates the PLC and the drives, so that their frames have the same order in each
run. The clock of the gateway's loop is advanced from one event to the next.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from types import FrameType
from typing import Any, cast

from can.interfaces.socketcan import SocketcanBus

from pdgw.ds301.bus.can_frame import CAN_FRAME
from pdgw.ds301.bus.port import CanPort, SocketPort
from pdgw.ds301.loop.loop import SystemLoop
from pdgw.ds301.loop.readiness import EpollReadiness
from pdgw.durations import MS, SECOND
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.configuration.tables.environment import CanConfig
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.udp import UdpSocket
from pdgw.peers.bus import Hub
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram
from tests.long.bench.processes.drives import IdealDrives, buses
from tests.long.counts.axis_cycle import counting

AXES = (1, 8)
CYCLE_NS = 4 * MS
_OFF, _ON = 0x047E, 0x047F
_STATE, _IN_OPERATION = 0x4F, 0x07
_PATIENCE = 4000
"""Limit of the cycles until all axes are in operation."""
_CYCLES = 200
_TRACED = 50
_NO_CALLS = {"fileno"}
_MODULES = (select, sys.modules[os.name])
_SPEEDS, _SPEED_STEP = 64, 4
"""Each drive gets a new low setpoint in each cycle."""
_HEARTBEAT_MS = 10_000
"""The simulated drives use the machine's clock, not that of the gateway's loop."""
_A_MOMENT_S = 1e-6
_LARGEST = 2048


def system_calls(axes: int) -> dict[str, float]:
    """System calls of one cycle with telegram 1 on every axis, by name, in the most frequent kind of cycle.

    Cycles in which a heartbeat or a parameter is due have more. GatewayError if the axes do not get into operation.
    """
    with ExitStack() as at_end:
        bench = _in_operation(axes, at_end)
        found: Counter[tuple[tuple[str, int], ...]] = Counter()
        for _ in range(_CYCLES):
            bench.calls.clear()
            bench.cycle()
            found[tuple(sorted(bench.calls.items()))] += 1
        ((calls, _),) = found.most_common(1)
        return {name: float(count) for name, count in calls}


def bytecodes(axes: int) -> dict[str, float]:
    """Bytecodes of one cycle of the whole gateway, by function (``module:name``), as the average of 200 ms.

    In 200 ms, each comparison of position and speed is due twice and each check of the units four times. GatewayError as
    ``system_calls``.
    """
    with ExitStack() as at_end:
        bench = _in_operation(axes, at_end)
        counts: Counter[str] = Counter()
        bench.trace = counting(counts)
        for _ in range(_TRACED):
            bench.cycle()
        return {name: count / _TRACED for name, count in counts.items() if "tests.long." not in name}


def _in_operation(axes: int, at_end: ExitStack) -> _Bench:
    bench = _Bench(axes, at_end)
    for _ in range(_PATIENCE):
        if bench.cycle():
            return bench
    raise GatewayError(f"counts: {axes} axes are not in operation after {_PATIENCE} cycles")


class _Wire:
    """A CAN bus with two ends: for the gateway the socket of a python-can bus, for the drives a hub."""

    channel = "wire"

    def __init__(self) -> None:
        self.socket, self._drives = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._drives.setblocking(False)
        self._receive: Callable[[bytes], None] = lambda _: None

    def attach(self, receive: Callable[[bytes], None]) -> Callable[[bytes], None]:
        self._receive = receive
        return self._send

    def _send(self, frame: bytes) -> None:
        self._drives.send(frame)

    def pump(self) -> None:
        """Deliver what the gateway sent."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self._receive(self._drives.recv(CAN_FRAME.size))

    def shutdown(self) -> None:
        self.socket.close()
        self._drives.close()


class _Bench:
    """Gateway, PLC and drives. It is also the platform of the gateway."""

    has_services = False

    def __init__(self, axes: int, at_end: ExitStack) -> None:
        self._time = time.monotonic_ns()
        self.calls: Counter[str] = Counter()
        self.trace: Callable[[FrameType, str, Any], Any] | None = None
        """For ``sys.settrace`` during the gateway's part of a cycle."""
        self._real = EpollReadiness()
        self.loop = SystemLoop(self, lambda: self._time)
        self._wires = [_Wire() for _ in buses(axes)]
        self._opened = iter(self._wires)
        self._drives = [
            IdealDrives(cast(Hub, wire), count) for wire, count in zip(self._wires, buses(axes), strict=True)
        ]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        at_end.callback(self._socket.close)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._plc = PlcEndpoint([telegram(1)] * axes, CYCLE_NS)
        self._daemon = build_gateway(parse_config(_configuration(axes)), self)
        at_end.callback(self._daemon.release)
        self._daemon.start()
        self._due = self._time
        self._cycles = 0

    def cycle(self) -> bool:
        """Send a frame, then run the gateway until the next one is due. True if all axes are in operation."""
        self._due += CYCLE_NS
        self._cycles += 1
        words = [values["ZSW1"] if values else 0 for values in self._plc.actuals]
        on = all(word & _STATE for word in words)
        for index, _ in enumerate(words):
            self._plc.set(index, {"STW1": _ON if on else _OFF, "NSOLL_A": self._cycles % _SPEEDS * _SPEED_STEP})
        self._socket.sendto(self._plc.build(), self._daemon.address)
        before, traced = sys.getprofile(), sys.gettrace()
        sys.setprofile(self._count)
        sys.settrace(self.trace or traced)
        try:
            self.loop.run()
        finally:
            sys.settrace(traced)
            sys.setprofile(before)
        with contextlib.suppress(BlockingIOError):
            while True:
                self._plc.receive(self._socket.recv(_LARGEST))
        return all(word & _STATE == _IN_OPERATION for word in words)

    # -- the platform of the gateway ----------------------------------------------------------------------------------

    def open_can(self, _: CanConfig) -> CanPort:
        return SocketPort(self.loop, cast(SocketcanBus, next(self._opened)))

    def tick_offset(self) -> int:
        return 0

    def open_udp(self, listen: str, port: int, purpose: str) -> UdpSocket:
        return UdpSocket(self.loop, listen, port, purpose)

    # -- the readiness of its loop ------------------------------------------------------------------------------------

    def watch(self, descriptor: int, *, read: bool, write: bool) -> None:
        self._real.watch(descriptor, read=read, write=write)

    def wait(self, seconds: float) -> list[tuple[int, int]]:
        """Wait like the real loop, but advance the time at once when no data is there."""
        profile, trace = sys.getprofile(), sys.gettrace()
        sys.setprofile(None)
        sys.settrace(None)
        for wire in self._wires:
            wire.pump()
        pending = self._real.wait(0)
        if not pending and seconds:
            self._time = min(self._time + max(int(seconds * SECOND), 1), self._due)
            for drives in self._drives:
                drives.poll(self._time)
            if self._time == self._due:
                self.loop.stop()
            seconds = min(seconds, _A_MOMENT_S)
        sys.settrace(trace)
        sys.setprofile(profile)
        return self._real.wait(seconds)

    def close(self) -> None:
        self._real.close()

    def _count(self, _frame: FrameType, event: str, function: Any) -> None:
        if event == "c_call" and function.__name__ not in _NO_CALLS:
            owner = getattr(function, "__self__", None)
            if isinstance(owner, socket.socket | select.epoll) or any(owner is module for module in _MODULES):
                self.calls[function.__name__] += 1


def _configuration(axes: int) -> str:
    """Telegram 1 on every axis, without features beside the exchange."""
    parts = [f"[transport]\ncyclic_port = 0\nacyclic_port = 0\nstatus_port = 0\ncycle_time_ms = {CYCLE_NS / MS}\n"]
    number = 0
    for bus, count in enumerate(buses(axes)):
        parts.append(f'[[can]]\nname = "bus{bus}"\ninterface = "virtual"\nchannel = "{bus}"\n')
        for node in range(1, count + 1):
            number += 1
            parts.append(
                f'[[axis]]\ndo_id = {number}\nnode_id = {node}\ntelegram = 1\ncan = "bus{bus}"\nheartbeat_ms = {_HEARTBEAT_MS}\n'
            )
    return "".join(parts)
