"""Homing (6060h = 6): method and speeds by SDO, the mode, the start, and how it ends.

Source: docs/translation.md "Positioning, telegram 9 (MDI)" Homing; the manufacturer's guide 6.7. Which stage it is in and when it
may begin is the positioning executor's.
"""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import MS
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import HOMING_METHOD, HOMING_SPEEDS
from pdgw.dsp402.states import StatusBit
from pdgw.gateway.axis.executors.executor import Executor
from pdgw.gateway.axis.executors.positions.mode import ModeSwitch
from pdgw.gateway.axis.values import SdoWrite
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.requests import HomingResult
from pdgw.gateway.motion.travel import Stall

_START_NS: Final = 50 * MS
"""The start and the answer to it also have to reach their ends."""
_SAME_METHOD = {35: 37, 37: 35}
"""Current position (CiA 402)."""
_SPEEDS = (1, 2)
"""Sub-indices of 6099h: to the switch, to the zero."""
_ATTAINED, _REACHED = StatusBit.MODE_12, StatusBit.TARGET_REACHED
_ENDED = _ATTAINED | _REACHED
_METHOD: Final = warning_bits(FaultNumber.HOMING_METHOD)
_REFUSED: Final = warning_bits(FaultNumber.HOMING_PARAMETERS)
TASK_WARNINGS: Final = warning_bits(
    FaultNumber.HOMING_METHOD,
    FaultNumber.HOMING_PARAMETERS,
    FaultNumber.HOMING,
    FaultNumber.POSITIONER,
    FaultNumber.NOT_ACKNOWLEDGED,
)
"""Warnings of one task: the next one ends them."""


class Homing:
    """Homing on the drive, for successive homings."""

    def __init__(self, executor: Executor, mode: ModeSwitch) -> None:
        self._executor = executor
        self._outputs = executor.outputs
        self._mode = mode
        self.method = 0
        """6098h as the drive has it."""
        self.methods: frozenset[int] = frozenset()
        """Those the drive offers."""
        self._writes: tuple[SdoWrite, ...] = ()
        self._busy = False
        self._answer: str | None = None
        """State of the writes: None: not requested, empty: running, "done", or the error."""
        self._started = 0
        """When the drive could start, monotonic ns."""
        self._latency = executor.settings.latency_ns + _START_NS
        """From the start until its answer: the bits of an earlier homing."""
        self._turned_ended = False
        """The axis turned while the drive showed that the homing has ended: its bits may be stuck."""
        self._attained = 0
        """Cycles since the drive said that it has its zero."""
        self._attained_at = 0
        """When it said so first."""
        self._stall = Stall(executor.settings.stall_ns)

    def require_method(self, method: int | None) -> bool:
        """Whether the method exists. One that does not, or None, starts nothing and raises the warning."""
        outputs = self._outputs
        outputs.end_warnings(TASK_WARNINGS)
        if method is not None and self._offered(method) in self.methods:
            return True
        outputs.reason = Reason.HOMING_METHOD
        allowed = (
            ", ".join(str(number) for number in sorted(self.methods)) or "none: the drive has no homing (6502h, 60E3h)"
        )
        asked = "homing_method is not configured" if method is None else f"homing method {method}"
        outputs.warn(FaultNumber.HOMING_METHOD, f"{asked}, allowed {allowed}")
        return False

    def _offered(self, method: int) -> int:
        """35 is the older number of 37: the one the drive has."""
        return _SAME_METHOD.get(method, method) if method not in self.methods else method

    @property
    def failure(self) -> Reason:
        """Reason of a failed homing: a method that the drive does not have or rejects, else a homing error of the drive."""
        warned = self._outputs.warned
        if warned & _METHOD:
            return Reason.HOMING_METHOD
        return Reason.HOMING_REFUSED if warned & _REFUSED else Reason.HOMING_ERROR

    def begin(self, method: int, speed: int | None) -> None:
        """Method and speeds have to reach the drive first; ``speed`` in its units, None leaves its own ones."""
        self._outputs.reason = Reason.HOMING_SETUP
        speeds = () if speed is None else _SPEEDS
        self._writes = (
            SdoWrite(*HOMING_METHOD, self._offered(method)),
            *(SdoWrite(HOMING_SPEEDS, subindex, speed or 1) for subindex in speeds),
        )
        self._answer = None
        self._ask()

    def _ask(self) -> None:
        """Wait for the answer to the writes of an aborted homing, which would count as the answer to the new one."""
        if not self._busy:
            self._busy = True
            self._answer = ""
            self._outputs.writes = self._writes

    def answered(self, error: str | None) -> None:
        """The writes were taken (None) or not (the reason)."""
        self._busy = False
        if self._answer == "":
            self._answer = "done" if error is None else error

    def abandon(self) -> None:
        """An answer that still comes is to nothing."""
        self._answer = None
        self._writes = ()
        self._attained = 0
        self._stall.step(False, 0, 0)

    def prepare(self) -> HomingResult:
        """READY when the drive has accepted method and speeds and confirmed mode 6, RUNNING until then."""
        outputs = self._outputs
        if self._answer is None:
            self._ask()
        if not self._answer:
            outputs.reason = Reason.HOMING_SETUP
            return HomingResult.RUNNING
        if self._answer != "done":
            outputs.warn(FaultNumber.HOMING_PARAMETERS, self._answer)
            outputs.reason = self.failure
            return HomingResult.FAILED
        self.method = self._writes[0].value
        if not self._mode.request(Mode.HOMING):
            return HomingResult.RUNNING
        self._started = self._executor.inputs.now
        self._turned_ended = False
        return HomingResult.READY

    def end(self, cycles: int) -> HomingResult:
        """As ``run``, but ATTAINED only when the position counts from the new zero: ``cycles`` after the drive says so."""
        progress, inputs = self.run(), self._executor.inputs
        if progress is not HomingResult.ATTAINED:
            return progress
        self._attained += 1
        if self._attained == 1:
            self._attained_at = inputs.now
        follows = self._attained > cycles and inputs.position_follows(self._attained_at)
        return progress if follows else HomingResult.RUNNING

    def run(self) -> HomingResult:
        """While the drive homes.

        It ends at standstill, and not by bits that can be older than the start or that were set while the axis turned.
        """
        inputs, feedback = self._executor.inputs, self._executor.feedback
        statusword = feedback.statusword
        ended = statusword & _ENDED == _ENDED
        if not ended:
            self._turned_ended = False
        elif not inputs.standstill and not inputs.standstill_unknown:
            self._turned_ended = True
        if inputs.now - self._started < self._latency:
            return HomingResult.RUNNING
        if statusword & StatusBit.MODE_13:
            return self._failed("homing error", statusword)
        if ended and inputs.standstill and not self._turned_ended:
            return HomingResult.ATTAINED
        if self._stall.step(inputs.standstill, feedback.position_actual, inputs.now):
            if ended:
                return self._failed("standstill, but Statusword.10 and .12 were set while the axis turned", statusword)
            if statusword & _ENDED:
                missing = "10" if statusword & _ATTAINED else "12"
                return self._failed(f"standstill without Statusword.{missing}", statusword)
            self._outputs.reason = Reason.HOMING_STALLED
        return HomingResult.RUNNING

    def _failed(self, what: str, statusword: int) -> HomingResult:
        outputs = self._outputs
        outputs.warn(FaultNumber.HOMING, f"method {self.method}, {what}, Statusword {statusword:04X}h")
        outputs.reason = Reason.HOMING_ERROR
        return HomingResult.FAILED
