"""What the PLC simulator and its parameter channel exchange, as a pcap file with Ethernet, IP and UDP headers."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path

from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.packet import Packet
from scapy.utils import PcapWriter

from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.udp import Address

_MACS = ("02:00:00:00:00:01", "02:00:00:00:00:02")


class Capture:
    """Conversations as a pcap with Ethernet, IP and UDP headers; written beside the threads that have them.

    GatewayError when the file cannot be had, and from ``close`` when it could not be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._failure: Exception | None = None
        self._frames: queue.SimpleQueue[tuple[float, Packet, bytes] | None] = queue.SimpleQueue()
        try:
            self._writer = PcapWriter(str(path), linktype=1, sync=False)
        except OSError as error:
            raise self._unwritable(error) from error
        self._thread = threading.Thread(target=self._write, name="capture", daemon=True)
        self._thread.start()

    def conversation(self, local: Address, remote: Address) -> Callable[[bool, bytes], None]:
        """What takes the datagrams (sent, data) between two addresses, from any thread."""
        there, back = _headers(local, remote, _MACS), _headers(remote, local, _MACS[::-1])
        return lambda sent, data: self._frames.put((time.time(), there if sent else back, data))

    def close(self) -> None:
        self._frames.put(None)
        self._thread.join()
        try:
            self._writer.close()
        except OSError as error:
            self._failure = self._failure or error
        if self._failure is not None:
            raise self._unwritable(self._failure)

    def _unwritable(self, error: Exception) -> GatewayError:
        why = getattr(error, "strerror", None) or repr(error)
        return GatewayError(f"--pcap {self._path}: cannot be written ({why})")

    def _write(self) -> None:
        try:
            self._write_frames()
        except Exception as error:  # whatever it is, the capture is not whole
            self._failure = error
            while self._frames.get() is not None:
                continue  # what nobody writes is not kept

    def _write_frames(self) -> None:
        while (item := self._frames.get()) is not None:
            when, headers, data = item
            packet = headers / data
            packet.time = when
            self._writer.write(packet)


def _headers(source: Address, target: Address, macs: tuple[str, str]) -> Packet:
    return Ether(src=macs[0], dst=macs[1]) / IP(src=source[0], dst=target[0]) / UDP(sport=source[1], dport=target[1])
