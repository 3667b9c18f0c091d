"""Writing pcapng files of both buses, and the comment that carries the configuration with them.

Source: draft-ietf-opsawg-pcapng (section header with opt_comment, interface descriptions with if_name and if_tsresol, enhanced
packets). Reading packets is ``pcap``'s business.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO, Final

from pdgw.decoder.capture.pcap import PCAPNG_MAGIC
from pdgw.decoder.frames.records import LinkType

CONFIGURATION: Final = "pdgw configuration\n"
"""Start of the comment that contains the gateway's configuration."""
_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
_BYTE_ORDER: Final = 0x1A2B3C4D
_COMMENT, _IF_NAME, _IF_TSRESOL = 1, 2, 9
_NANOSECONDS: Final = bytes((9,))
_COMMENT_MAX: Final = 0xFFFF
_HEAD: Final = 24
"""Bytes of a section header before its options."""


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + _padded(value)


def _block(kind: int, body: bytes) -> bytes:
    length = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + length + body + length


class PcapngWriter:
    """Interfaces are added as they are met; times are nanoseconds. Raises OSError as the file does."""

    def __init__(self, path: Path, configuration: str = "") -> None:
        self._file: BinaryIO = path.open("wb", buffering=1 << 16)
        self._interfaces: dict[tuple[int, str], int] = {}
        options = b""
        if configuration:
            options = _option(_COMMENT, (CONFIGURATION + configuration).encode()[:_COMMENT_MAX]) + bytes(4)
        self.size = self._file.write(_block(_SECTION, struct.pack("<IHHq", _BYTE_ORDER, 1, 0, -1) + options))
        """Number of bytes written."""

    def write(self, link: LinkType, name: str, time_ns: int, data: bytes) -> None:
        """One packet of an interface."""
        number = self._interfaces.get((link, name))
        if number is None:
            number = self._interfaces[link, name] = len(self._interfaces)
            options = _option(_IF_NAME, name.encode()) + _option(_IF_TSRESOL, _NANOSECONDS) + bytes(4)
            self.size += self._file.write(_block(_INTERFACE, struct.pack("<HHI", link, 0, 0) + options))
        head = struct.pack("<IIIII", number, time_ns >> 32, time_ns & 0xFFFFFFFF, len(data), len(data))
        self.size += self._file.write(_block(_PACKET, head + _padded(data)))

    def close(self) -> None:
        self._file.close()


def configuration_in(path: Path) -> str:
    """The gateway's configuration in a pcapng file's first comment; empty where there is none."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
            if len(head) < _HEAD or head[:4] != PCAPNG_MAGIC:
                return ""
            order = "<" if struct.unpack_from("<I", head, 8)[0] == _BYTE_ORDER else ">"
            options = file.read(min(max(0, struct.unpack_from(order + "I", head, 4)[0] - _HEAD - 4), 2 * _COMMENT_MAX))
    except OSError:
        return ""
    at = 0
    while at + 4 <= len(options):
        code, length = struct.unpack_from(order + "HH", options, at)
        value = options[at + 4 : at + 4 + length]
        if code == _COMMENT and value.startswith(CONFIGURATION.encode()):
            return value.decode("utf-8", "replace").removeprefix(CONFIGURATION)
        if not code:
            break
        at += 4 + length + -length % 4
    return ""


def can_packet(identifier: int, data: bytes) -> bytes:
    """A CAN frame as a packet of SocketCAN; ``identifier`` has its flags."""
    return struct.pack(">IBxxx", identifier, len(data)) + data


_ETHERNET = bytes.fromhex("020000000002 020000000001 0800")


def udp_packet(source: tuple[str, int], target: tuple[str, int], data: bytes) -> bytes:
    """A datagram after Ethernet, IPv4 (correct checksum) and UDP (none) headers."""
    udp = struct.pack(">HHHH", source[1], target[1], 8 + len(data), 0) + data
    ends = b"".join(bytes(int(part) for part in host.split(".")) for host, _ in (source, target))
    head = struct.pack(">BBHHHBBH8s", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0, ends)
    total = sum(struct.unpack(">10H", head))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return _ETHERNET + head[:10] + struct.pack(">H", ~total & 0xFFFF) + head[12:] + udp
