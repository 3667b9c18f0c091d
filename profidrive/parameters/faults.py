"""The fault buffer: P944 (counter), P945, P947, P948, P949, P952, pure.

Source: PROFIdrive profile 4.1 chapter 6.3.8 (docs/parameter-channel.md): 8 fault situations of 8 faults; subindex n*8 ..
n*8+7. Situation 0 contains unacknowledged faults; an acknowledge moves them to situation 1 and shifts the older situations.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

from pdgw.profidrive.errors import ProfidriveError

SITUATIONS = 8
FAULTS_PER_SITUATION = 8
SIZE = SITUATIONS * FAULTS_PER_SITUATION


@dataclass(frozen=True, slots=True)
class Fault:
    """One entry. ``time_ms`` is milliseconds since the start of the gateway."""

    number: int
    """P947."""
    code: int
    """P945."""
    value: int
    """P949."""
    time_ms: int
    """P948."""


class FaultBuffer:
    """The buffer of one DO. Not thread-safe: its owner serialises."""

    def __init__(self) -> None:
        self._situations: list[list[Fault]] = [[] for _ in range(SITUATIONS)]
        self.counter = 0
        """P944: counts every change of the buffer, modulo 65536."""

    def enter(self, fault: Fault, places: int = FAULTS_PER_SITUATION) -> None:
        """A fault takes the next free place among the first ``places`` of situation 0; one that finds none is counted."""
        if len(self._situations[0]) < places:
            self._situations[0].append(fault)
        self._changed()

    def acknowledge(self, once: Container[int] = ()) -> None:
        """The faults are cleared and acknowledged: situation 0 becomes 1. Nothing to acknowledge changes nothing.

        ``once``: numbers of faults that push no other one out. If situation 1 has the same ones of these, it is replaced.
        """
        present, last, *older = self._situations
        if not present:
            return
        numbers = [fault.number for fault in present]
        again = numbers == [fault.number for fault in last] and all(number in once for number in numbers)
        self._situations = [[], present, *older] if again else [[], present, last, *older[:-1]]
        self._changed()

    def clear(self, present: Sequence[Fault] = ()) -> None:
        """P952 := 0 empties the buffer, except for the faults whose cause is ``present``: they are situation 0."""
        left = [list(present), *([] for _ in range(SITUATIONS - 1))]
        if left != self._situations:
            self._situations = left
            self._changed()

    @property
    def situations(self) -> int:
        """P952: how many situations hold a fault."""
        return sum(1 for situation in self._situations if situation)

    def entry(self, subindex: int) -> Fault | None:
        """The fault at a subindex 0..63, None where the place is empty; ProfidriveError for other subindices."""
        if not 0 <= subindex < SIZE:
            raise ProfidriveError("subindex of the fault buffer", subindex, f"0..{SIZE - 1}")
        situation, place = divmod(subindex, FAULTS_PER_SITUATION)
        faults = self._situations[situation]
        return faults[place] if place < len(faults) else None

    def _changed(self) -> None:
        self.counter = (self.counter + 1) & 0xFFFF
