"""Detects an object that a drive accepts in a TPDO's mapping but does not send: its place in the PDO never changes.

Sans-I/O: inputs are the newest bytes of each TPDO and the value of the object (by SDO). An object whose bytes have changed
once is trusted permanently. Source: none; CiA 301 does not cover this.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import Pdo

MOTION = frozenset({"position_actual", "velocity_actual"})
"""Image attributes of what changes as soon as a drive moves."""
CONTRADICTIONS = 3
"""So often in a row has an object to hold another value than a newer frame of its PDO shows."""


@dataclass(slots=True, eq=False)
class UnconfirmedValue:
    """An object whose place in a PDO has not changed yet."""

    pdo: Pdo
    entry: Entry
    begin: int
    """Position in the PDO: first byte."""
    first: bytes = b""
    seen: int = -1
    """When its newest frame came."""
    compared: int = -1
    contradictions: int = 0

    def place(self, data: bytes) -> bytes:
        return data[self.begin : self.begin + self.entry.type.bits // 8]


class PdoValueCheck:
    """The check of one drive, from one start to the next, for the objects of ``MOTION``."""

    def __init__(self, pdos: Iterable[Pdo]) -> None:
        self._unconfirmed: list[UnconfirmedValue] = []
        for pdo in pdos:
            begin = 0
            for entry in pdo.entries:
                if entry.attribute in MOTION:
                    self._unconfirmed.append(UnconfirmedValue(pdo, entry, begin))
                begin += entry.type.bits // 8

    def see(self, pdo: Pdo, data: bytes, time: int) -> None:
        """The newest frame of a TPDO: its bytes, and when it came."""
        kept = []
        for suspect in self._unconfirmed:
            if suspect.pdo is pdo:
                place = suspect.place(data)
                suspect.first = suspect.first or place
                if place != suspect.first:
                    continue
                suspect.seen = time
            kept.append(suspect)
        self._unconfirmed = kept

    @property
    def has_unconfirmed(self) -> bool:
        """There are objects whose place has not changed yet."""
        return bool(self._unconfirmed)

    @property
    def unconfirmed(self) -> Iterator[UnconfirmedValue]:
        """Objects to read; without those that were in no frame yet."""
        return (suspect for suspect in tuple(self._unconfirmed) if suspect.first)

    def trust(self, suspect: UnconfirmedValue) -> None:
        """Stop checking the object, which cannot be read."""
        self._unconfirmed.remove(suspect)

    @property
    def contradicted(self) -> bool:
        """An object had another value at its last reading."""
        return any(suspect.contradictions for suspect in self._unconfirmed)

    def compare(self, suspect: UnconfirmedValue, held: bytes, now: int) -> bool:
        """What the object holds; True when its place in the PDO has contradicted that often enough.

        Without a frame since the last time nothing is learned: frames may be late or lost.
        """
        if suspect.seen > suspect.compared:
            suspect.contradictions = suspect.contradictions + 1 if held != suspect.first else 0
            suspect.compared = now
        return suspect.contradictions >= CONTRADICTIONS
