"""``pdgw run --record``: both buses of a running gateway in one file with one clock, and its configuration with them."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import can

from pdgw.decoder.capture.pcapng_file import PcapngWriter, can_packet, udp_packet
from pdgw.decoder.link import CAN_ERROR, CAN_EXTENDED, CAN_REMOTE
from pdgw.decoder.records import Link
from pdgw.gateway.config import GatewayConfig
from pdgw.gateway.config_file import config_text
from pdgw.gateway.edge import DatagramPort, SystemEdge
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.transport.udp import Address
from pdgw.profidrive.frame import UDP_PORT
from pdgw.tools.background import BackgroundWriter
from pdgw.tools.recordings import CONFIGURATION

CAPTURE: Final = "gateway.pcapng"
_PLC: Final = "plc"
_WELL_KNOWN: Final = {"cyclic port": UDP_PORT}
"""The gateway's side is written with this port, so that every reader dissects the frames without help."""


class Recorder:
    """Writes on a thread of its own what the gateway's loop hands it."""

    def __init__(self, folder: Path, config: GatewayConfig) -> None:
        text = config_text(config)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / CONFIGURATION).write_text(text, encoding="utf-8")
            self._writer = PcapngWriter(folder / CAPTURE, text)
        except OSError as error:
            raise GatewayError(f"--record {folder}: cannot be written ({error.strerror or error})") from error
        self.writer: BackgroundWriter[tuple[Link, str, int, bytes]] = BackgroundWriter(
            f"--record {folder}", lambda packet: self._writer.write(*packet), self._writer.close
        )

    def frame(self, bus: str, message: can.Message) -> None:
        """A CAN frame, sent or received."""
        identifier = message.arbitration_id | (CAN_EXTENDED if message.is_extended_id else 0)
        identifier |= (CAN_REMOTE if message.is_remote_frame else 0) | (CAN_ERROR if message.is_error_frame else 0)
        data = bytes(message.data)
        time_ns = round(message.timestamp * 1e9) or time.time_ns()
        self.writer.put((Link.CAN_SOCKETCAN, bus, time_ns, can_packet(identifier, data)))

    def datagram(self, time_ns: int, source: Address, target: Address, data: bytes) -> None:
        """A datagram to or from the PLC."""
        self.writer.put((Link.ETHERNET, _PLC, time_ns, udp_packet(source, target, data)))

    def stop(self) -> None:
        """As ``BackgroundWriter.stop``."""
        self.writer.stop()


class RecordedPort:
    """A UDP port whose datagrams are recorded; ``port_number`` stands for its own in the file."""

    def __init__(self, port: DatagramPort, recorder: Recorder, now: Callable[[], int], port_number: int) -> None:
        self._port = port
        self._recorder = recorder
        self._now = now
        self._here = (port.address[0], port_number)

    @property
    def errors(self) -> int:
        return self._port.errors

    @errors.setter
    def errors(self, value: int) -> None:
        self._port.errors = value

    @property
    def address(self) -> Address:
        return self._port.address

    @property
    def received_at(self) -> int | None:
        return self._port.received_at

    def start(self, action: Callable[[], None], *, urgent: bool = False) -> None:
        self._port.start(action, urgent=urgent)

    def pause(self) -> None:
        self._port.pause()

    def only_from(self, sender: Address | None) -> None:
        self._port.only_from(sender)

    def receive(self) -> tuple[bytes, Address] | None:
        found = self._port.receive()
        if found is not None:
            at = self._port.received_at
            waited = 0 if at is None else self._now() - at
            self._recorder.datagram(time.time_ns() - waited, found[1], self._here, found[0])
        return found

    def send(self, data: bytes | bytearray, address: Address) -> None:
        self._port.send(data, address)
        self._recorder.datagram(time.time_ns(), self._here, address, bytes(data))

    def close(self) -> None:
        self._port.close()


class RecordingEdge(SystemEdge):
    """The machine, with its UDP ports recorded."""

    def __init__(self, recorder: Recorder) -> None:
        super().__init__()
        self._recorder = recorder

    def open_udp(self, listen: str, port: int, purpose: str) -> DatagramPort:
        opened = super().open_udp(listen, port, purpose)
        number = _WELL_KNOWN.get(purpose, opened.address[1])
        return RecordedPort(opened, self._recorder, self.loop.now, number)
