"""The blocks of a recording: a pcapng file in network byte order that Wireshark opens.

Each section has the configuration as a comment, an interface for each bus and for the PLC, and the description of the steps.
Frames are enhanced packet blocks. Description and steps are custom blocks, which other programs skip. Source:
draft-ietf-opsawg-pcapng.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from pdgw.gateway.links.frame_places import FramePlaces
from pdgw.profidrive.frame import CYCLIC_PORT
from pdgw.profidrive.telegrams import Telegram, own_telegram, telegram

CONFIGURATION: Final = "pdgw configuration\n"
"""Start of the comment with the gateway's configuration."""
GZIP: Final = ".gz"
"""Ending of a file that gzip has compressed."""
VERSION: Final = 2
"""Of the description and of the steps. Steps of version 1 have all that changed, also what the frames have."""
ETHERNET: Final = 1
SOCKETCAN: Final = 227
PLC: Final = "plc"
"""Interface of the PLC's frames."""
SECTION: Final = 0x0A0D0D0A
INTERFACE: Final = 1
PACKET: Final = 6
CUSTOM: Final = 0x0BAD
ENTERPRISE: Final = 32473
"""The number for examples (RFC 5612): other programs skip the block."""
DESCRIPTION: Final = b"D"
CYCLE: Final = b"C"
_BYTE_ORDER: Final = 0x1A2B3C4D
_COMMENT, _IF_NAME, _IF_TSRESOL = 1, 2, 9
_NANOSECONDS: Final = bytes((9,))
_COMMENT_MAX: Final = 0xFFFF
_SECTION_HEAD: Final = 24
"""Bytes of a section header before its options."""
_SECTION_MAGIC: Final = b"\x0a\x0d\x0d\x0a"
HEAD: Final = struct.Struct(">II")
PACKET_HEAD: Final = struct.Struct(">IIIQII")
"""Kind, length of the block, interface, time, captured and original length."""
CUSTOM_HEAD: Final = struct.Struct(">IIIcxxxI")
"""Kind, length of the block, enterprise; then kind and length of the content."""
_TAIL: Final = struct.Struct(">I")
CAN_PACKET: Final = struct.Struct(">12sQ16s8s4s")
"""``CAN_HEAD``, time, ``CAN_MIDDLE``, data, ``CAN_TAIL``."""
CAN_TAIL: Final = _TAIL.pack(CAN_PACKET.size)
"""Length of the block."""
CAN_HEAD: Final = struct.Struct(">III")
"""Kind, length of the block, interface."""
CAN_MIDDLE: Final = struct.Struct(">IIIBxxx")
"""Captured and original length; identifier and number of data bytes."""
CYCLE_HEAD: Final = struct.Struct(">QqqBI")
"""Number of the cycle, its monotonic time, wall clock minus monotonic clock, flags, microseconds to the answer."""
FRESH, CONNECTED, ANSWERED, WHOLE = 1, 2, 4, 8
"""Flags of a cycle: begun by a frame of the PLC, with a PLC, answered, with all values of its steps."""
MASK: Final = struct.Struct(">H")
"""The step of each drive object: the groups of values that follow, by their number, and the flags below. Without groups, the
values are those of the step before and of the frames since then."""
READ: Final = 1 << 10
"""Instead of groups: the values that no PDO has follow, because one of them was read."""
SENT: Final = 1 << 11
"""The RPDOs have its command."""
AS_BEFORE: Final = 1 << 12
"""Only setpoints are taken from the frames: a device is not online."""
ONLINE: Final = 1 << 13
"""With groups: the frames have the values, too."""
NO_SETPOINTS: Final = 1 << 14
HAS_EVENTS: Final = 1 << 15
LENGTH: Final = struct.Struct(">I")
GROUPS: Final = ("setpoints", "flags", "numbers", "feedback", "sensors", "decided", "command")
"""The last two are what a step decided, the others what it was given."""
SETPOINTS: Final = 1
VALUES: Final = (1 << len(GROUPS)) - 2
"""All groups but the setpoints."""


_ETHERNET_HEAD: Final = bytes.fromhex("020000000002 020000000001 0800")
_NO_HOST: Final = "0.0.0.0"


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def _option(code: int, value: bytes) -> bytes:
    return struct.pack(">HH", code, len(value)) + _padded(value)


def _block(kind: int, body: bytes) -> bytes:
    length = len(body) + 12
    return HEAD.pack(kind, length) + body + _TAIL.pack(length)


