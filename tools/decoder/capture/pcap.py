"""Capture files in the formats pcap and pcapng, packet by packet, with the configuration in a pcapng file.

A stream is read in blocks, with a window that is cut from the front: constant memory for files of any size.

Source: draft-ietf-opsawg-pcap, draft-ietf-opsawg-pcapng (section header, interface description, enhanced, simple and
obsolete packet blocks; both byte orders; if_name, if_tsresol, if_tsoffset). Own readers, because they are the hot path of
the decoder. Left out: decryption secrets, name resolution, statistics: skipped. A damaged file is a ``CaptureError`` with
the offset."""

from __future__ import annotations

import gzip
import io
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

from pdgw.base.durations import SECOND, US
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.trace import pcapng
from pdgw.tools.decoder.frames.engine import Packet


class CaptureError(GatewayError):
    """A capture cannot be read any further. The text names the source, the offset in bytes and the error."""

    def __init__(self, source: str, offset: int | None, what: str) -> None:
        self.source = source
        self.offset = offset
        where = "" if offset is None else f"offset {offset}: "
        super().__init__(f"{source}: {where}{what}")


_HEAD_MAX: Final = 2 << 16
"""Bytes that contain a section header."""


_GZIP_MAGIC: Final = b"\x1f\x8b"


class _Unpacked(io.RawIOBase):
    """What is in a stream that gzip has compressed. CaptureError where it is damaged, after everything before."""

    def __init__(self, stream: Any, name: str) -> None:
        self._gzip = gzip.GzipFile(fileobj=stream)
        self._name = name

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        try:
            part = self._gzip.read1(len(buffer))
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            what = f"the compressed data is damaged or ends early, run gzip --test ({error})"
            raise CaptureError(self._name, self._gzip.tell(), what) from error
        buffer[: len(part)] = part
        return len(part)


def unpacked(stream: Any, name: str) -> Any:
    """A buffered binary stream, or what is in it if gzip has compressed it. Offsets are those of the content."""
    if stream.peek(len(_GZIP_MAGIC))[: len(_GZIP_MAGIC)] != _GZIP_MAGIC:
        return stream
    return io.BufferedReader(_Unpacked(stream, name))


def head_of(path: Path, size: int) -> bytes:
    """The first bytes of a capture, unpacked; fewer if it is shorter or damaged. OSError if it cannot be read."""
    head = b""
    with path.open("rb") as file, suppress(CaptureError):
        stream = unpacked(file, str(path))
        while len(head) < size and (part := stream.read1(size - len(head))):
            head += part
    return head


def configuration_in(path: Path) -> str:
    """The gateway's configuration in a pcapng file's first comment; empty where there is none."""
    try:
        return pcapng.configuration(head_of(path, _HEAD_MAX))
    except OSError:
        return ""


BLOCK = 1 << 20


class ByteSource(Protocol):
    """The interface of a file, pipe or standard input."""

    def read1(self, size: int, /) -> bytes:
        """Bytes as they come, at most ``size``; empty at the end."""


class Window:
    """``data[at:]`` has been read and is not used yet. ``base``: offset of ``data`` in the stream."""

    def __init__(self, source: ByteSource) -> None:
        self._source = source
        self.data = b""
        self.at = 0
        self.base = 0
        self.ended = False

    @property
    def offset(self) -> int:
        """Number of used bytes of the stream."""
        return self.base + self.at

    @property
    def left(self) -> int:
        return len(self.data) - self.at

    def need(self, size: int) -> bool:
        """Read until ``size`` bytes are there; False when the stream ends before."""
        while len(self.data) - self.at < size:
            if self.ended:
                return False
            part = self._source.read1(BLOCK)
            if not part:
                self.ended = True
                return False
            self.base += self.at
            self.data = self.data[self.at :] + part
            self.at = 0
        return True


MAX_PACKET: Final = 1 << 18
"""The largest snapshot length of tcpdump and dumpcap; a longer packet is a damaged length."""
_MAX_BLOCK: Final = 1 << 24

