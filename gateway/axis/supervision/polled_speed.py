"""What is known of the speed of a drive that has it in no TPDO: each value is as old as its request by SDO.

An old value is unknown: the shaft neither turns nor is at standstill by it. Source: docs/safety.md "Speed by SDO".
"""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import SECOND
from pdgw.ds301.node.polling import OLDEST_NS
from pdgw.dsp402.states import ControlBit
from pdgw.gateway.axis.demand_report import PowerWish
from pdgw.gateway.axis.orders import Order
from pdgw.gateway.axis.supervision.stop_supervision import RAMP_MARGIN
from pdgw.gateway.axis.values import Inputs, Outputs
from pdgw.gateway.base.fault_numbers import FaultNumber

ANSWERS: Final = 2
"""Number of answers in succession, requested after an order, that are a standstill."""
_ORDERS: Final = ControlBit.HALT | ControlBit.NEW_SETPOINT
"""Bits of the Controlword whose rise starts or stops a motion."""
_RAMP_OVER: Final[dict[PowerWish | None, PowerWish]] = {
    None: PowerWish.NO_PLC_QUICK_STOP,
    PowerWish.NO_PLC_RAMP: PowerWish.NO_PLC_QUICK_STOP,
    PowerWish.OFF_DISABLED: PowerWish.QUICK_STOP_DISABLED,
    PowerWish.OFF: PowerWish.QUICK_STOP,
    PowerWish.ENABLE: PowerWish.QUICK_STOP,
    PowerWish.HOLD: PowerWish.QUICK_STOP,
    PowerWish.STOP: PowerWish.QUICK_STOP,
}
"""The quick stop in the place of a request under which a ramp stop continues."""


class PolledSpeed:
    """One axis. Call ``step`` in each cycle. Times in nanoseconds, as those of ``StopWatch``."""

    def __init__(self, inputs: Inputs, outputs: Outputs, reaction_ns: int, stop_time_ns: int) -> None:
        self._inputs, self._outputs = inputs, outputs
        self._reaction = reaction_ns
        self._stopped_within = RAMP_MARGIN * stop_time_ns
        self._order: tuple[Order, int] = Order.NONE, 0
        self._word = 0
        self._ordered_at = 0
        self._asked = 0
        """Request of the newest answer."""
        self._still = 0
        """Number of answers inside the standstill window, in succession and requested after the order."""
        self._ramp_at = -1
        """When the present ramp stop began; -1 without one."""
        self._from, self._from_at = 0, 0
        """The speed that was known last in it, and when."""

    @property
    def is_old(self) -> bool:
        """The speed is unknown."""
        return self._inputs.now > self._inputs.speed_until_ns

    def step(self, order: Order, word: int, target: int, window: int) -> None:
        """One cycle: write to the inputs whether the axis is at standstill, and whether that is unknown.

        ``order`` of the power table, ``word`` (Controlword) and ``target`` (60FFh) are the last ones. ``window``: of standstill.
        """
        inputs = self._inputs
        given = order, (target > window) - (target < -window)
        # Power that goes at the end of a stop starts nothing: the shaft is at standstill by the answers to that stop.
        if (given != self._order and order is not Order.OFF) or word & ~self._word & _ORDERS:
            self._ordered_at, self._still = inputs.now, 0
        self._order, self._word = given, word
        slow = abs(inputs.feedback.velocity_actual) <= window
        if inputs.speed_asked_ns != self._asked:
            self._asked = asked = inputs.speed_asked_ns
            self._still = min(self._still + 1, ANSWERS) if slow and asked > self._ordered_at else 0
        inputs.standstill = self._still >= ANSWERS and not self.is_old
        inputs.standstill_unknown = not inputs.standstill and (slow or self.is_old)

    def ramps_blindly(self, reference: int, *, ramps: bool) -> bool:
        """Call after ``step``: whether a ramp stop has lasted as long as it may with an unknown standstill.

        ``reference``: 100 % speed. A ramp lasts as from the last known speed, but until late answers can have come, and at most
        as from 100 %.
        """
        inputs, now = self._inputs, self._inputs.now
        if not ramps:
            self._ramp_at = -1
            return False
        if self._ramp_at < 0:
            self._ramp_at, self._from, self._from_at = now, reference, now
        if not self.is_old:
            self._from, self._from_at = abs(inputs.feedback.velocity_actual), max(self._ramp_at, self._asked)
        lasts = self._stopped_within * self._from // max(1, reference)
        known = self._from_at + max(lasts, (ANSWERS + 1) * OLDEST_NS)
        end = min(known, self._ramp_at + self._stopped_within) + self._reaction
        return inputs.standstill_unknown and now > end

    def request(self, wish: PowerWish | None, reference: int, *, ramps: bool) -> PowerWish | None:
        """Call after ``step``: the request of the PLC ``wish``, or the quick stop that replaces it at the end of
        ``ramps_blindly``."""
        inputs = self._inputs
        if not self.ramps_blindly(reference, ramps=ramps) or wish not in _RAMP_OVER:
            return wish
        age = (inputs.now - inputs.speed_asked_ns) / SECOND
        detail = f"606Ch by SDO is {age:.1f} s old, and the ramp must have ended: the gateway commands Quick Stop"
        self._outputs.found.append((FaultNumber.STOP_IGNORED, detail))
        return _RAMP_OVER[wish]
