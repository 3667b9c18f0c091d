"""The link between PLC and gateway of the demo: UDP on loopback, or PROFINET on a pair of virtual Ethernet interfaces."""

from __future__ import annotations

import contextlib
import secrets
import socket
import threading
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from pdgw.tools.demo.namespaces import ADDRESS_HERE, HERE, THERE, VethPair, forward
from pdgw.tools.recording.recorder import CAPTURE

STATION = "press-1"
RECORD = "gateway"
"""Folder of the gateway's own recording."""


def free_ports(kind: socket.SocketKind, number: int) -> list[int]:
    """Find unused ports of 127.0.0.1.

    They are below the range that the system assigns automatically, so that no other program gets them meanwhile.
    """
    found: set[int] = set()
    while len(found) < number:
        port = 10_000 + secrets.randbelow(20_000)
        with socket.socket(socket.AF_INET, kind) as sock, contextlib.suppress(OSError):
            sock.bind(("127.0.0.1", port))
            found.add(port)
    return list(found)


class DemoLink(Protocol):
    """A link between PLC and gateway."""

    @property
    def capture(self) -> str:
        """The file with the frames of the link."""

    @property
    def transport(self) -> Mapping[str, int | str]:
        """Keys of the gateway's ``[transport]`` section."""

    def open(self, control_port: int) -> None:
        """Create what the processes need. ``control_port``: the devices' port on loopback."""

    def plc(self, out: Path) -> list[str]:
        """Options of the PLC simulator."""

    def command(self, *arguments: str) -> list[str]:
        """The command line that runs a command on the PLC's side."""

    def close(self) -> None:
        """Remove what ``open`` created."""


class OnLoopback:
    """Cyclic frames and records over UDP."""

    capture = "plc.pcap"

    def __init__(self) -> None:
        self._cyclic, self._acyclic = free_ports(socket.SOCK_DGRAM, 2)
        self._control = 0

    @property
    def transport(self) -> Mapping[str, int | str]:
        return {"cyclic_port": self._cyclic, "acyclic_port": self._acyclic}

    def open(self, control_port: int) -> None:
        self._control = control_port

    def plc(self, out: Path) -> list[str]:
        return [
            *("--gateway", f"127.0.0.1:{self._cyclic}", "--acyclic-port", str(self._acyclic)),
            *("--drive-port", str(self._control), "--pcap", str(out / self.capture)),
        ]

    def command(self, *arguments: str) -> list[str]:
        return list(arguments)

    def close(self) -> None:
        """Nothing to remove."""


class OnEthernet:
    """PROFINET: the PLC is in a network namespace of its own."""

    capture = f"{RECORD}/{CAPTURE}"
    transport: Mapping[str, int | str] = MappingProxyType(
        {"type": "profinet", "interface": HERE, "station_name": STATION}
    )

    def __init__(self) -> None:
        self._made = contextlib.ExitStack()
        self._pair: VethPair | None = None
        self._control = 0

    def open(self, control_port: int) -> None:
        self._pair = pair = self._made.enter_context(VethPair())
        # The simulated drives listen on this loopback. The PLC has its own loopback and uses the same port there.
        self._control = control_port
        listener = self._made.enter_context(pair.listener(control_port))
        threading.Thread(target=forward, args=(listener, control_port), name="drive control", daemon=True).start()

    def plc(self, out: Path) -> list[str]:
        return [
            *("--profinet", THERE, "--name", STATION, "--device-ip", ADDRESS_HERE),
            *("--drive-port", str(self._control)),
        ]

    def command(self, *arguments: str) -> list[str]:
        assert self._pair is not None
        return self._pair.command(*arguments)

    def close(self) -> None:
        self._made.close()