def section_header(configuration: str) -> bytes:
    """The begin of a section, with the configuration as its comment."""
    text = (CONFIGURATION + configuration).encode()[:_COMMENT_MAX]
    comment = _option(_COMMENT, text) + bytes(4) if configuration else b""
    return _block(SECTION, struct.pack(">IHHq", _BYTE_ORDER, 1, 0, -1) + comment)


def section(configuration: str, buses: tuple[str, ...]) -> bytes:
    """A section with its interfaces: the buses in their order, then the PLC's cyclic frames, then its others."""
    links = [*((SOCKETCAN, name) for name in buses), (ETHERNET, PLC), (ETHERNET, PLC)]
    return section_header(configuration) + b"".join(interface(link, name) for link, name in links)


def interface(link: int, name: str) -> bytes:
    """The description of an interface."""
    options = _option(_IF_NAME, name.encode()) + _option(_IF_TSRESOL, _NANOSECONDS) + bytes(4)
    return _block(INTERFACE, struct.pack(">HHI", link, 0, 0) + options)


def packet(interface: int, time_ns: int, data: bytes) -> bytes:
    """A frame; the time is that of the wall clock."""
    size = len(data)
    return _block(PACKET, struct.pack(">IQII", interface, time_ns, size, size) + _padded(data))


class FramePacker:
    """Packs frames of an interface as ``packet``; ``header``: what is before data of a size.

    What frames of one size have in common is packed once, because it takes longer than the rest.
    """

    def __init__(self, interface: int, header: Callable[[int], bytes]) -> None:
        self._interface = interface
        self._header = header
        self._prepare(0)

    def _prepare(self, size: int) -> None:
        self._size = size
        header = self._header(size)
        whole = len(header) + size
        block = struct.Struct(f">12sQ{HEAD.size + len(header)}s{size + -whole % 4}s4s")
        self._pack = block.pack
        self._head = CAN_HEAD.pack(PACKET, block.size, self._interface)
        self._middle = HEAD.pack(whole, whole) + header
        self._tail = _TAIL.pack(block.size)

    def pack(self, time_ns: int, data: bytes | bytearray) -> bytes:
        """A frame; the time is that of the wall clock."""
        if len(data) != self._size:
            self._prepare(len(data))
        packed: bytes = self._pack(self._head, time_ns, self._middle, data, self._tail)
        return packed


@lru_cache(maxsize=256)
def udp_header(source: str, target: str, size: int) -> bytes:
    """Ethernet, IPv4 (correct checksum) and UDP (none) headers of ``size`` bytes; ends are address and port as text."""
    (source_host, source_port), (target_host, target_port) = _address(source), _address(target)
    ends = b"".join(bytes(int(part) for part in host.split(".")) for host in (source_host, target_host))
    head = struct.pack(">BBHHHBBH8s", 0x45, 0, 28 + size, 0, 0, 64, 17, 0, ends)
    total = sum(struct.unpack(">10H", head))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    udp = struct.pack(">HHHH", source_port, target_port, 8 + size, 0)
    return _ETHERNET_HEAD + head[:10] + struct.pack(">H", ~total & 0xFFFF) + head[12:] + udp


def _address(end: str) -> tuple[str, int]:
    host, _, port = end.rpartition(":")
    parts = host.split(".")
    known = len(parts) == 4 and all(part.isdigit() for part in parts)
    return (host, int(port)) if known else (_NO_HOST, int(port) if port.isdigit() else CYCLIC_PORT)


def custom(kind: bytes, content: bytes) -> bytes:
    """A block that only this gateway reads."""
    return _block(CUSTOM, struct.pack(">IcxxxI", ENTERPRISE, kind, len(content)) + _padded(content))


@lru_cache(maxsize=256)
def _cycle_block(size: int) -> tuple[Callable[..., bytes], bytes, bytes]:
    """For cycles with steps of this size: what packs the block, its head and tail."""
    content = CYCLE_HEAD.size + size
    block = struct.Struct(f">{CUSTOM_HEAD.size}s{CYCLE_HEAD.format[1:]}{size + -content % 4}s4s")
    head = CUSTOM_HEAD.pack(CUSTOM, block.size, ENTERPRISE, CYCLE, content)
    return block.pack, head, _TAIL.pack(block.size)


