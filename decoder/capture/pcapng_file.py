"""Writing pcapng files of both buses, and the configuration in a file.

Source: draft-ietf-opsawg-pcapng (section header with opt_comment, interface descriptions with if_name and if_tsresol, enhanced
packets). Reading packets is ``pcap``'s business.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO, Final

from pdgw.decoder.frames.records import LinkType
from pdgw.gateway.trace import blocks

_HEAD_MAX: Final = 2 << 16
"""Bytes that contain a section header."""


class PcapngWriter:
    """Interfaces are added as they are met; times are nanoseconds. Raises OSError as the file does."""

    def __init__(self, path: Path, configuration: str = "") -> None:
        self._file: BinaryIO = path.open("wb", buffering=1 << 16)
        self._interfaces: dict[tuple[int, str], int] = {}
        self._file.write(blocks.section_header(configuration))

    def write(self, link: LinkType, name: str, time_ns: int, data: bytes) -> None:
        """One packet of an interface."""
        number = self._interfaces.get((link, name))
        if number is None:
            number = self._interfaces[link, name] = len(self._interfaces)
            self._file.write(blocks.interface(link, name))
        self._file.write(blocks.packet(number, time_ns, data))

    def close(self) -> None:
        self._file.close()


def configuration_in(path: Path) -> str:
    """The gateway's configuration in a pcapng file's first comment; empty where there is none."""
    try:
        with path.open("rb") as file:
            return blocks.configuration(file.read(_HEAD_MAX))
    except OSError:
        return ""


def can_packet(identifier: int, data: bytes) -> bytes:
    """A CAN frame as a packet of SocketCAN; ``identifier`` has its flags."""
    return struct.pack(">IBxxx", identifier, len(data)) + data
