"""CAN logs: candump's two text forms by own readers, every other format by python-can's.

Source: can-utils (candump -l / -L writes ``(time) interface id#data``; on a terminal ``(time) interface id [n] bytes``, the time
in seconds or, with ``-tA``, a date).
A line or file that cannot be understood is a ``CaptureError`` with the offset, after all frames before it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from pdgw.decoder.capture.errors import CaptureError
from pdgw.decoder.capture.stream import ByteSource, Window
from pdgw.decoder.frames.engine import CanPacket
from pdgw.decoder.frames.link import CanFrame
from pdgw.ds301.bus.can_frame import ERROR, EXTENDED_ID, STANDARD_ID
from pdgw.durations import SECOND, US

if TYPE_CHECKING:
    import can

MAX_LINE: Final = 1024
_SHOWN: Final = 40
"""Bytes of a bad line in its message."""
_US_PER_SECOND: Final = SECOND // US
_LOG = re.compile(rb"\((\d{1,12})\.(\d{1,9})\) +(\S+) +([0-9A-Fa-f]{3,8})#([0-9A-Fa-f]*)(?: +[RT])?\s*\Z")
_LOG_OTHER = re.compile(
    rb"\((\d{1,12})\.(\d{1,9})\) +(\S+) +([0-9A-Fa-f]{3,8})#(?:([Rr])(\d?)|#[0-9A-Fa-f]([0-9A-Fa-f]*))(?: +[RT])?\s*\Z"
)
_TERMINAL = re.compile(
    rb"\s*(?:\((\d{1,12}|\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)\.(\d{1,9})\) +)?"
    rb"(\S+) +(?:[RT]X? +(?:[B-] +[E-] +)?)?([0-9A-Fa-f]{3,8}) +\[(\d{1,2})\] *"
    rb"(?:(remote request)|((?:[0-9A-Fa-f]{2}(?: +|\Z))*))\s*(?:ERRORFRAME)?\s*\Z"
)
_EXTENDED_DIGITS: Final = 8


def is_candump(head: bytes) -> bool:
    """Whether text begins like a candump log."""
    lines = head.lstrip().splitlines()
    return bool(lines) and any(form.match(lines[0]) for form in (_LOG, _LOG_OTHER, _TERMINAL))


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


def read_candump(source: ByteSource, name: str) -> Iterator[CanPacket]:
    """The frames of a candump log."""
    number = 0
    channels: dict[bytes, str] = {}
    for offset, line in _lines(source, name):
        match = _LOG.match(line)
        if match is not None:
            seconds, fraction, channel, identifier, digits = match.groups()
            if len(digits) % 2:
                raise CaptureError(name, offset, f"{line[:_SHOWN]!r}: the data ends with half a byte")
            frame = _frame(identifier, bytes.fromhex(digits.decode()))
        else:
            if not line.strip():
                continue
            seconds, fraction, channel, frame = _other_forms(line, offset, name)
        number += 1
        text = channels.get(channel)
        if text is None:
            text = channels[channel] = channel.decode("utf-8", "replace")
        yield CanPacket(number, int(seconds) * SECOND + int(fraction.ljust(9, b"0")), text, frame)


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


def _other_forms(line: bytes, offset: int, name: str) -> tuple[bytes, bytes, bytes, CanFrame]:
    match = _LOG_OTHER.match(line)
    if match is not None:
        seconds, fraction, channel, identifier, remote, length, digits = match.groups()
        data = bytes(int(length or 0)) if remote else bytes.fromhex((digits or b"")[: len(digits or b"") & ~1].decode())
        return seconds, fraction, channel, _frame(identifier, data, bool(remote))
    match = _TERMINAL.match(line)
    if match is not None:
        seconds, fraction, channel, identifier, length, remote, digits = match.groups()
        data = bytes(int(length)) if remote else bytes.fromhex((digits or b"").decode())
        if len(data) != int(length):
            raise CaptureError(
                name, offset, f"{line[:_SHOWN]!r}: {len(data)} data bytes, but the line announces {int(length)}"
            )
        if b":" in (seconds or b""):
            seconds = _date(seconds, line, offset, name)
        return seconds or b"0", fraction or b"0", channel, _frame(identifier, data, bool(remote))
    raise CaptureError(name, offset, f"{line[:_SHOWN]!r}: not a line of a candump log")


def candump_line(message: can.Message) -> str:
    """A frame as ``candump -L`` writes it: ``(seconds.microseconds) channel id#data`` and nothing after it.

    python-can's own writer adds R or T for the direction, which Wireshark 4.0 does not read.
    """
    microseconds = round(message.timestamp * _US_PER_SECOND)
    head = f"({microseconds // _US_PER_SECOND}.{microseconds % _US_PER_SECOND:06d}) {message.channel or 'can'} "
    if message.is_error_frame:
        return f"{head}{ERROR | message.arbitration_id:08X}#0000000000000000\n"
    identifier = f"{message.arbitration_id:0{_EXTENDED_DIGITS if message.is_extended_id else 3}X}"
    return f"{head}{identifier}#{f'R{message.dlc}' if message.is_remote_frame else message.data.hex().upper()}\n"


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
