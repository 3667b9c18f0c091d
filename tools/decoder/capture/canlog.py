"""CAN logs: candump's two text forms and SavvyCAN's CSV by own readers, every other format by python-can's.

Source: can-utils (candump -l / -L writes ``(time) interface id#data``; on a terminal ``(time) interface id [n] bytes``, the time
in seconds or, with ``-tA``, a date); SavvyCAN (native CSV, time stamps in microseconds).
Text around a frame and lines without one (prompts, titles, comments, quotation marks) are ignored and counted. A frame that is
cut or contradicts itself is a ``CaptureError`` with the offset, after all frames before it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from pdgw.base.durations import SECOND, US
from pdgw.base.phrases import counted
from pdgw.ds301.bus.can_frame import ERROR, EXTENDED_ID, STANDARD_ID
from pdgw.tools.decoder.capture.pcap import ByteSource, CaptureError, Window
from pdgw.tools.decoder.frames.engine import CanPacket
from pdgw.tools.decoder.frames.link import CanFrame

if TYPE_CHECKING:
    import can

MAX_LINE: Final = 1024
_SHOWN: Final = 40
"""Bytes of a bad line in its message."""
_LOG = re.compile(rb"\((\d{1,12})\.(\d{1,9})\) +(\S+) +([0-9A-Fa-f]{3,8})#([0-9A-Fa-f]*)(?: +[RT])?\s*\Z")
_BEGIN: Final = rb"(?<![^\s>|:])"
"""A frame begins a line or follows a blank, a quotation mark or a line number."""
_LOG_OTHER = re.compile(
    _BEGIN
    + rb"\((\d{1,12})\.(\d{1,9})\) +(\S+) +([0-9A-Fa-f]{3,8})#(?:([Rr])(\d?)|(?:#[0-9A-Fa-f])?([0-9A-Fa-f]*))(?!\S)"
)
_TERMINAL = re.compile(
    _BEGIN + rb"(?:\((\d{1,12}|\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)\.(\d{1,9})\) +)?"
    rb"([^\s>|:]\S*) +(?:[RT]X? +(?:[B-] +[E-] +)?)?([0-9A-Fa-f]{3,8}) +\[(\d{1,2})\] *"
    rb"(?:(remote request)|((?:[0-9A-Fa-f]{2}(?:\s+|\Z))*))"
)
_EXTENDED_DIGITS: Final = 8


SAVVYCAN: Final = b"Time Stamp,ID,Extended,"
"""First bytes of a native CSV file of SavvyCAN."""


def is_candump(head: bytes) -> bool:
    """Whether a line of text is one of a candump log."""
    return any(form.search(line) for line in head.splitlines() for form in (_LOG_OTHER, _TERMINAL))


def _lines(source: ByteSource, name: str) -> Iterator[tuple[int, bytes]]:
    """Offset and text of each line."""
    window = Window(source)
    while window.need(1):
        end = window.data.find(b"\n", window.at)
        while end < 0:
            if window.left > MAX_LINE:
                raise CaptureError(name, window.offset, f"no line end within {MAX_LINE} bytes")
            if not window.need(window.left + 1):
                end = len(window.data)
                break
            end = window.data.find(b"\n", window.at)
        line = window.data[window.at : end]
        yield window.offset, line
        window.at = min(end + 1, len(window.data))


def read_candump(source: ByteSource, name: str, notices: list[str]) -> Iterator[CanPacket]:
    """The frames of a candump log; at its end ``notices`` has the number of lines without a frame."""
    number = ignored = 0
    first = ""
    channels: dict[bytes, str] = {}
    for offset, line in _lines(source, name):
        match = _LOG.match(line)
        if match is not None:
            seconds, fraction, channel, identifier, digits = match.groups()
            frame = _frame(identifier, _octets(digits, line, offset, name))
        else:
            parts = _other_forms(line, offset, name)
            if parts is None:
                ignored += bool(line.strip())
                first = first or f"the first at offset {offset}: {line[:_SHOWN]!r}"
                continue
            seconds, fraction, channel, frame = parts
        number += 1
        text = channels.get(channel)
        if text is None:
            text = channels[channel] = channel.decode("utf-8", "replace")
        yield CanPacket(number, int(seconds) * SECOND + int(fraction.ljust(9, b"0")), text, frame)
    if not number:
        raise CaptureError(name, 0, f"not a candump log: no frame in {ignored} lines")
    if ignored:
        notices.append(f"{counted(ignored, 'line')} without a frame ignored, {first}")


def read_savvycan(source: ByteSource, name: str) -> Iterator[CanPacket]:
    """The frames of a native CSV file of SavvyCAN."""
    header: list[bytes] = []
    number = 0
    for offset, line in _lines(source, name):
        columns = [column.strip() for column in line.split(b",")]
        if not header:
            header = columns
            continue
        if not line.strip():
            continue
        found = dict(zip(header, columns, strict=False))
        try:
            data = b"".join(found[b"D%d" % place] for place in range(1, int(found[b"LEN"]) + 1))
            identifier = int(found[b"ID"], 16)
            time_us = float(found[b"Time Stamp"])
            frame = CanFrame(identifier, bytes.fromhex(data.decode()), found[b"Extended"].lower() == b"true")
        except (ValueError, KeyError) as error:
            raise CaptureError(name, offset, f"{line[:_SHOWN]!r}: not a frame of SavvyCAN") from error
        number += 1
        yield CanPacket(number, round(time_us * US), found.get(b"Bus", b"").decode("latin-1"), frame)


def _octets(digits: bytes, line: bytes, offset: int, name: str) -> bytes:
    if len(digits) % 2:
        raise CaptureError(name, offset, f"{line[:_SHOWN]!r}: the data ends with half a byte")
    return bytes.fromhex(digits.decode())


def _frame(identifier: bytes, data: bytes, remote: bool = False) -> CanFrame:
    number = int(identifier, 16)
    if len(identifier) < _EXTENDED_DIGITS:
        return CanFrame(number & STANDARD_ID, data, remote=remote)
    if number & ERROR:
        return CanFrame(number & STANDARD_ID, data, error=True)
    return CanFrame(number & EXTENDED_ID, data, extended=True, remote=remote)


def _date(text: bytes, line: bytes, offset: int, name: str) -> bytes:
    """Seconds of a date. The log has no time zone: read as UTC."""
    try:
        moment = datetime.fromisoformat(text.decode()).replace(tzinfo=UTC)
    except ValueError as error:
        raise CaptureError(name, offset, f"{line[:_SHOWN]!r}: {error}") from error
    return b"%d" % moment.timestamp()


def _other_forms(line: bytes, offset: int, name: str) -> tuple[bytes, bytes, bytes, CanFrame] | None:
    """Time, interface and frame of a line; None for a line without a frame."""
    match = _LOG_OTHER.search(line)
    if match is not None:
        seconds, fraction, channel, identifier, remote, length, digits = match.groups()
        data = bytes(int(length or 0)) if remote else _octets(digits, line, offset, name)
        return seconds, fraction, channel, _frame(identifier, data, bool(remote))
    match = _TERMINAL.search(line)
    if match is None:
        return None
    seconds, fraction, channel, identifier, length, remote, digits = match.groups()
    size = int(length)
    data = bytes(size) if remote else bytes.fromhex(digits.decode())[:size]
    if len(data) != size:
        raise CaptureError(name, offset, f"{line[:_SHOWN]!r}: {len(data)} data bytes, but the line announces {size}")
    if b":" in (seconds or b""):
        seconds = _date(seconds, line, offset, name)
    return seconds or b"0", fraction or b"0", channel, _frame(identifier, data, bool(remote))


def message_packet(number: int, message: can.Message) -> CanPacket:
    """A python-can message as the decoder takes it."""
    frame = CanFrame(
        message.arbitration_id,
        bytes(message.data),
        message.is_extended_id and not message.is_error_frame,
        message.is_remote_frame,
        message.is_error_frame,
    )
    channel = "" if message.channel is None else str(message.channel)
    return CanPacket(number, round(message.timestamp * SECOND), channel, frame)


def read_messages(messages: Iterable[can.Message], name: str, position: Callable[[], int]) -> Iterator[CanPacket]:
    """The frames python-can reads; ``position`` is the read position in the file."""
    number = 0
    iterator = iter(messages)
    while True:
        try:
            message = next(iterator)
            packet = message_packet(number + 1, message)
        except StopIteration:
            return
        except Exception as error:  # python-can's readers pass on any exception of their parsing
            text = f"frame {number + 1} cannot be read ({type(error).__name__}: {error})"
            raise CaptureError(name, position(), text) from error
        number += 1
        yield packet
