"""Sources of records for programs: open a file or standard input, decode, iterate.

The content determines the format, else the name."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final

from pdgw.tools.decoder.capture.canlog import SAVVYCAN, is_candump, read_candump, read_messages, read_savvycan
from pdgw.tools.decoder.capture.pcap import CaptureError, is_pcap, read_capture, unpacked
from pdgw.tools.decoder.frames.engine import CanPacket, Decoder, Packet, Settings, given_axes
from pdgw.tools.decoder.frames.records import Record

if TYPE_CHECKING:
    from can.io.generic import MessageReader


def read_records(path: str | PathLike[str], telegrams: Sequence[int] = ()) -> Iterator[Record]:
    """Read the records of a capture of either bus (pcap, pcapng, candump, python-can's logs), one for each packet, in order.

    ``telegrams``: those of the axes, in the order of the frame; without them they are inferred, and the first frames are
    undecided. Raises CaptureError for a file that cannot be opened, has an unknown format or ends early, ProfidriveError for a
    telegram that does not exist.
    """
    decoder = Decoder(Settings(given_axes(telegrams)))
    with open_source(fspath(path)) as source:
        for packet in source.packets:
            yield decoder.decode(packet)


STANDARD_INPUT: Final = "-"
_HEAD: Final = 2048
_BLF: Final = ".blf"
_BLF_SIZE: Final = slice(16, 24)
"""Place of the file length in the header."""
_BINARY_READERS: Final = {_BLF: "BLFReader", ".mf4": "MF4Reader"}
_CSV: Final = ".csv"
_CSV_HEADER: Final = b"timestamp,arbitration_id,"
_TEXT_READERS: Final = {".asc": "ASCReader", _CSV: "CSVReader", ".trc": "TRCReader"}
_DATABASE: Final = ".db"
_CONTENT: Final = ((b"LOGG", _BLF), (b"MDF ", ".mf4"), (b"date ", ".asc"), (b";", ".trc"), (_CSV_HEADER, _CSV))
"""First bytes of the formats of python-can."""
_ENCODINGS: Final = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}
"""Byte order marks of text; Notepad and PowerShell write them."""
FORMATS: Final = "pcap, pcapng (also .gz), candump, .asc, .blf, .csv (python-can, SavvyCAN), .db, .mf4, .trc"


@dataclass
class Source:
    """Packets to decode; a context manager that closes its source. ``size`` is None if unknown."""

    name: str
    packets: Iterator[Packet | CanPacket]
    size: int | None = None
    position: Callable[[], int] = field(default=lambda: 0)
    """Number of bytes read."""
    closing: ExitStack = field(default_factory=ExitStack)
    notices: list[str] = field(default_factory=list)
    """What the reader ignored; complete at the end of the packets."""

    def __enter__(self) -> Source:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.closing.close()


def unreadable(file: Path, error: OSError) -> str:
    """Why a capture cannot be opened, and what to do."""
    if file.is_dir():
        return f"a folder; name the files in it, for example {file / 'gateway.pcapng'}"
    return f"cannot be read ({error.strerror or error})"


def open_source(path: str) -> Source:
    """A capture or log by its path, ``-`` for standard input; CaptureError if it cannot be opened or has an unknown format."""
    if path == STANDARD_INPUT:
        return source_of_stream("standard input", "", sys.stdin.buffer, None, ExitStack())
    file = Path(path)
    closing = ExitStack()
    try:
        stream = closing.enter_context(file.open("rb"))
        size = file.stat().st_size
    except OSError as error:
        raise CaptureError(path, None, unreadable(file, error)) from error
    if file.suffix.lower() == _DATABASE:
        return _database(path, closing)
    try:
        return source_of_stream(path, file.suffix.lower(), stream, size, closing)
    except BaseException:
        closing.close()
        raise


def source_of_stream(name: str, suffix: str, stream: Any, size: int | None, closing: ExitStack) -> Source:
    """An open buffered binary stream as ``open_source`` would take it: ``suffix`` decides where the content does not."""
    position = _position(stream)
    stream, packed = unpacked(stream, name), stream
    head = bytes(stream.peek(_HEAD)[:_HEAD])
    if not head:
        raise CaptureError(name, 0, "is empty")
    if stream is not packed and not is_pcap(head):
        size = None  # of the content, which other readers need
    for mark, encoding in _ENCODINGS.items():
        if head.startswith(mark):
            stream = io.BufferedReader(_Recoded(io.TextIOWrapper(stream, encoding, "replace")))
            head = bytes(stream.peek(_HEAD)[:_HEAD])
    if is_pcap(head):
        return Source(name, read_capture(stream, name), size, position, closing)
    if is_candump(head) or suffix == ".log":
        notices: list[str] = []
        return Source(name, read_candump(stream, name, notices), size, position, closing, notices)
    if head.startswith(SAVVYCAN):
        return Source(name, read_savvycan(stream, name), size, position, closing)
    for begin, kind in _CONTENT:
        if head.startswith(begin):
            return _messages(name, kind, stream, size, closing)
    if suffix == _CSV:
        headers = f"{_CSV_HEADER.decode()}... (python-can) or {SAVVYCAN.decode()}... (SavvyCAN)"
        raise CaptureError(name, 0, f"unknown CSV file: its first line must be {headers}")
    if suffix in _BINARY_READERS or suffix in _TEXT_READERS:
        return _messages(name, suffix, stream, size, closing)
    raise CaptureError(name, 0, f"unknown format: the file begins with {head[:8].hex(' ')}; known formats: {FORMATS}")


class _Recoded(io.RawIOBase):
    """Text of any encoding as UTF-8."""

    def __init__(self, text: io.TextIOWrapper) -> None:
        self._text = text
        self._rest = b""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        self._rest = self._rest or self._text.read(len(buffer)).encode()
        size = min(len(buffer), len(self._rest))
        buffer[:size], self._rest = self._rest[:size], self._rest[size:]
        return size


def _position(stream: Any) -> Callable[[], int]:
    def position() -> int:
        return int(stream.tell()) if stream.seekable() else 0

    return position


def _messages(name: str, suffix: str, stream: Any, size: int | None, closing: ExitStack) -> Source:
    """A log that one of python-can's readers reads."""
    import can  # noqa: PLC0415 (slow to load, and most captures do without)

    text = suffix in _TEXT_READERS
    stream_head = stream.peek(_HEAD)[:_HEAD]
    reader_class = getattr(can, _TEXT_READERS[suffix] if text else _BINARY_READERS[suffix])
    position = _position(stream)
    # Latin-1 accepts every byte, so a comment in another code page does no harm.
    taken = io.TextIOWrapper(stream, encoding="latin-1") if text else stream
    source = _from_reader(name, lambda: reader_class(taken), size, position, closing)
    if suffix == _BLF and size is not None:
        source.packets = _whole(source.packets, name, size, int.from_bytes(stream_head[_BLF_SIZE], "little"))
    return source


def _whole(packets: Iterator[Packet | CanPacket], name: str, size: int, announced: int) -> Iterator[Packet | CanPacket]:
    """python-can's reader does not report a truncated BLF file; its header has the right length."""
    yield from packets
    if size < announced:
        raise CaptureError(name, size, f"the file is incomplete: its header announces {announced} bytes")


def _database(path: str, closing: ExitStack) -> Source:
    import can  # noqa: PLC0415

    return _from_reader(path, lambda: can.SqliteReader(path), None, lambda: 0, closing)


def _from_reader(
    name: str, make: Callable[[], MessageReader], size: int | None, position: Callable[[], int], closing: ExitStack
) -> Source:
    try:
        reader = make()
    except NotImplementedError as error:
        raise CaptureError(name, None, f"needs another Python package ({error})") from error
    except Exception as error:  # python-can's readers pass on any exception of their parsing
        raise CaptureError(name, position(), f"cannot be read ({type(error).__name__}: {error})") from error
    closing.callback(reader.stop)
    return Source(name, read_messages(reader, name, position), size, position, closing)
