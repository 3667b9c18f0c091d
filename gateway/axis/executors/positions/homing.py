"""Homing (6060h = 6): method and speeds by SDO, the mode, the start, and how it ends.

Source: docs/translation.md "Positioning, telegram 9 (MDI)" Homing; the manufacturer's guide 6.7. Which stage it is in and when it
may begin is the positioning executor's.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from typing import Final

from pdgw.dsp402.indices import HOMING_SPEEDS
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import HOMING_METHOD
from pdgw.dsp402.states import StatusBit
from pdgw.durations import MS, SECOND
from pdgw.gateway.axis.executors.base import Executor
from pdgw.gateway.axis.executors.positions.mode import ModeSwitch
from pdgw.gateway.axis.values import SdoWrite
from pdgw.gateway.reasons import FaultNumber, Reason

HOMING_STALE_NS: Final = 50 * MS
"""A "homing attained" that was already there at the start counts only after this time (method 35 is immediate), and that in which
the start and the answer to it reach their ends.
"""
HOMING_UNATTAINED_NS: Final = SECOND
"""After this time at standstill with "target reached" but without "homing attained", the drive has aborted the homing."""
_SAME_METHOD = {35: 37, 37: 35}
"""Current position (CiA 402)."""
_SPEEDS = (1, 2)
"""Sub-indices of 6099h: to the switch, to the zero."""
_FINISHED = StatusBit.MODE_12 | StatusBit.TARGET_REACHED
_ERROR = StatusBit.MODE_13


class Progress(enum.Enum):
    """Progress of a homing."""

    WAITS = "waits"
    READY = "ready to start"
    ATTAINED = "attained"
    FAILED = "failed"


class Homing:
    """Homing on the drive, for successive homings."""

    __slots__ = (
        "_answer",
        "_attained_seen_low",
        "_busy",
        "_executor",
        "_idle_since",
        "_mode",
        "_outputs",
        "_since",
        "_stale_ns",
        "_writes",
        "method",
        "methods",
    )

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
        self._stale_ns = HOMING_STALE_NS + executor.settings.reaction_ns
        self._since = 0
        self._idle_since = -1
        self._attained_seen_low = False

    @property
    def INSTANTS(self) -> Mapping[str, int]:  # noqa: N802 (as in classes with the same ages for every axis)
        """See ``gateway.axis.checkpoint``."""
        return {"_since": self._stale_ns, "_idle_since": HOMING_UNATTAINED_NS}

    def supported(self, method: int | None) -> bool:
        """Whether the method exists; one that does not, or None, starts nothing and raises the warning."""
        outputs = self._outputs
        if method is not None and self._offered(method) in self.methods:
            outputs.warned = False
            return True
        outputs.warned = True
        outputs.reason = Reason.HOMING_METHOD
        allowed = (
            ", ".join(str(number) for number in sorted(self.methods)) or "none: the drive has no homing (6502h, 60E3h)"
        )
        outputs.found.append((FaultNumber.HOMING_METHOD, f"homing method {method}, allowed {allowed}"))
        return False

    def _offered(self, method: int) -> int:
        """35 is the older number of 37: the one the drive has."""
        return _SAME_METHOD.get(method, method) if method not in self.methods else method

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
        self._since = 0
        self._idle_since = -1
        self._attained_seen_low = False

    def prepare(self) -> Progress:
        """READY when the drive has accepted method and speeds and confirmed mode 6."""
        outputs = self._outputs
        if self._answer is None:
            self._ask()
        if not self._answer:
            outputs.reason = Reason.HOMING_SETUP
            return Progress.WAITS
        if self._answer != "done":
            outputs.found.append((FaultNumber.HOMING_PARAMETERS, self._answer))
            outputs.warned = True
            outputs.reason = Reason.HOMING_ERROR
            return Progress.FAILED
        self.method = self._writes[0].value
        if not self._mode.confirmed(Mode.HOMING):
            return Progress.WAITS
        self._since = self._executor.inputs.now
        return Progress.READY

    def run(self) -> Progress:
        """While the drive homes."""
        inputs, statusword = self._executor.inputs, self._executor.feedback.statusword
        error = statusword & _ERROR != 0
        if statusword & _FINISHED != _FINISHED and not error:
            self._attained_seen_low = True
            if not inputs.standstill or not statusword & StatusBit.TARGET_REACHED:
                self._idle_since = -1
            elif self._idle_since < 0:
                self._idle_since = inputs.now
            elif inputs.now - self._idle_since >= HOMING_UNATTAINED_NS:
                return self._failed("standstill without homing attained", statusword)
        elif self._attained_seen_low or inputs.now - self._since >= self._stale_ns:
            if error:
                return self._failed("homing error", statusword)
            return Progress.ATTAINED
        return Progress.WAITS

    def _failed(self, what: str, statusword: int) -> Progress:
        outputs = self._outputs
        outputs.warned = True
        outputs.found.append((FaultNumber.HOMING, f"method {self.method}, {what}, Statusword {statusword:04X}h"))
        outputs.reason = Reason.HOMING_ERROR
        return Progress.FAILED
