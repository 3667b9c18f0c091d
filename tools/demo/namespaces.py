"""Ethernet without hardware: a pair of virtual interfaces between two network namespaces (Linux, no root needed).

``enter`` restarts the present command in a user and network namespace of its own. A ``VethPair`` has ``eth1`` in this
namespace and ``plc`` in a second one; ``command`` runs a program there.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import time
from types import TracebackType
from typing import Final, NoReturn, Self

from pdgw.gateway.base.errors import GatewayError

HERE: Final = "eth1"
THERE: Final = "plc"
ADDRESS_THERE: Final = "192.168.0.1/24"
ADDRESS_HERE: Final = "192.168.0.2/24"
"""Address of this side, for a controller that assigns it by DCP."""
_MARK: Final = "PDGW_IN_NAMESPACE"
_TOOLS: Final = ("unshare", "nsenter", "ip")
_PATIENCE_S: Final = 10
_SEND_LISTENER: Final = """
import socket, sys
way = socket.socket(fileno=int(sys.argv[1]))
listener = socket.create_server(("127.0.0.1", int(sys.argv[2])))
socket.send_fds(way, [b"x"], [listener.fileno()])
"""


def inside() -> bool:
    """Whether this process runs in the namespaces of ``enter``."""
    return _MARK in os.environ


def missing() -> str:
    """Why namespaces are not available; empty if they are."""
    lacking = [tool for tool in _TOOLS if shutil.which(tool) is None]
    if lacking:
        return f"{', '.join(lacking)} not found; install util-linux and iproute2"
    probe = subprocess.run([*_unshare(), "true"], capture_output=True, text=True, check=False)
    if probe.returncode:
        said = probe.stderr.strip()
        return (
            f"the kernel does not allow network namespaces ({said}); run as root, or set sysctl "
            "user.max_user_namespaces"
        )
    return ""


def _unshare() -> list[str]:
    # Root keeps its other rights, such as real-time priority. Another user becomes root of a user namespace.
    return ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--user", "--map-root-user", "--net"]


def enter(program: str) -> NoReturn:
    """Restart the present command of ``python -m PROGRAM`` in a namespace; GatewayError if that fails."""
    why = missing()
    if why:
        raise GatewayError(f"the demo cannot create a network of virtual interfaces: {why}")
    os.environ[_MARK] = "1"
    os.execvp("unshare", [*_unshare(), sys.executable, "-m", program, *sys.argv[1:]])


class VethPair:
    """The pair of interfaces; exists from ``__enter__`` to ``__exit__``."""

    def __init__(self) -> None:
        self._holder = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])

    def __enter__(self) -> Self:
        try:
            self._make()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def _end(self) -> None:
        # The kernel removes a namespace some time after its last process. Until then its names stay in use.
        subprocess.run(["ip", "link", "delete", HERE], capture_output=True, check=False)
        self._holder.kill()
        self._holder.wait()

    def _make(self) -> None:
        own = os.readlink("/proc/self/ns/net")
        end = time.monotonic() + _PATIENCE_S
        while os.readlink(f"/proc/{self._holder.pid}/ns/net") == own:
            if time.monotonic() > end or self._holder.poll() is not None:
                raise GatewayError("cannot create a second network namespace")
            time.sleep(0.01)
        for command in (
            ["ip", "link", "set", "lo", "up"],
            ["ip", "link", "add", HERE, "type", "veth", "peer", "name", THERE],
            ["ip", "link", "set", THERE, "netns", str(self._holder.pid)],
            ["ip", "link", "set", HERE, "up"],
            self.command("ip", "addr", "add", ADDRESS_THERE, "dev", THERE),
            self.command("ip", "link", "set", THERE, "up"),
            self.command("ip", "link", "set", "lo", "up"),
        ):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise GatewayError(f"{' '.join(command)}: {done.stderr.strip()}")

    def command(self, *arguments: str) -> list[str]:
        """The command line that runs a command in the other namespace."""
        return ["nsenter", "--target", str(self._holder.pid), "--net", *arguments]

    def listener(self, port: int) -> socket.socket:
        """Open a listening socket on a port of the other namespace's loopback address, for this process."""
        here, there = socket.socketpair()
        with here, there:
            script = self.command(sys.executable, "-c", _SEND_LISTENER, str(there.fileno()), str(port))
            subprocess.run(script, pass_fds=[there.fileno()], check=True, timeout=_PATIENCE_S)
            _, descriptors, _, _ = socket.recv_fds(here, 1, 1)
        return socket.socket(fileno=descriptors[0])


def forward(listener: socket.socket, port: int) -> None:
    """Forward each connection of ``listener``, one request and one answer, to a port of this loopback. Ends when it is
    closed.
    """
    while True:
        try:
            connection, _ = listener.accept()
        except OSError:
            return
        with contextlib.suppress(OSError), connection, socket.create_connection(("127.0.0.1", port)) as target:
            target.sendall(_line(connection))
            connection.sendall(_line(target))


def _line(connection: socket.socket) -> bytes:
    with connection.makefile("rb") as stream:
        return stream.readline()
