"""The cyclic exchange while an unknown sender floods a port of the gateway, alternating with quiet phases.

``python -m tests.long.bench.flood PORT KIND RATE`` is the sender. It sends RATE datagrams a second from its own port:
``cyclic``: frames like the PLC's, ``acyclic``: calls that read a record. It prints how many it sent when its standard input
ends.
"""

from __future__ import annotations

import select
import socket
import sys
import time
from contextlib import nullcontext
from dataclasses import dataclass
from uuid import UUID

from pdgw.durations import MS
from pdgw.profinet.rpc.client import RecordCaller
from pdgw.profinet.rpc.dcerpc import object_uuid
from tests.long.bench.measuring.dialogues import PlcDialogue
from tests.long.bench.measuring.measure import Latency
from tests.long.bench.phases import QUIET, in_turn, lower_priority
from tests.long.bench.processes.processes import Background, Gateway, module

AXES = 4
PERIOD_NS = 4 * MS
RATE = 20_000
CYCLIC, ACYCLIC = "cyclic", "acyclic"
_BURST_S, _BEHIND_S = 0.001, 0.02
_IM0 = 0xAFF0


@dataclass(frozen=True, slots=True)
class Flood:
    """The result. ``missed``: cycles without an answer in time. ``slept``: cycles that the client itself missed."""

    port: str
    quiet: Latency
    flooded: Latency
    slept: int
    datagrams_per_s: float


def measure(port: str, seconds: float, phases: int = 3) -> Flood:
    """Flood the ``port`` (CYCLIC or ACYCLIC) in this number of phases, each after a quiet phase. ``seconds``: total of each
    kind.
    """
    found = in_turn(
        AXES, PERIOD_NS, seconds, phases, {port: lambda gateway: nullcontext(_unknown_sender(port, gateway))}
    )
    flooded = found[port]
    return Flood(port, found[QUIET].latency, flooded.latency, flooded.slept, flooded.per_s)


def _unknown_sender(port: str, gateway: Gateway) -> Background:
    number = gateway.cyclic_port if port == CYCLIC else gateway.acyclic_port
    return module("tests.long.bench.flood", str(number), port, str(RATE))


def datagram(kind: str) -> bytes:
    """The datagram of the flood."""
    if kind == CYCLIC:
        return bytes(PlcDialogue(AXES, PERIOD_NS).datagram(0))
    return RecordCaller(UUID(int=99), object_uuid(1, 1, 1)).read(0, 0, 1, _IM0, implicit=True).packets[0]


def main() -> None:
    """Send the flood."""
    lower_priority()
    port, kind, rate = int(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    data = datagram(kind)
    sent, burst = 0, int(rate * _BURST_S)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        target = ("127.0.0.1", port)
        sock.setblocking(False)
        print("ready", flush=True)
        due = time.monotonic()
        while not select.select([sys.stdin], [], [], max(0.0, due - time.monotonic()))[0]:
            # Send late what was not sent while the others had the core, within limits.
            due = max(due + _BURST_S, time.monotonic() - _BEHIND_S)
            for _ in range(burst):
                try:
                    sock.sendto(data, target)
                    sent += 1
                except (BlockingIOError, ConnectionRefusedError):
                    continue  # buffer full, or no receiver at the moment
    print(sent, flush=True)


if __name__ == "__main__":
    main()
