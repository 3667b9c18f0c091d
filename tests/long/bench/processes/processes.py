"""The processes of a benchmark: the echo, the ideal drives, and the gateway as `pdgw run` starts it."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from pdgw.durations import MS
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.service.status_client import fetch
from pdgw.peers.bus import INTERFACE
from pdgw.tools.demo.links import free_ports
from tests.long.bench.processes.drives import PER_BUS

_READY_S = 60.0
_LOOK_S = 0.02
_END_S = 120.0
"""Longest time until a process ends. With the lowest priority it may wait long for a busy machine."""
USUAL_SCHEDULING = "[realtime]\npriority = 0\n"
"""The gateway gets the priority of client and echo: real-time only if all of them have it (``--realtime``)."""


class Background:
    """A process that prints a line when it is ready, reads commands from standard input and ends with it."""

    def __init__(self, *command: str) -> None:
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.first_line = self._line(f"{' '.join(command)} did not start")

    def ask(self, command: str) -> str:
        """Send a line, return the answer."""
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        return self._line(f"{self._process.args!r} does not answer")

    def _line(self, otherwise: str) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise GatewayError(f"benchmark: {otherwise}")
        return line

    def end(self) -> str:
        """Close its input. Return its last output."""
        rest, _ = self._process.communicate(timeout=_END_S)
        return rest or ""


def module(name: str, *arguments: str) -> Background:
    """Start a module of this package as a process."""
    return Background(sys.executable, "-m", name, *arguments)


@contextmanager
def ended(process: Background) -> Iterator[Background]:
    """End a process with the block."""
    try:
        yield process
    finally:
        process.end()


@contextmanager
def echo() -> Iterator[tuple[int, str]]:
    """Start a UDP echo. Yield its port and language: C with a compiler, else Python."""
    compiler = shutil.which("cc")
    with tempfile.TemporaryDirectory() as directory:
        program = Path(directory) / "echo"
        if compiler is None:
            process, language = module("tests.long.bench.processes.echo"), "Python"
        else:
            subprocess.run([compiler, "-O2", "-o", program, Path(__file__).parent / "echo.c"], check=True)
            process, language = Background(str(program)), "C"
        with ended(process):
            yield int(process.first_line), language


class Drives:
    """Ideal drives for this number of axes, see ``tests.long.bench.processes.drives``."""

    def __init__(self, process: Background) -> None:
        self._process = process
        self.channels = process.first_line.split()

    def mark(self) -> None:
        """Start counting."""
        self._process.ask("mark")

    def report(self) -> tuple[list[int], list[tuple[int, int]]]:
        """RPDOs of each axis; time and target velocity of those of the last axis."""
        document = json.loads(self._process.ask("report"))
        return document["rpdos"], [(when, velocity) for when, velocity in document["log"]]


def configuration(channels: Sequence[str], axes: int, period_ns: int, ports: tuple[int, int, int]) -> str:
    """Configure a gateway for ideal drives: telegram 1 on every axis. ``ports``: cyclic, acyclic, status."""
    milliseconds = period_ns / MS
    lines = [
        "[transport]",
        f"cycle_time_ms = {milliseconds:g}",
        "watchdog_factor = 255",
        f"cyclic_port = {ports[0]}",
        f"acyclic_port = {ports[1]}",
        f"status_port = {ports[2]}",
    ]
    for number, channel in enumerate(channels):
        interface = INTERFACE if ":" in channel else "socketcan"
        lines += ["[[can]]", f'name = "can{number}"', f'interface = "{interface}"', f'channel = "{channel}"']
    for axis in range(axes):
        lines += [
            "[[axis]]",
            f"do_id = {axis + 1}",
            f"node_id = {axis % PER_BUS + 1}",
            "telegram = 1",
            f'can = "can{axis // PER_BUS}"',
            # The ideal drive sends TPDOs only as answers; their supervision would time out between bursts.
            "tpdo_event_ms = 10000",
            "heartbeat_ms = 1000",
        ]
    return "\n".join(lines) + "\n"


class Gateway:
    """A gateway started with `pdgw run`."""

    def __init__(self, process: subprocess.Popen[bytes], ports: tuple[int, int, int], config: Path, log: Path) -> None:
        self.config = config
        self._process = process
        self._started = time.monotonic()
        self._log = log
        self.cyclic_port, self.acyclic_port, self.status_port = ports

    def wait_online(self, axes: int) -> float:
        """Wait until every axis is online. Return the seconds since the start of the process."""
        while True:
            waited = time.monotonic() - self._started
            if self._process.poll() is not None or waited > _READY_S:
                raise GatewayError(f"benchmark: the gateway did not come up: {self._log.read_text()[-500:]}")
            with contextlib.suppress(GatewayError):
                if sum(axis["drive"] == "online" for axis in self.status()["axes"]) == axes:
                    return waited
            time.sleep(_LOOK_S)

    def status(self) -> dict[str, Any]:
        """The document of `pdgw status --json`."""
        return fetch(self.status_port)

    def cpu_ns(self) -> int | None:
        """CPU time used until now, all threads; None on other systems than Linux."""
        return cpu_ns(self._process.pid)

    def resident_bytes(self) -> int | None:
        """Memory in use; None on other systems than Linux."""
        try:
            pages = Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]
        except OSError:
            return None
        return int(pages) * os.sysconf("SC_PAGE_SIZE")


def cpu_ns(pid: int) -> int | None:
    """CPU time that a process used until now, all threads; None on other systems than Linux."""
    try:
        threads = list(Path(f"/proc/{pid}/task").iterdir())
        return sum(int((thread / "schedstat").read_text().split()[0]) for thread in threads)
    except OSError:
        return None


@cache
def environment() -> dict[str, str]:
    """Environment of a gateway as on a user's machine: Python keeps compiled byte code."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run([sys.executable, "-c", "import pdgw.tools.commands.gateway.run"], env=environment, check=True)
    return environment


@contextmanager
def running(
    axes: int, period_ns: int, more: str = USUAL_SCHEDULING, interfaces: Sequence[str] = ()
) -> Iterator[tuple[Drives, Gateway]]:
    """Start ideal drives and a gateway, which may not be online yet. Both end with the block.

    ``more``: further tables of its configuration. ``interfaces``: CAN interfaces of the kernel for the drives.
    """
    cyclic, acyclic = free_ports(socket.SOCK_DGRAM, 2)
    (status,) = free_ports(socket.SOCK_STREAM, 1)
    ports = (cyclic, acyclic, status)
    with (
        tempfile.TemporaryDirectory() as directory,
        ended(module("tests.long.bench.processes.drives", str(axes), *interfaces)) as process,
    ):
        drives = Drives(process)
        config, log = Path(directory) / "gateway.toml", Path(directory) / "gateway.log"
        config.write_text(configuration(drives.channels, axes, period_ns, ports) + more, encoding="utf-8")
        command = [sys.executable, "-m", "pdgw", "run", str(config), "--log-file", str(log)]
        with (
            log.open("w") as errors,
            subprocess.Popen(command, stdout=errors, stderr=errors, env=environment()) as daemon,
        ):
            try:
                yield drives, Gateway(daemon, ports, config, log)
            finally:
                daemon.terminate()
                try:
                    daemon.wait(30)
                except subprocess.TimeoutExpired:
                    daemon.kill()
