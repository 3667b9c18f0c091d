"""Whether a torque limit explains that a drive does not follow an order: then the time of the order does not count.

A limit alone proves nothing: the drive must show it, and must show that it has received the setpoint. Source: docs/safety.md.
"""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import SECOND
from pdgw.dsp402.drive.images import DEMAND_UNKNOWN
from pdgw.dsp402.states import StatusBit
from pdgw.gateway.axis.values import Inputs, Outputs
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits

_AT_LIMIT: Final = 20
"""Divisor of the torque limit: within this part, the torque is at its limit."""
_WARNED: Final = warning_bits(FaultNumber.INTERNAL_LIMIT)


class TorqueEvidence:
    """One axis, for the checks of its speed."""

    def __init__(self, inputs: Inputs, outputs: Outputs) -> None:
        self._inputs = inputs
        self._outputs = outputs
        self._excused_at = -SECOND
        """When it explained a speed last."""
        self.warning = 0
        """The bit of P953 while a limit explains a speed; ``step`` ends it."""

    def spares(self, low: int, high: int, elapsed: int) -> int:
        """Nanoseconds of ``elapsed`` that do not count.

        None; the half where the drive only shows a limit; all if its demand value (606Bh) is between ``low`` and ``high`` too.
        """
        inputs, outputs = self._inputs, self._outputs
        feedback, limit = inputs.feedback, outputs.command.max_torque
        at_limit = limit > 0 and abs(feedback.current_actual) * _AT_LIMIT >= limit * (_AT_LIMIT - 1)
        if not at_limit and not feedback.statusword & StatusBit.INTERNAL_LIMIT:
            return 0
        demand = feedback.velocity_demand
        if demand == DEMAND_UNKNOWN or not low <= demand <= high:
            return elapsed // 2
        return elapsed

    def excuse(self) -> None:
        """Without the limit, the drive would be late in this step."""
        inputs, feedback = self._inputs, self._inputs.feedback
        if inputs.now - self._excused_at >= SECOND:
            detail = f"606Ch is {feedback.velocity_actual}, its demand value (606Bh) {feedback.velocity_demand}: torque limit"
            self._outputs.found.append((FaultNumber.INTERNAL_LIMIT, detail))
        self._excused_at, self.warning = inputs.now, _WARNED

    def step(self) -> None:
        """End the warning when the speed was explained a second ago."""
        if self.warning and self._inputs.now - self._excused_at >= SECOND:
            self.warning = 0
