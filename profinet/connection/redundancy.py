"""System redundancy S2: which of two relationships with one device leads; sans-I/O.

Source: IEC 61158-6-10 (APDU-Status, SRInfoBlock, ARUUID of IOCARSR) as tshark reads it. The standard's state machine is not
public. This one follows the edges of DataStatus.State, as a public device stack does: the relationship whose controller
requested the primary role last leads, until it withdraws the request. A controller that still requests it is informed that it
does not lead. If no relationship leads for longer than the redundancy data hold time, or both controllers request the role for
this time, both relationships end. Not here: R1 and R2 (two interfaces), more than one set of relationships.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, TypeVar

from pdgw.profidrive.frame import STATUS_PRIMARY

STATUS_REDUNDANCY = 0x02
"""DataStatus.Redundancy of input data: no relationship leads, or another one than this that asks."""

Member = TypeVar("Member", bound=Hashable)


class ArSet(Generic[Member]):
    """Up to two relationships. ``hold_ns``: the redundancy data hold time. Times are monotonic nanoseconds."""

    def __init__(self) -> None:
        self.members: list[Member] = []
        self.primary: Member | None = None
        """The one that leads."""
        self.hold_ns = 0
        self._asks: dict[Member, bool] = {}
        self._missing_since: int | None = None
        """Time since which no relationship leads, after one did."""
        self._disputed_since: int | None = None
        self._disputed = False
        """The dispute has outlasted the hold time."""

    def join(self, member: Member, hold_ns: int) -> None:
        """A relationship is granted; it is backup until it asks."""
        self.members.append(member)
        self.hold_ns = hold_ns
        self._asks[member] = False

    def leave(self, member: Member, now: int) -> None:
        """A relationship has ended."""
        self.members.remove(member)
        del self._asks[member]
        self._disputed_since = None
        if self.primary is member:
            self._lose(now)
        if not self.members:
            self._missing_since = None
            self._disputed = False

    def _lose(self, now: int) -> None:
        self.primary = None
        self._missing_since = now

    def ask(self, member: Member, now: int, *, primary: bool) -> bool:
        """A frame with valid output data, and its DataStatus.State; True when another member leads from now on, or none."""
        before = self._asks[member]
        self._asks[member] = primary
        if primary and not before:
            changed = self.primary is not member
            self.primary, self._missing_since, self._disputed_since = member, None, None
            return changed
        if not primary:
            self._disputed_since = None
            if self.primary is member:
                self._lose(now)
                return True
        elif self.primary is not None and self.primary is not member:
            if self._disputed_since is None:
                self._disputed_since = now
            self._disputed |= now - self._disputed_since >= self.hold_ns
        return False

    @property
    def deadline(self) -> int | None:
        """When the hold time is over."""
        if self._disputed:
            return 0
        return None if self._missing_since is None or not self.members else self._missing_since + self.hold_ns

    def status(self, member: Member) -> int:
        """State and Redundancy of the DataStatus of a member's input data."""
        if member is self.primary:
            return STATUS_PRIMARY
        if self._asks[member]:
            return STATUS_PRIMARY | STATUS_REDUNDANCY
        return STATUS_REDUNDANCY if self.primary is None else 0