_PCAP_MAGICS: Final = {
    b"\xd4\xc3\xb2\xa1": ("<", US),
    b"\xa1\xb2\xc3\xd4": (">", US),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""Byte order and nanoseconds of one unit of the fraction."""
_PCAP_HEADER: Final = 24
_PCAP_RECORD: Final = 16

PCAPNG_MAGIC: Final = b"\x0a\x0d\x0d\x0a"
_INTERFACE = 1
_PACKET_OBSOLETE = 2
_SIMPLE = 3
_ENHANCED = 6
_ENHANCED_HEAD = 24
"""Up to the captured length."""
_ENHANCED_DATA = 28
_ENHANCED_ROOM = 32
"""Bytes of a block other than data."""
_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_IF_NAME = 2
_IF_TSRESOL = 9
_IF_TSOFFSET = 14


def is_pcap(head: bytes) -> bool:
    """Whether a file begins like pcap or pcapng."""
    return head[:4] in _PCAP_MAGICS or head[:4] == PCAPNG_MAGIC


def read_capture(source: ByteSource, name: str) -> Iterator[Packet]:
    """The packets of a pcap or pcapng stream; CaptureError where it is damaged, after all packets before."""
    window = Window(source)
    if not window.need(4):
        raise CaptureError(name, window.left, "not a capture: the file has less than four bytes")
    if window.data[:4] == PCAPNG_MAGIC:
        return _Pcapng(window, name).packets()
    if window.data[:4] not in _PCAP_MAGICS:
        raise CaptureError(name, 0, f"not a pcap or pcapng file: it begins with {window.data[:4].hex(' ')}")
    return _pcap(window, name)


def _pcap(window: Window, name: str) -> Iterator[Packet]:
    order, fraction_ns = _PCAP_MAGICS[window.data[:4]]
    if not window.need(_PCAP_HEADER):
        raise CaptureError(name, window.left, f"the file ends within its header of {_PCAP_HEADER} bytes")
    (link,) = struct.unpack_from(order + "I", window.data, 20)
    link &= 0xFFFF  # the upper bits are the length of the frame check sequence and reserved bits
    window.at = _PCAP_HEADER
    unpack = struct.Struct(order + "III").unpack_from
    number = 0
    while window.need(_PCAP_RECORD):
        data, at, size = window.data, window.at, len(window.data)
        while at + _PCAP_RECORD <= size:
            seconds, fraction, length = unpack(data, at)
            end = at + _PCAP_RECORD + length
            if end > size:
                break
            number += 1
            yield Packet(number, seconds * SECOND + fraction * fraction_ns, link, "", data[at + _PCAP_RECORD : end])
            at = end
        window.at = at
        if at + _PCAP_RECORD <= size:
            length = unpack(data, at)[2]
            if length > MAX_PACKET:
                raise CaptureError(
                    name,
                    window.offset,
                    f"packet {number + 1} has {length} bytes according to its header, allowed: at most {MAX_PACKET}",
                )
            if not window.need(_PCAP_RECORD + length):
                missing = _PCAP_RECORD + length - window.left
                raise CaptureError(
                    name, window.offset, f"the file ends within packet {number + 1}, {missing} bytes missing"
                )
    if window.left:
        raise CaptureError(name, window.offset, f"the file ends within the header of packet {number + 1}")


@dataclass(slots=True)
class _Interface:
    link: int
    name: str
    unit: tuple[int, int]
    """Nanoseconds of one time unit as a fraction."""
    offset_ns: int
    snap: int
    nanoseconds: int
    """Nanoseconds of one time unit, 0 if not a whole number."""

    def time_ns(self, high: int, low: int) -> int:
        numerator, denominator = self.unit
        return (high << 32 | low) * numerator // denominator + self.offset_ns


class _Pcapng:
    def __init__(self, window: Window, name: str) -> None:
        self._window = window
        self._name = name
        self._order = "<"
        self._interfaces: list[_Interface] = []
        self._number = 0
        self._time_ns = 0

    def _error(self, what: str) -> CaptureError:
        return CaptureError(self._name, self._window.offset, what)

    def packets(self) -> Iterator[Packet]:
        window = self._window
        while window.need(8):
            yield from self._plain_packets()
            if not window.need(8):
                break
            if window.data[window.at : window.at + 4] == PCAPNG_MAGIC:
                self._section()
            kind, length = struct.unpack_from(self._order + "II", window.data, window.at)
            if length < 12 or length % 4 or length > _MAX_BLOCK:
                raise self._error(f"block length {length} is not allowed, expected a multiple of 4 in 12..{_MAX_BLOCK}")
            if not window.need(length):
                raise self._error(f"the file ends within a block of {length} bytes, {length - window.left} missing")
            end = window.at + length
            (again,) = struct.unpack_from(self._order + "I", window.data, end - 4)
            if again != length:
                raise self._error(f"block length {length} differs from the length at its end, {again}")
            packet = self._block(kind, window.at + 8, end - 4)
            window.at = end
            if packet is not None:
                yield packet
        if window.left:
            raise self._error(f"the file ends within a block header, {8 - window.left} bytes missing")

    def _plain_packets(self) -> Iterator[Packet]:
        """The hot path: sound enhanced packet blocks that are in the window; whatever is not is left to ``packets``."""
        window, interfaces = self._window, self._interfaces
        data, at = window.data, window.at
        size = len(data)
        head = struct.Struct(self._order + "IIIIII").unpack_from
        tail = struct.Struct(self._order + "I").unpack_from
        number = self._number
        while at + _ENHANCED_HEAD <= size:
            kind, block, which, high, low, length = head(data, at)
            end = at + block
            if kind != _ENHANCED or end > size or block % 4 or length > block - _ENHANCED_ROOM:
                break
            if which >= len(interfaces) or tail(data, end - 4)[0] != block:
                break
            interface = interfaces[which]
            number += 1
            if interface.nanoseconds:
                self._time_ns = (high << 32 | low) * interface.nanoseconds + interface.offset_ns
            else:
                self._time_ns = interface.time_ns(high, low)
            begin = at + _ENHANCED_DATA
            yield Packet(number, self._time_ns, interface.link, interface.name, data[begin : begin + length])
            at = end
            window.at, self._number = at, number

    def _section(self) -> None:
        window = self._window
        if not window.need(12):
            raise self._error("the file ends within a section header")
        magic = window.data[window.at + 8 : window.at + 12]
        if magic not in _ORDERS:
            raise self._error(f"byte-order magic {magic.hex(' ')} is unknown")
        self._order = _ORDERS[magic]
        self._interfaces = []

    def _block(self, kind: int, begin: int, end: int) -> Packet | None:
        if kind == _ENHANCED:
            return self._packet("IIIII", begin, end)
        if kind == _INTERFACE:
            self._interface(begin, end)
        elif kind == _SIMPLE:
            return self._simple(begin, end)
        elif kind == _PACKET_OBSOLETE:
            return self._packet("HxxIIII", begin, end)
        return None

    def _packet(self, layout: str, begin: int, end: int) -> Packet:
        if end - begin < 20:
            raise self._error(f"packet block of {end - begin} bytes, at least 20 are needed")
        data = self._window.data
        which, high, low, length, _ = struct.unpack_from(self._order + layout, data, begin)
        interface = self._interface_of(which)
        if length > end - begin - 20:
            raise self._error(f"a packet of {length} bytes is in a block with room for {end - begin - 20}")
        self._number += 1
        self._time_ns = interface.time_ns(high, low)
        return Packet(
            self._number, self._time_ns, interface.link, interface.name, data[begin + 20 : begin + 20 + length]
        )

    def _simple(self, begin: int, end: int) -> Packet:
        if end - begin < 4:
            raise self._error("simple packet block without length")
        interface = self._interface_of(0)
        (length,) = struct.unpack_from(self._order + "I", self._window.data, begin)
        length = min(length, interface.snap or length, end - begin - 4)
        self._number += 1
        # The block has no time: the packet gets the time of the previous one.
        data = self._window.data[begin + 4 : begin + 4 + length]
        return Packet(self._number, self._time_ns, interface.link, interface.name, data)

    def _interface_of(self, which: int) -> _Interface:
        if which >= len(self._interfaces):
            raise self._error(
                f"a packet belongs to interface {which}, but the file describes only {len(self._interfaces)}"
            )
        return self._interfaces[which]

    def _interface(self, begin: int, end: int) -> None:
        if end - begin < 8:
            raise self._error("interface description block without link type")
        link, _, snap = struct.unpack_from(self._order + "HHI", self._window.data, begin)
        options = dict(self._options(begin + 8, end))
        resolution = options.get(_IF_TSRESOL, b"\x06")[:1] or b"\x06"
        exponent = resolution[0] & 0x7F
        ticks = 2**exponent if resolution[0] & 0x80 else 10**exponent
        seconds = options.get(_IF_TSOFFSET, b"")
        offset = struct.unpack(self._order + "q", seconds)[0] * SECOND if len(seconds) == 8 else 0
        name = options.get(_IF_NAME, b"").rstrip(b"\0").decode("utf-8", "replace")
        whole = 0 if SECOND % ticks else SECOND // ticks
        self._interfaces.append(_Interface(link, name, (SECOND, ticks), offset, snap, whole))

    def _options(self, at: int, end: int) -> Iterator[tuple[int, bytes]]:
        data = self._window.data
        while at + 4 <= end:
            code, length = struct.unpack_from(self._order + "HH", data, at)
            if not code:
                return
            if at + 4 + length > end:
                raise self._error(f"option {code} of {length} bytes does not fit into its block")
            yield code, data[at + 4 : at + 4 + length]
            at += 4 + (length + 3 & ~3)
