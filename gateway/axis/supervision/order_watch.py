"""Whether the drive follows its orders in time: which order is in force, and what happens if the drive does not follow it.

Times and rules are those of ``stop_supervision``. Source: docs/safety.md.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.dsp402.drive_type import Quantity, Scaling
from pdgw.dsp402.states import STATE_OF_STATUS, ControlBit
from pdgw.gateway.axis.demand_report import STATE_MASK
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.orders import Brake, Order
from pdgw.gateway.axis.power_states import Phase
from pdgw.gateway.axis.settings import AxisSettings, LastStop
from pdgw.gateway.axis.supervision.stop_supervision import QUICK_STOPS, StopWatch
from pdgw.gateway.axis.supervision.torque_evidence import TorqueEvidence
from pdgw.gateway.axis.values import Inputs, Outputs
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits

_NO_ORDER, _ZERO, _HALT, _STANDSTILL = Order.NONE, Order.ZERO, Order.HALT, Order.STANDSTILL
_MOVES: Final = warning_bits(FaultNumber.MOVES_UNASKED)
_BRAKES: Final = {
    Brake.NONE: "the gateway commands Quick Stop",
    Brake.NMT_STOP: "the gateway has stopped the node (NMT)",
    Brake.WITHHOLD_HEARTBEAT: "the gateway withholds its heartbeat",
}


class OrderWatch:
    """The orders of one axis."""

    def __init__(
        self,
        settings: AxisSettings,
        interlock: Interlock,
        inputs: Inputs,
        outputs: Outputs,
        evidence: TorqueEvidence,
    ) -> None:
        self._interlock, self._inputs, self._outputs = interlock, inputs, outputs
        disables = settings.last_stop is LastStop.DISABLE_VOLTAGE
        self.stop = StopWatch(
            settings.reaction_ns, settings.stop_time_ns, settings.enter_ns, evidence, disables=disables
        )
        self.order: Order = _NO_ORDER
        """That of the setpoint or of Halt, in operation."""
        self._brakes = True
        """A setpoint came inside the standstill window, or operation began, and the shaft has not been at standstill since."""
        self.window = self._rest = 0
        """Standstill, and the highest speed that a setpoint inside it may leave: an inverter has a minimum speed."""
        self._per_rpm: Fraction | None = None
        """Velocity units of 1 rpm; None if unknown."""

    def set_drive(self, scaling: Scaling, window: int, counts_per_unit: float) -> None:
        """Set the drive's units. ``window``: of standstill; ``counts_per_unit``: as of ``StopWatch``."""
        self._per_rpm, self.window = scaling.velocity_per_rpm, window
        self.stop.set_drive(int(scaling.reference(Quantity.SPEED)), counts_per_unit, scaling.position_span)

    def begin(self) -> None:
        """An order of the power table is in force: the next operation begins with a new setpoint."""
        self._brakes, self.order = True, _NO_ORDER

    def read_setpoint(self, controlword: int, speeds: tuple[int, int] | None, slowest: int) -> None:
        """Find the order in operation: that of Halt, or of a speed setpoint inside the standstill window.

        ``speeds`` and ``slowest``: those of the executor.
        """
        self.order = _NO_ORDER
        if controlword & ControlBit.HALT:
            self.order = _STANDSTILL if self._outputs.warned & _MOVES else _HALT
            return
        velocity, before = self._inputs.feedback.velocity_actual, self._rest
        self._rest = rest = self.window + slowest + slowest // 2
        if speeds is None or speeds[0] != speeds[1] or not -rest <= speeds[0] <= rest or rest < before:
            self._brakes = True
        elif -rest <= velocity <= rest:
            self._brakes = False
        elif self._brakes:
            self.order = _ZERO

    def step(self, order: Order) -> FaultNumber | None:
        """The drive must leave the state that it shows, and must brake; after a stop it must not turn without power.

        Returns the fault of a drive that does not follow the order; it is reported.
        """
        inputs, outputs, stop = self._inputs, self._outputs, self.stop
        window = self._rest if order is _ZERO else self.window
        feedback, now = inputs.feedback, inputs.now
        velocity, position = feedback.velocity_actual, feedback.position_actual
        velocity_ns = inputs.speed_asked_ns or now
        fault: FaultNumber | None = None
        if order is Order.ENTER or (order and not outputs.known_off):
            state = STATE_OF_STATUS[feedback.statusword & STATE_MASK]
            fault = stop.step(
                order,
                state,
                inputs.drive_ok,
                inputs.node_stopped,
                velocity,
                velocity_ns,
                position,
                inputs.position_ns,
                window,
                now,
                standstill_unknown=inputs.standstill_unknown,
            )
            if fault is not None:
                self._report(order, fault)
            if stop.last and self._interlock.phase is not Phase.COAST:
                self._interlock.disable_voltage(now)
        elif stop.began >= 0:
            if not outputs.known_off or not inputs.drive_ok:
                stop.over()
            elif stop.coast(velocity, window, velocity_ns):
                outputs.found.append((FaultNumber.TURNS_OFF, f"speed {velocity}"))
        if stop.late and inputs.standstill:
            stop.late = False
        outputs.brake = stop.brake
        return fault

    def _report(self, order: Order, number: FaultNumber) -> None:
        """The drive does not follow an order: the next brake, and a fault."""
        if order in QUICK_STOPS:
            self._interlock.distrust(self._inputs.now)
        feedback, velocity = self._inputs.feedback, self._inputs.feedback.velocity_actual
        speed = f"{float(velocity / self._per_rpm):g} rpm" if self._per_rpm else f"speed {velocity}"
        after = f"{speed} after {(self._inputs.now - self.stop.began) / SECOND:.1f} s"
        words = f"Controlword {self._outputs.command.controlword:04X}h, Statusword {feedback.statusword:04X}h"
        brake = _BRAKES[self.stop.brake]
        if self.stop.last:
            brake = "the gateway commands Disable Voltage"
        detail = f"{after}, {brake} ({words})"
        if order is Order.ENTER:
            shown = f"Enable Operation, Statusword {feedback.statusword:04X}h"
            detail = f"{after} of {shown}"
        self._outputs.found.append((number, detail))