class CyclePacker:
    """Packs cycles with their steps as ``custom``. Most have the size of the one before."""

    def __init__(self) -> None:
        self._size = 0
        self._pack, self._head, self._tail = _cycle_block(0)

    def pack(self, number: int, time_ns: int, wall: int, flags: int, response: int, steps: bytes) -> bytes:
        """The block of a cycle; the numbers as in ``CYCLE_HEAD``."""
        if len(steps) != self._size:
            self._size = len(steps)
            self._pack, self._head, self._tail = _cycle_block(self._size)
        return self._pack(self._head, number, time_ns, wall, flags, response, steps, self._tail)


@lru_cache(maxsize=256)
def _telegram(number: int, like: int, setpoints: tuple[str, ...], actuals: tuple[str, ...]) -> Telegram:
    """The telegram with this number, or a user's own one with these signals."""
    return own_telegram(number, telegram(like), setpoints, actuals) if like else telegram(number)


@dataclass(frozen=True)
class TracedObject:
    """A drive object; ``groups``: the names of the values in the groups of its steps."""

    do_id: int
    kind: str
    node_id: int
    bus: str
    telegram: int
    groups: dict[str, tuple[str, ...]]
    like: int = 0
    """Of a user's own telegram: the number of the one that it is carried out as."""
    actuals: tuple[str, ...] = ()
    """Of a user's own telegram: the names of its actual values."""

    @property
    def chosen(self) -> Telegram:
        """The telegram; ProfidriveError where this version has no such."""
        return _telegram(self.telegram, self.like, self.groups["setpoints"], self.actuals)

    def place(self, group: str, name: str) -> int | None:
        """Place of a value in its group; None: it is not recorded."""
        names = self.groups[group]
        return names.index(name) if name in names else None


@dataclass(frozen=True)
class Description:
    """What a section contains."""

    build: str
    name: str
    process: int
    cycle_ns: int
    first: bool
    """The section begins with the start of the gateway."""
    places: FramePlaces
    objects: tuple[TracedObject, ...]
    buses: tuple[str, ...]
    reasons: tuple[str, ...]
    """Names of the reasons; code 1 is the first."""
    version: int = VERSION

    def reason(self, code: int) -> str:
        """The name of a recorded reason, empty for none."""
        return "" if not code else self.reasons[code - 1] if 0 < code <= len(self.reasons) else f"reason {code}"


_TIMES: Final = {"position_actual": "position_ns", "position": "position_time"}
"""Values whose time of arrival is a value too."""


def time_of(name: str) -> str:
    """The value with the time at which the frame with a value came; empty for none."""
    prefix, point, attribute = name.rpartition(".")
    time = _TIMES.get(attribute, "")
    return time and prefix + point + time


def configuration(head: bytes) -> str:
    """The gateway's configuration in a section header; empty where there is none."""
    if len(head) < _SECTION_HEAD or head[:4] != _SECTION_MAGIC:
        return ""
    order = "<" if struct.unpack_from("<I", head, 8)[0] == _BYTE_ORDER else ">"
    at, end = _SECTION_HEAD, struct.unpack_from(order + "I", head, 4)[0] - 4
    while at + 4 <= min(len(head), end):
        code, length = struct.unpack_from(order + "HH", head, at)
        value = head[at + 4 : at + 4 + length]
        if code == _COMMENT and value.startswith(CONFIGURATION.encode()):
            return value.decode("utf-8", "replace").removeprefix(CONFIGURATION)
        if not code:
            break
        at += 4 + length + -length % 4
    return ""


def walk(data: bytes, at: int = 0) -> Iterator[tuple[int, int, int]]:
    """Kind, place and length of each whole block."""
    while at + HEAD.size <= len(data):
        kind, length = HEAD.unpack_from(data, at)
        if not length or at + length > len(data):
            return
        yield kind, at, length
        at += length


def has_steps(data: bytes) -> bool:
    """Whether a file that begins with ``data`` is a recording with steps of the gateway."""
    return any(kind == CUSTOM and CUSTOM_HEAD.unpack_from(data, at)[2] == ENTERPRISE for kind, at, _ in walk(data))


def cycle_at(data: bytes, at: int) -> tuple[int, int] | None:
    """Monotonic time and flags of the cycle in a block; None: it has none."""
    kind, _, enterprise, content, _ = CUSTOM_HEAD.unpack_from(data, at)
    if (kind, enterprise, content) != (CUSTOM, ENTERPRISE, CYCLE):
        return None
    _, time_ns, _, flags, _ = CYCLE_HEAD.unpack_from(data, at + CUSTOM_HEAD.size)
    return time_ns, flags
