"""The ring on a machine whose processors see stores in any order but across a fence: no record that is read is torn.

Modelled here: the writer has a file, the reader another one, to which the words of eight bytes come one by one, in any order.
"""

from __future__ import annotations

import mmap
import random
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from pdgw.gateway.trace.ordering import Fence
from pdgw.gateway.trace.reader import Cycle, Frame, RingReader
from pdgw.gateway.trace.writer import RingFile
from tests.support.readers.ring import LAYOUT, LIMIT, record

_NOW = 1_000_000
"""Records have their number as their time: each is new."""
_COMPARED = 64
"""Words at a time: few of them differ."""


class Machine:
    """A writer, and its stores that another processor has seen until now."""

    def __init__(self, directory: Path, seed: int) -> None:
        self.random = random.Random(seed)
        self._mapped: list[memoryview] = []
        self.ring = RingFile(directory, replace(LAYOUT, frames=64), LIMIT, fence=self.show_all)
        self.path = shutil.copy(self.ring.path, directory / "seen.ring")
        for path in (self.ring.path, self.path):
            with path.open("r+b") as file:
                self._mapped.append(memoryview(mmap.mmap(file.fileno(), 0)).cast("Q"))
        self.cycles = self.frames = 0

    def _show(self, share: float) -> None:
        stored, seen = self._mapped
        for first in range(0, len(stored), _COMPARED):
            if stored[first : first + _COMPARED] == seen[first : first + _COMPARED]:
                continue
            for word in range(first, min(first + _COMPARED, len(stored))):
                if stored[word] != seen[word] and self.random.random() < share:
                    seen[word] = stored[word]

    def show_all(self) -> None:
        """The fence of the writer."""
        if len(self._mapped) == 2:
            self._show(1)

    def goes_on(self) -> None:
        """Some records more, of which some is seen."""
        for _ in range(self.random.randrange(4)):
            self.cycles += 1
            self.ring.cycle(record(self.cycles))
            for _ in range(self.random.randrange(3)):
                self.frames += 1
                self.ring.frame(0, self.frames & 0x7FF, (self.frames % 256).to_bytes(1, "big") * 8, 0, self.frames)
                self._show(self.random.choice((0, 0.5, 0.9)))
            self._show(self.random.choice((0, 0.5, 0.9)))

    def close(self) -> None:
        self.ring.close()
        for item in self._mapped:
            item.release()


def _is_whole(cycle: Cycle) -> bool:
    number, (sample,) = cycle.sequence, cycle.objects
    return (
        (cycle.time_ns, cycle.response_us, sample.velocity, sample.position, sample.statusword, sample.controlword)
        == (number, number, number, -number, number, number)
        and cycle.received == number.to_bytes(12, "big")
        and cycle.sent == number.to_bytes(10, "big")
    )


def _is_sent(frame: Frame) -> bool:
    number = frame.sequence
    return (frame.time_ns, frame.identifier, frame.data) == (number, number & 0x7FF, bytes((number % 256,) * 8))


@contextmanager
def _machine(directory: Path, seed: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Machine]:
    machine = Machine(directory, seed)
    monkeypatch.setattr("pdgw.gateway.trace.reader.MACHINE_CLOCK", lambda: _NOW)
    # The writer works on while a reader copies.
    monkeypatch.setattr("pdgw.gateway.trace.reader.Fence", lambda: machine.goes_on)
    yield machine
    machine.close()


def _torn(machine: Machine, *, in_order: bool) -> tuple[int, int]:
    """How many records were read, and how many of them are not what was written."""
    read = torn = 0
    with RingReader(machine.path, in_order=in_order) as reader:
        for _ in range(300):
            machine.goes_on()
            cycles, frames = reader.cycles(), reader.frames()
            read += len(cycles) + len(frames)
            torn += sum(not _is_whole(cycle) for cycle in cycles) + sum(not _is_sent(frame) for frame in frames)
    return read, torn


@pytest.mark.parametrize("seed", range(3))
def test_no_record_is_torn_where_stores_are_seen_in_any_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    with _machine(tmp_path, seed, monkeypatch) as machine:
        read, torn = _torn(machine, in_order=False)
        assert torn == 0
        assert read > 5000, "and most are read"


def test_the_model_tears_records_for_a_reader_that_believes_their_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with _machine(tmp_path, 0, monkeypatch) as machine:
        assert _torn(machine, in_order=True)[1] > 0


def test_the_newest_record_is_read_when_the_next_one_is_there_or_nothing_more_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = _NOW
    monkeypatch.setattr("pdgw.gateway.trace.reader.MACHINE_CLOCK", lambda: now)
    ring = RingFile(tmp_path, LAYOUT, LIMIT, fence=Fence())
    with RingReader(ring.path, in_order=False) as reader:
        for number in (1, 2):
            ring.frame(0, 0x181, b"", 0, number)
            ring.cycle(record(number))
        ring.frame(0, 0x181, b"", 0, 3)
        assert (reader.newest_cycle, len(reader.cycles())) == (1, 1)
        assert (reader.newest_frame, len(reader.frames())) == (2, 2)
        now += 1_000_000_000
        assert (reader.newest_cycle, len(reader.frames())) == (2, 3), "a daemon that was killed"
        now = _NOW
        ring.close()
        assert (len(reader.cycles()), len(reader.frames())) == (2, 3), "one that ended"
