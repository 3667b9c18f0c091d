"""Mode of operation (6060h): requested only without Halt, used when the drive confirms it (6061h)."""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import SECOND
from pdgw.dsp402.modes import MODE_CONFIRM_NS
from pdgw.gateway.axis.answer import Answer
from pdgw.gateway.axis.executors.executor import Executor
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason

_NOT_CONFIRMED: Final = warning_bits(FaultNumber.MODE_NOT_CONFIRMED)


class ModeSwitch:
    """The requested mode, and the drive's answer to the request."""

    def __init__(self, executor: Executor, base: int) -> None:
        self._executor = executor
        self.base = base
        """The mode of tasks, to which everything else returns."""
        self.mode = base
        self._answer = Answer(executor.settings.latency_ns)
        """6061h shows the mode, in answer to the last change of 6060h."""
        self.halted = False
        """Halt is set: the mode must not change."""
        self.asked = False
        """A mode was requested in this cycle."""
        self.since = -1
        """Start of the request that the drive has not confirmed, monotonic ns; -1: none."""

    def rebase(self, base: int) -> None:
        """Another mode of tasks, of another drive."""
        if self.mode == self.base:
            self.mode = base
        self.base = base

    def abandon(self) -> None:
        """Back to the base mode; nothing is waited for."""
        self.cease()
        if not self.halted and self.mode != self.base:
            self._change(self.base)

    def cease(self) -> None:
        """No mode is waited for."""
        self.since = -1
        self._executor.outputs.end_warnings(_NOT_CONFIRMED)

    def shows_base(self) -> bool:
        """The drive is in the mode of tasks."""
        return self._executor.feedback.modes_of_operation_display == self.base

    def _change(self, mode: int) -> None:
        self.mode = mode
        self._answer.command(self._executor.inputs.now, level=True)

    def read(self) -> bool:
        """Take 6061h once per cycle. True if it confirms the mode."""
        executor = self._executor
        return self._answer.read(executor.feedback.modes_of_operation_display == self.mode, executor.inputs.now)

    def request(self, mode: int) -> bool:
        """Request a mode (never while Halt is set), and return whether 6061h confirms it."""
        executor = self._executor
        self.asked = True
        now = executor.inputs.now
        if self.mode != mode and not self.halted:
            self._change(mode)
            self.since = now
        if self.mode == mode and self._answer.given and not self.halted:
            self.cease()
            return True
        outputs = executor.outputs
        outputs.reason = Reason.MODE_NOT_CONFIRMED
        if self.since < 0:
            self.since = now
        elif now - self.since >= MODE_CONFIRM_NS:
            shown = executor.feedback.modes_of_operation_display
            detail = f"6060h = {mode}, 6061h = {shown} for {MODE_CONFIRM_NS / SECOND:g} s"
            outputs.warn(FaultNumber.MODE_NOT_CONFIRMED, detail)
            outputs.reason = Reason.MODE_KEPT
        return False
