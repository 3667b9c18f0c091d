"""Reader of the ring, for tools in other processes: it copies, compares, and omits records that were written meanwhile.

A reader never delays the writer and needs no lock: a record whose number changed during the copy is overwritten and omitted.
Where stores may be seen out of order (``ordering``) the number proves nothing. There the writer has a fence before each cycle, so
a record is complete when a later cycle is visible; the reader omits newer records and those that may be overwritten.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, Self, TypeVar

from pdgw.ds301.loop.loop import MACHINE_CLOCK
from pdgw.durations import SECOND
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.trace.layout import (
    FRAME,
    HEAD_FIELDS,
    OBJECT_FIELDS,
    PEER_OFFSET,
    PEER_SIZE,
    SEQUENCE,
    WORD,
    CycleFlag,
    ObjectFlag,
    RingLayout,
    Word,
)
from pdgw.gateway.trace.ordering import IN_ORDER, Fence
from pdgw.profidrive.telegrams import telegram

_SIGN = 1 << 63
_RESERVE = 4
"""Out of order, of 2^4 records the oldest one may be overwritten already: more frames than a bus carries in a cycle."""
_SETTLED_NS = SECOND
"""A store is seen long before that: what a daemon wrote last that writes no more, for whatever reason."""
_AT_ONCE = 256
"""Records copied between two looks at their numbers."""
T = TypeVar("T")


class ObjectSample(NamedTuple):
    """A drive object in one cycle. Velocity and position are raw object values, 0 where ``TracedObject`` has them not mapped."""

    velocity: int
    position: int
    statusword: int
    controlword: int
    reason: int
    """Code of the reason, 0 for none; ``RingLayout.reasons`` has the texts."""
    flags: int
    """``ObjectFlag``."""
    faults: int
    """Number of faults since the start, modulo 256."""


class Cycle(NamedTuple):
    """One cycle. ``time_ns`` is monotonic, see ``RingReader.wall_ns``."""

    sequence: int
    time_ns: int
    flags: int
    """``CycleFlag``."""
    response_us: int | None
    """Time from the PLC's frame to the answer; None without one; 65535: as much or more."""
    received: bytes
    """The PLC's newest frame, empty before the first one."""
    sent: bytes
    """The newest frame to the PLC."""
    objects: tuple[ObjectSample, ...]


class Frame(NamedTuple):
    """One CAN frame, in the order in which the gateway sent or saw them."""

    sequence: int
    time_ns: int
    identifier: int
    """With the flags of SocketCAN."""
    bus: int
    """Number of the bus in ``RingLayout.buses``."""
    sent: bool
    data: bytes


