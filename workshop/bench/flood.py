"""The cyclic exchange while a stranger floods a port of the gateway, in turn with quiet phases of the same run.

``python -m pdgw.workshop.bench.flood PORT KIND RATE`` is the stranger: it sends so many datagrams a second from its own port,
``cyclic``: frames as the PLC's, ``acyclic``: calls that read a record; it prints how many left when its standard input ends.
"""

from __future__ import annotations

import os
import select
import socket
import sys
import time
from contextlib import closing
from dataclasses import dataclass
from uuid import UUID

from pdgw.durations import MS, SECOND
from pdgw.profinet.rpc.client import RecordCaller
from pdgw.profinet.rpc.dcerpc import object_uuid
from pdgw.workshop.bench.measuring.dialogues import PlcDialogue
from pdgw.workshop.bench.measuring.measure import Latency, latency
from pdgw.workshop.bench.measuring.schedule import Peer, run
from pdgw.workshop.bench.processes.processes import Background, Gateway, module, running

AXES = 4
PERIOD_NS = 4 * MS
RATE = 20_000
CYCLIC, ACYCLIC = "cyclic", "acyclic"
_BURST_S, _BEHIND_S = 0.001, 0.02
_IM0 = 0xAFF0


@dataclass(frozen=True, slots=True)
class Flood:
    """One comparison. ``missed`` counts cycles without an answer in time; ``slept`` those the client itself slept through."""

    port: str
    quiet: Latency
    flooded: Latency
    slept: int
    datagrams_per_s: float


def measure(port: str, seconds: float, phases: int = 3) -> Flood:
    """Flood the ``port`` (CYCLIC or ACYCLIC) in so many phases, each after a quiet one, for about ``seconds`` each in sum."""
    cycles = max(1, int(seconds * SECOND) // PERIOD_NS // phases)
    plc = PlcDialogue(AXES, PERIOD_NS)
    samples: dict[bool, list[int]] = {False: [], True: []}
    missed = {False: 0, True: 0}
    slept = 0
    sent, elapsed = 0, 0.0
    with running(AXES, PERIOD_NS) as (_, gateway):
        gateway.wait_online(AXES)
        with closing(Peer(gateway.cyclic_port, plc)) as peer:

            def phase(flooded: bool) -> None:
                plc.enable(peer, PERIOD_NS)
                peer.begin()
                run([peer], cycles, PERIOD_NS)
                samples[flooded] += peer.samples
                missed[flooded] += peer.missed

            for _ in range(phases):
                phase(flooded=False)
                stranger = _stranger(port, gateway)
                start = time.monotonic()
                try:
                    phase(flooded=True)
                    slept += peer.slept
                finally:
                    elapsed += time.monotonic() - start
                    sent += int(stranger.end())
    quiet, flooded = (latency(samples[name], missed[name], PERIOD_NS) for name in (False, True))
    return Flood(port, quiet, flooded, slept, sent / elapsed)


def _stranger(port: str, gateway: Gateway) -> Background:
    number = gateway.cyclic_port if port == CYCLIC else gateway.acyclic_port
    return module("pdgw.workshop.bench.flood", str(number), port, str(RATE))


def datagram(kind: str) -> bytes:
    """What the stranger sends."""
    if kind == CYCLIC:
        return bytes(PlcDialogue(AXES, PERIOD_NS).datagram(0))
    return RecordCaller(UUID(int=99), object_uuid(1, 1, 1)).read(0, 0, 1, _IM0, implicit=True).packets[0]


def main() -> None:
    """The stranger."""
    # In the field it is another machine: here it takes what the others leave.
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(19)
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
            # What was not sent while others had the core is sent afterwards, within reason.
            due = max(due + _BURST_S, time.monotonic() - _BEHIND_S)
            for _ in range(burst):
                try:
                    sock.sendto(data, target)
                    sent += 1
                except (BlockingIOError, ConnectionRefusedError):
                    continue  # full, or nobody listens just now
    print(sent, flush=True)


if __name__ == "__main__":
    main()
