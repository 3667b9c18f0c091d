"""SDO transfers against a plain model of both sides that makes their frames, losses in block transfers included."""

from __future__ import annotations

import binascii
from collections.abc import Iterator

from hypothesis import given
from hypothesis import strategies as st

from pdgw.tools.decoder.frames.canopen.sdo import MAX_TRANSFER, SdoChannel, Step

Frame = tuple[bool, bytes]
"""From the client, data."""
INDEX, SUBINDEX = 0x2000, 3
MULTIPLEXER = bytes((0x00, 0x20, SUBINDEX))


def expedited(value: bytes) -> Iterator[Frame]:
    unused = 4 - len(value)
    yield True, bytes((0x23 | unused << 2,)) + MULTIPLEXER + value.ljust(4, b"\0")
    yield False, b"\x60" + MULTIPLEXER + bytes(4)


def expedited_upload(value: bytes) -> Iterator[Frame]:
    unused = 4 - len(value)
    yield True, b"\x40" + MULTIPLEXER + bytes(4)
    yield False, bytes((0x43 | unused << 2,)) + MULTIPLEXER + value.ljust(4, b"\0")


def parts(value: bytes) -> list[bytes]:
    return [value[i : i + 7] for i in range(0, len(value), 7)] or [b""]


def segmented(value: bytes, *, upload: bool) -> Iterator[Frame]:
    size = len(value).to_bytes(4, "little")
    if upload:
        yield True, b"\x40" + MULTIPLEXER + bytes(4)
        yield False, b"\x41" + MULTIPLEXER + size
    else:
        yield True, b"\x21" + MULTIPLEXER + size
        yield False, b"\x60" + MULTIPLEXER + bytes(4)
    segments = parts(value)
    for number, part in enumerate(segments):
        toggle = (number & 1) << 4
        head = toggle | (7 - len(part)) << 1 | (number == len(segments) - 1)
        segment = bytes((head,)) + part.ljust(7, b"\0")
        if upload:
            yield True, bytes((0x60 | toggle,)) + bytes(7)
            yield False, segment
        else:
            yield True, segment
            yield False, bytes((0x20 | toggle,)) + bytes(7)


def block(value: bytes, size: int, losses: list[int], *, upload: bool) -> Iterator[Frame]:
    """``losses``: for each block in turn, how many segments the receiver took (the rest comes again)."""
    announced = len(value).to_bytes(4, "little")
    if upload:
        yield True, b"\xa4" + MULTIPLEXER + bytes((size, 0, 0, 0))
        yield False, b"\xc6" + MULTIPLEXER + announced
        yield True, b"\xa3" + bytes(7)
    else:
        yield True, b"\xc6" + MULTIPLEXER + announced
        yield False, b"\xa4" + MULTIPLEXER + bytes((size, 0, 0, 0))
    segments = parts(value)
    done = 0
    while done < len(segments):
        sent = segments[done : done + size]
        for number, part in enumerate(sent, 1):
            last = done + number == len(segments)
            yield not upload, bytes((number | 0x80 * last,)) + part.ljust(7, b"\0")
        taken = min(losses.pop(0), len(sent)) if losses else len(sent)
        yield upload, bytes((0xA2, taken, size)) + bytes(5)
        done += taken
    end = bytes((0xC1 | (7 - len(segments[-1])) << 2,)) + binascii.crc_hqx(value, 0).to_bytes(2, "little") + bytes(5)
    yield not upload, end
    yield upload, b"\xa1" + bytes(7)


def follow(frames: Iterator[Frame]) -> list[Step]:
    channel = SdoChannel()
    steps = [channel.feed(from_client, data, time) for time, (from_client, data) in enumerate(frames)]
    assert all((step.index, step.subindex) == (INDEX, SUBINDEX) for step in steps)
    assert all(not step.note or step.note[0].isdigit() or step.note.startswith("blocks of") for step in steps)
    return steps


def check(steps: list[Step], value: bytes) -> None:
    assert [step.value for step in steps if step.completes] == [value]


@given(value=st.binary(min_size=1, max_size=4))
def test_expedited(value: bytes) -> None:
    check(follow(expedited(value)), value)
    check(follow(expedited_upload(value)), value)


@given(value=st.binary(max_size=100), upload=st.booleans())
def test_segmented(value: bytes, upload: bool) -> None:
    check(follow(segmented(value, upload=upload)), value)


@given(
    value=st.binary(min_size=1, max_size=200),
    size=st.integers(1, 127),
    losses=st.lists(st.integers(0, 10), max_size=5),
    upload=st.booleans(),
)
def test_block_with_losses(value: bytes, size: int, losses: list[int], upload: bool) -> None:
    check(follow(block(value, size, losses, upload=upload)), value)


def test_next_transfer_starts_with_empty_state() -> None:
    channel = SdoChannel()
    frames = [*block(b"abc", 4, [], upload=True), *segmented(b"defghijkl", upload=False), *expedited_upload(b"m")]
    steps = [channel.feed(from_client, data, 0) for from_client, data in frames]
    assert [step.value for step in steps if step.completes] == [b"abc", b"defghijkl", b"m"]


def test_transfer_without_its_start_is_reported() -> None:
    step = SdoChannel().feed(False, b"\x01abcdefg", 0)
    assert (step.name, step.index, step.note) == ("upload segment", None, "start of the transfer missing")


def test_a_transfer_without_end_keeps_a_bounded_part() -> None:
    channel = SdoChannel()
    channel.feed(True, b"\x40" + MULTIPLEXER + bytes(4), 0)
    channel.feed(False, b"\x40" + MULTIPLEXER + bytes(4), 0)
    for number in range(MAX_TRANSFER // 7 + 10):
        channel.feed(False, bytes(((number & 1) << 4,)) + b"abcdefg", 0)
    number = MAX_TRANSFER // 7 + 10
    step = channel.feed(False, bytes(((number & 1) << 4 | 1,)) + b"abcdefg", 0)
    assert step.value is not None
    assert len(step.value) <= MAX_TRANSFER
    assert "the rest is discarded" in step.note


@given(frames=st.lists(st.tuples(st.booleans(), st.binary(min_size=8, max_size=8)), max_size=40))
def test_any_frames_are_described(frames: list[Frame]) -> None:
    channel = SdoChannel()
    for time, (from_client, data) in enumerate(frames):
        assert channel.feed(from_client, data, time).name
