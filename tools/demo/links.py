"""How PLC and gateway of the demo reach each other: UDP on loopback, or PROFINET over a pair of virtual Ethernet interfaces."""

from __future__ import annotations

import contextlib
import secrets
import socket
import threading
from pathlib import Path
from typing import Protocol

from pdgw.recording.ethernet_capture import EthernetCapture
from pdgw.tools.demo.namespaces import ADDRESS_HERE, HERE, THERE, VethPair, forward

STATION = "press-1"


def free_ports(kind: socket.SocketKind, number: int) -> list[int]:
    """Different ports of 127.0.0.1 nobody uses, below those the system gives to whoever asks for any.

    So nobody gets one until the process it is for has taken it.
    """
    found: set[int] = set()
    while len(found) < number:
        port = 10_000 + secrets.randbelow(20_000)
        with socket.socket(socket.AF_INET, kind) as sock, contextlib.suppress(OSError):
            sock.bind(("127.0.0.1", port))
            found.add(port)
    return list(found)


class DemoLink(Protocol):
    """One way to connect them."""

    @property
    def capture(self) -> str:
        """Name of the file with what went over it."""

    @property
    def transport(self) -> str:
        """Keys of the gateway's ``[transport]``."""

    def open(self, out: Path, control_port: int) -> None:
        """Make what has to be there before the processes; ``control_port`` is the devices' on loopback."""

    def plc(self, out: Path) -> list[str]:
        """Options of the PLC simulator."""

    def command(self, *arguments: str) -> list[str]:
        """What runs a command where the PLC is."""

    def close(self) -> None:
        """Take everything away again."""


class OnLoopback:
    """Cyclic frames and records over UDP."""

    capture = "plc.pcap"

    def __init__(self) -> None:
        self._cyclic, self._acyclic = free_ports(socket.SOCK_DGRAM, 2)
        self._control = 0

    @property
    def transport(self) -> str:
        return f"cyclic_port = {self._cyclic}\nacyclic_port = {self._acyclic}\n"

    def open(self, out: Path, control_port: int) -> None:
        self._control = control_port

    def plc(self, out: Path) -> list[str]:
        return [
            *("--gateway", f"127.0.0.1:{self._cyclic}", "--acyclic-port", str(self._acyclic)),
            *("--drive-port", str(self._control), "--pcap", str(out / self.capture)),
        ]

    def command(self, *arguments: str) -> list[str]:
        return list(arguments)

    def close(self) -> None:
        """Nothing was made."""


class OnEthernet:
    """PROFINET: the PLC in a network namespace of its own, its frames recorded with the kernel's time stamps."""

    capture = "plc.pcapng"
    transport = f'type = "profinet"\ninterface = "{HERE}"\nstation_name = "{STATION}"\n'

    def __init__(self) -> None:
        self._made = contextlib.ExitStack()
        self._pair: VethPair | None = None
        self._control = 0

    def open(self, out: Path, control_port: int) -> None:
        self._pair = pair = self._made.enter_context(VethPair())
        self._made.enter_context(EthernetCapture(HERE, out / self.capture))
        # The drives' simulator listens on this loopback; the PLC has another one, with the same port on it.
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
