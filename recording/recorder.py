"""``pdgw run --record``: both buses of a running gateway in one file with one clock, and its configuration with them."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Final

import can

from pdgw.decoder.capture.pcapng_file import PcapngWriter, can_packet, udp_packet
from pdgw.decoder.frames.records import LinkType
from pdgw.ds301.bus.can_frame import ERROR, EXTENDED, REMOTE
from pdgw.ds301.loop.loop import Loop
from pdgw.durations import SECOND
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import config_text
from pdgw.gateway.errors import writing
from pdgw.gateway.links.profinet.ethernet import RawEthernet
from pdgw.gateway.links.udp import Address
from pdgw.gateway.platform import DatagramPort, SystemPlatform
from pdgw.profidrive.frame import CYCLIC_PORT
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.recording.background_writer import BackgroundWriter
from pdgw.recording.recordings import CONFIGURATION
from pdgw.recording.trace_file import PLC

CAPTURE: Final = "gateway.pcapng"
CAPTURE_SIZE: Final = 256 << 20
"""Bytes after which another capture begins."""
CAPTURES: Final = 20
"""Full ones that are kept."""
_WELL_KNOWN: Final = {"cyclic port": CYCLIC_PORT}
"""The gateway's side is written with this port, so that every reader dissects the frames without help."""


class Captures:
    """Write ``gateway.pcapng`` in a folder; a full file gets the time of its end in its name, and a new one begins.

    ``size``: maximum bytes of each, ``files``: number of full ones to keep, those of earlier runs included. Raises OSError as
    files do.
    """

    def __init__(self, folder: Path, configuration: str, size: int, files: int) -> None:
        self._folder = folder
        self._configuration = configuration
        self._size = size
        self._files = files
        self._path = folder / CAPTURE
        self._put_aside()
        self._writer = PcapngWriter(self._path, configuration)

    def write(self, link: LinkType, name: str, time_ns: int, data: bytes) -> None:
        """One packet."""
        if self._writer.size >= self._size:
            self._writer.close()
            self._put_aside()
            self._writer = PcapngWriter(self._path, self._configuration)
        self._writer.write(link, name, time_ns, data)

    def close(self) -> None:
        self._writer.close()

    def _put_aside(self) -> None:
        try:
            ended = datetime.fromtimestamp(self._path.stat().st_mtime).strftime("%Y%m%d-%H%M%S")
        except FileNotFoundError:
            return  # another process has deleted it already
        names = (
            f"{self._path.stem}-{ended}{more}{self._path.suffix}" for more in ("", *(f"-{n}" for n in range(2, 1000)))
        )
        self._path.replace(next(path for name in names if not (path := self._folder / name).exists()))
        full = sorted(
            self._folder.glob(f"{self._path.stem}-*{self._path.suffix}"), key=lambda path: path.stat().st_mtime_ns
        )
        for path in full[: -self._files]:
            path.unlink(missing_ok=True)


class Recorder:
    """Writer thread for the data of the gateway's loop."""

    def __init__(self, folder: Path, config: GatewayConfig, size: int = CAPTURE_SIZE, files: int = CAPTURES) -> None:
        text = config_text(config)
        with writing(f"--record {folder}"):
            folder.mkdir(parents=True, exist_ok=True)
            (folder / CONFIGURATION).write_text(text, encoding="utf-8")
            captures = Captures(folder, text, size, files)
        self.writer: BackgroundWriter[tuple[LinkType, str, int, bytes]] = BackgroundWriter(
            f"--record {folder}", lambda packet: captures.write(*packet), captures.close
        )

    def frame(self, bus: str, message: can.Message) -> None:
        """A CAN frame, sent or received."""
        identifier = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
        identifier |= (REMOTE if message.is_remote_frame else 0) | (ERROR if message.is_error_frame else 0)
        data = bytes(message.data)
        time_ns = round(message.timestamp * SECOND) or time.time_ns()
        self.writer.put((LinkType.CAN_SOCKETCAN, bus, time_ns, can_packet(identifier, data)))

    def datagram(self, time_ns: int, source: Address, target: Address, data: bytes) -> None:
        """A datagram to or from the PLC."""
        self.writer.put((LinkType.ETHERNET, PLC, time_ns, udp_packet(source, target, data)))

    def ethernet(self, frame: bytes) -> None:
        """A frame to or from the controller, now."""
        self.writer.put((LinkType.ETHERNET, PLC, time.time_ns(), frame))

    def stop(self) -> None:
        """As ``BackgroundWriter.stop``."""
        self.writer.stop()


class RecordedPort:
    """A UDP port whose datagrams are recorded; ``port_number`` is its number in the file."""

    def __init__(self, port: DatagramPort, recorder: Recorder, loop: Loop, port_number: int) -> None:
        self._port = port
        self._recorder = recorder
        self._loop = loop
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
            waited = 0 if at is None else self._loop.now() - at
            self._recorder.datagram(self._wall_ns() - waited, found[1], self._here, found[0])
        return found

    def send(self, data: bytes | bytearray, address: Address) -> None:
        self._port.send(data, address)
        self._recorder.datagram(self._wall_ns(), self._here, address, bytes(data))

    def _wall_ns(self) -> int:
        return round(self._loop.wall() * SECOND)

    def close(self) -> None:
        self._port.close()


class RecordedEthernet(RawEthernet):
    """The interface of a PROFINET device, whose frames and calls are recorded."""

    def __init__(self, loop: Loop, interface: str, recorder: Recorder) -> None:
        super().__init__(loop, interface)
        self._recorder = recorder

    def receive(self) -> bytes | None:
        return self._noted(super().receive())

    def receive_other(self) -> bytes | None:
        return self._noted(super().receive_other())

    def _noted(self, frame: bytes | None) -> bytes | None:
        if frame is not None:
            self._recorder.ethernet(frame)
        return frame

    def receive_datagram(self) -> tuple[bytes, Address] | None:
        found = super().receive_datagram()
        if found is not None:
            self._recorder.datagram(time.time_ns(), found[1], self._here(), found[0])
        return found

    def send(self, frame: bytes | bytearray) -> None:
        super().send(frame)
        self._recorder.ethernet(bytes(frame))

    def send_datagram(self, data: bytes, address: Address) -> None:
        super().send_datagram(data, address)
        self._recorder.datagram(time.time_ns(), self._here(), address, data)

    def _here(self) -> Address:
        return str(self.ip().address), ACYCLIC_PORT


class RecordingPlatform(SystemPlatform):
    """The machine, with its UDP ports recorded."""

    def __init__(self, recorder: Recorder) -> None:
        super().__init__()
        self._recorder = recorder

    def open_udp(self, listen: str, port: int, purpose: str) -> DatagramPort:
        opened = super().open_udp(listen, port, purpose)
        number = _WELL_KNOWN.get(purpose, opened.address[1])
        return RecordedPort(opened, self._recorder, self.loop, number)
