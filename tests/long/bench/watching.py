"""The cyclic exchange while the page is viewed, and while its process is flooded and killed, alternating with quiet phases.

``python -m tests.long.bench.watching look PORT`` opens twenty pages with a trend each, and reads the metrics each second.
It prints the number of messages when its standard input ends. ``... harm PORT PID`` floods the page with requests, pauses
and continues its process, and kills it when the input ends. It prints the number of requests.
"""

from __future__ import annotations

import contextlib
import http.client
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial

from pdgw.durations import MS
from pdgw.gateway.errors import GatewayError
from pdgw.tools.demo.links import free_ports
from tests.long.bench.measuring.measure import Latency
from tests.long.bench.phases import QUIET, in_turn, lower_priority
from tests.long.bench.processes.processes import Background, Gateway, module

AXES = 8
PERIOD_NS = MS
PAGES = 20
_SCRAPE_S = 1.0
_FREEZE_S = 0.5
_READY_S = 30.0
WATCHED, HARMED = "watched", "harmed"


@dataclass(frozen=True, slots=True)
class Watching:
    """The figures of one comparison."""

    quiet: Latency
    watched: Latency
    harmed: Latency
    messages_per_s: float
    """To all pages together."""
    requests_per_s: float
    """Requests per second of the flood."""

    @property
    def ratio_p99(self) -> float:
        """p99 with twenty pages and a metrics read each second, divided by p99 without a page process."""
        return self.watched.p99 / self.quiet.p99

    @property
    def ratio_p99_harmed(self) -> float:
        """The same with a page process that is flooded, paused and killed."""
        return self.harmed.p99 / self.quiet.p99


def measure(seconds: float, phases: int = 4) -> Watching:
    """Run this number of phases of each kind in turn. ``seconds``: total of each kind."""
    found = in_turn(AXES, PERIOD_NS, seconds, phases, {WATCHED: partial(_page, "look"), HARMED: partial(_page, "harm")})
    watched, harmed = found[WATCHED], found[HARMED]
    return Watching(found[QUIET].latency, watched.latency, harmed.latency, watched.per_s, harmed.per_s)


@contextmanager
def _page(role: str, gateway: Gateway) -> Iterator[Background]:
    """`pdgw web`, and what looks at it or harms it; ended when it still lives."""
    (port,) = free_ports(socket.SOCK_STREAM, 1)
    command = [sys.executable, "-m", "pdgw", "web", str(gateway.config), "--listen", f"127.0.0.1:{port}"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            deadline = time.monotonic() + _READY_S
            while not _answers(port):
                if process.poll() is not None or time.monotonic() > deadline:
                    raise GatewayError("benchmark: `pdgw web` did not come up; is the extra web installed?")
                time.sleep(0.05)
            yield module("tests.long.bench.watching", role, str(port), str(process.pid))
        finally:
            process.kill()


def _answers(port: int) -> bool:
    with contextlib.suppress(OSError), closing(http.client.HTTPConnection("127.0.0.1", port, timeout=5)) as connection:
        connection.request("GET", "/healthz")
        return connection.getresponse().status == http.client.OK
    return False


def _stream(port: int, do_id: int) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port))
    connection.sendall(f"GET /api/v1/events?trace={do_id} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    return connection


def _ended(timeout_s: float, *others: socket.socket) -> tuple[bool, list[socket.socket]]:
    """Whether the input ended within this time, and which of the others have data."""
    ready = select.select([sys.stdin, *others], [], [], max(0.0, timeout_s))[0]
    return sys.stdin in ready, [item for item in others if item in ready]


def look(port: int) -> int:
    """View the page. Return the number of messages."""
    streams = [_stream(port, number % AXES + 1) for number in range(PAGES)]
    messages, scrape = 0, time.monotonic()
    while True:
        if time.monotonic() >= scrape:
            scrape += _SCRAPE_S
            with closing(http.client.HTTPConnection("127.0.0.1", port)) as connection:
                connection.request("GET", "/metrics")
                connection.getresponse().read()
        ended, ready = _ended(scrape - time.monotonic(), *streams)
        if ended:
            return messages
        messages += sum(stream.recv(1 << 20).count(b"data: ") for stream in ready)


def harm(port: int, process: int) -> int:
    """Flood the page and pause its process every other half second. Return the number of requests."""
    requests, frozen, change = 0, False, time.monotonic() + _FREEZE_S
    request = b"GET /api/v1/objects/1/trace?seconds=10 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    opened: list[socket.socket] = []
    while not _ended(0.001)[0]:
        if time.monotonic() > change:
            frozen, change = not frozen, change + _FREEZE_S
            os.kill(process, signal.SIGSTOP if frozen else signal.SIGCONT)
        with contextlib.suppress(OSError):
            connection = socket.create_connection(("127.0.0.1", port), timeout=0.01)
            opened.append(connection)
            connection.sendall(request)
            requests += 1
        if len(opened) > PAGES * 10:
            opened.pop(0).close()
    os.kill(process, signal.SIGKILL)
    return requests


def main() -> None:
    """Run the viewers or the flood."""
    lower_priority()
    role, port = sys.argv[1], int(sys.argv[2])
    print("ready", flush=True)
    print(look(port) if role == "look" else harm(port, int(sys.argv[3])), flush=True)


if __name__ == "__main__":
    main()
