"""Mode of operation (6060h): requested only without Halt, used when the drive confirms it (6061h)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from pdgw.dsp402.modes import MODE_CONFIRM_NS
from pdgw.durations import SECOND
from pdgw.gateway.axis.executors.base import Executor
from pdgw.gateway.reasons import FaultNumber, Reason


class ModeSwitch:
    """The requested mode, and the time of the request."""

    INSTANTS: ClassVar[Mapping[str, int]] = {"since": MODE_CONFIRM_NS}
    PASSING: ClassVar[frozenset[str]] = frozenset({"asked"})

    __slots__ = ("_executor", "asked", "base", "halted", "mode", "since")

    def __init__(self, executor: Executor, base: int) -> None:
        self._executor = executor
        self.base = base
        """The mode of tasks, to which everything else returns."""
        self.mode = base
        self.halted = False
        """Halt is set: the mode must not change."""
        self.asked = False
        """A mode was requested in this cycle."""
        self.since = -1
        """Start of the request that the drive has not confirmed, monotonic ns; -1: none. A cycle without a request ends it, and
        one with a warning starts it again."""

    def rebase(self, base: int) -> None:
        """Another mode of tasks, of another drive."""
        if self.mode == self.base:
            self.mode = base
        self.base = base

    def abandon(self) -> None:
        """Back to the base mode; nothing is waited for."""
        self.since = -1
        if not self.halted:
            self.mode = self.base

    def shows_base(self) -> bool:
        """The drive is in the mode of tasks."""
        return self._executor.feedback.modes_of_operation_display == self.base

    def confirmed(self, mode: int) -> bool:
        """Request a mode (never while Halt is set) and return whether 6061h confirms it."""
        executor = self._executor
        self.asked = True
        shown, now = executor.feedback.modes_of_operation_display, executor.inputs.now
        if self.mode != mode and not self.halted:
            self.mode = mode
            self.since = now
        if self.mode == mode and shown == mode and not self.halted:
            self.since = -1
            return True
        outputs = executor.outputs
        outputs.reason = Reason.MODE_NOT_CONFIRMED
        if self.since < 0 or outputs.warned:
            self.since = now
        elif now - self.since >= MODE_CONFIRM_NS:
            outputs.warned = True
            outputs.found.append(
                (FaultNumber.MODE_NOT_CONFIRMED, f"6060h = {mode}, 6061h = {shown} for {MODE_CONFIRM_NS / SECOND:g} s")
            )
        return False