class RingReader:
    """An open ring; GatewayError when the file is none or damaged. ``in_order``: its stores are seen in their order."""

    def __init__(self, path: Path, *, in_order: bool = IN_ORDER) -> None:
        self.path = path
        self._in_order = in_order
        try:
            descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_CLOEXEC", 0))
        except OSError as error:
            raise GatewayError(f"{path}: {error.strerror or error}") from error
        try:
            self._inode = os.fstat(descriptor).st_ino
            self._map = mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise GatewayError(f"{path}: not a ring file of the flight recorder") from error
        finally:
            os.close(descriptor)
        self._view = memoryview(self._map)
        try:
            self.layout = RingLayout.parse(self._view, str(path))
        except BaseException:
            self._release()
            raise
        self._cycle = self.layout.cycle
        self._telegrams = [telegram(item.telegram) for item in self.layout.objects]
        self._reasons = ("", *self.layout.reasons)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._release()

    def _release(self) -> None:
        self._view.release()
        self._map.close()

    # -- data beside the records ----------------------------------------------------------------------------------------

    def _word(self, word: Word) -> int:
        value: int = SEQUENCE.unpack_from(self._map, word * WORD)[0]
        return value

    @property
    def ended(self) -> bool:
        """The daemon ended in order. One that was killed leaves this False and writes nothing more."""
        return self._word(Word.ENDED) != 0

    @property
    def process(self) -> int:
        """Process id of the daemon."""
        return self._word(Word.PROCESS)

    @property
    def replaced(self) -> bool:
        """Another ring, or none, has this name now: open it again."""
        try:
            return os.stat(self.path).st_ino != self._inode
        except OSError:
            return True

    @property
    def newest_cycle(self) -> int:
        """Sequence number of the newest cycle that can be read, 0 before the first one."""
        newest = self._word(Word.NEWEST_CYCLE)
        return newest if self._is_complete else max(0, newest - 1)

    @property
    def newest_frame(self) -> int:
        """Sequence number of the newest CAN frame that can be read."""
        return self._word(Word.NEWEST_FRAME if self._is_complete else Word.FRAMES_BEFORE)

    @property
    def _is_complete(self) -> bool:
        """The newest record is whole when its number says so."""
        if self._in_order or self.ended:
            return True
        newest = self._word(Word.NEWEST_CYCLE)
        place = self.layout.cycles_offset + newest % self.layout.cycles * self._cycle.size
        time_ns: int = self._cycle.unpack_from(self._map, place)[1]
        return not 0 <= MACHINE_CLOCK() - time_ns < _SETTLED_NS

    @property
    def peer(self) -> str:
        """The present or last PLC."""
        return bytes(self._view[PEER_OFFSET : PEER_OFFSET + PEER_SIZE]).rstrip(b"\0").decode(errors="replace")

    def wall_ns(self, time_ns: int) -> int:
        """A time of a record as nanoseconds since 1970, by the wall clock as it is set now."""
        offset = self._word(Word.WALL_OFFSET)
        return time_ns + (offset - 2 * _SIGN if offset & _SIGN else offset)

    def reason(self, code: int) -> str:
        """The name of a reason, empty for none."""
        return self._reasons[code] if code < len(self._reasons) else f"reason {code}"

    # -- the records ------------------------------------------------------------------------------------------------------

    def cycles(self, after: int = 0, at_most: int | None = None, upto: int | None = None) -> list[Cycle]:
        """The cycles after sequence number ``after``, oldest first; ``at_most``: only the newest; ``upto``: the last one."""
        layout = self.layout
        newest = self.newest_cycle
        first = self._first(newest, layout.cycles, after, at_most)
        last = newest if upto is None else min(newest, upto)
        word = Word.NEWEST_CYCLE
        return self._copied(layout.cycles_offset, layout.cycles, self._cycle.size, first, last, self._cycle_at, word)

    def frames(self, after: int = 0, at_most: int | None = None) -> list[Frame]:
        """The CAN frames after sequence number ``after``, oldest first; ``at_most``: number of newest ones."""
        layout = self.layout
        newest = self.newest_frame
        first = self._first(newest, layout.frames, after, at_most)
        return self._copied(
            layout.frames_offset, layout.frames, FRAME.size, first, newest, _frame_at, Word.NEWEST_FRAME
        )

    @staticmethod
    def _first(newest: int, count: int, after: int, at_most: int | None) -> int:
        first = max(after + 1, newest - count + 1, 1)
        return first if at_most is None else max(first, newest - at_most + 1)

    def _copied(
        self, start: int, count: int, size: int, first: int, newest: int, parse: Callable[[bytes, int], T], word: Word
    ) -> list[T]:
        found: list[T] = []
        number = SEQUENCE.unpack_from
        sequence, oldest = first, 0
        fence = None if self._in_order else Fence()
        if fence is not None:
            fence()
        while sequence <= newest:
            place = sequence % count
            together = min(_AT_ONCE, count - place, newest - sequence + 1)
            begin = start + place * size
            copy = bytes(self._view[begin : begin + together * size])
            if fence is not None:
                fence()
                oldest = self._word(word) - count + max(2, count >> _RESERVE)
            for item in range(together):
                offset = item * size
                # The number is 0 while the record is written. The same number before and after the copy means an intact
                # copy.
                whole = number(copy, offset)[0] == sequence == number(self._map, begin + offset)[0]
                if whole and sequence >= oldest:
                    found.append(parse(copy, offset))
                sequence += 1
        return found

    def _cycle_at(self, copy: bytes, offset: int) -> Cycle:
        fields = self._cycle.unpack_from(copy, offset)
        sequence, time_ns, flags, received, sent, response_us = fields[:HEAD_FIELDS]
        values = fields[HEAD_FIELDS + 2 :]
        return Cycle(
            sequence,
            time_ns,
            flags,
            response_us if flags & CycleFlag.ANSWERED and flags & CycleFlag.FRESH else None,
            fields[HEAD_FIELDS][:received],
            fields[HEAD_FIELDS + 1][:sent],
            tuple(
                ObjectSample(*values[place : place + OBJECT_FIELDS]) for place in range(0, len(values), OBJECT_FIELDS)
            ),
        )

    # -- the telegrams --------------------------------------------------------------------------------------------------

    def setpoints(self, cycle: Cycle, number: int) -> Sequence[int] | None:
        """Raw setpoints of drive object ``number`` (from 0) in telegram order, None while they are not valid."""
        offset = self.layout.places.setpoints[number]
        if offset is None or not cycle.objects[number].flags & ObjectFlag.SETPOINTS:
            return None
        return _unpacked(self._telegrams[number].setpoints.struct.unpack_from, cycle.received, offset)

    def actuals(self, cycle: Cycle, number: int) -> Sequence[int] | None:
        """Raw actual values likewise, None before the PLC was sent any."""
        offset = self.layout.places.actuals[number]
        if offset is None:
            return None
        return _unpacked(self._telegrams[number].actuals.struct.unpack_from, cycle.sent, offset)


def _unpacked(unpack_from: Callable[[bytes, int], tuple[int, ...]], data: bytes, offset: int) -> Sequence[int] | None:
    return unpack_from(data, offset) if data else None


def _frame_at(copy: bytes, offset: int) -> Frame:
    sequence, time_ns, identifier, bus, sent, length, _, data = FRAME.unpack_from(copy, offset)
    return Frame(sequence, time_ns, identifier, bus, bool(sent), data[:length])
