"""Detects that a drive does not do in time what is commanded, and selects the next brake.

``orders.ORDERS`` has the state that must end and the line under which the speed must be. Otherwise the drive gets Quick
Stop, or NMT stop if a stop is commanded already. If the node does not confirm that, the gateway's heartbeat is withheld, so that
the abort option 6007h of the drive stops it. A drive that becomes faster under Quick Stop, or that NMT stop has not stopped, gets
Disable Voltage. Source: docs/safety.md.
"""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.drive_type import POSITIONS
from pdgw.dsp402.states import State
from pdgw.gateway.axis.orders import ORDERS, Brake, Leave, Line, Order
from pdgw.gateway.axis.supervision.growth import STEPS, Growth
from pdgw.gateway.axis.supervision.position_speed import SAMPLE_NS, shortest
from pdgw.gateway.axis.supervision.torque_evidence import TorqueEvidence
from pdgw.gateway.base.fault_numbers import FaultNumber

RAMP_MARGIN: Final = 2
"""Factor on the stop time of the drive."""
QUICK_STOPS: Final = tuple(order for order, row in ORDERS.items() if order and not row.stops)
"""Orders with Quick Stop as their brake: it was not commanded yet."""
_MUST_END: Final = {
    Order.ENTER: (State.SWITCHED_ON,),
    Order.DISABLE: (State.OPERATION_ENABLED,),
    Order.STOP: (State.OPERATION_ENABLED,),
    Order.OFF: (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE),
    Order.OFF2: (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE),
}
"""States that must end in time."""
_SLOWER: Final = 0.95
"""A shaft that coasts loses this share of its speed in the time of a stop."""
_HALTED: Final = 10
"""Under Halt, an axis without a task must stay slower than 100 % speed divided by this."""
_OVER_NS: Final = 500 * MS
"""A speed above that for this time is not an overshoot."""
_JERK: Final = 7
"""A ramp without a linear part that takes twice the stop time has left the standstill window (1 %) after this part of the stop
time."""


class StopWatch:
    """One axis. Call ``step`` in each cycle with an order, and ``coast`` after it while the drive shows power off.

    Times in nanoseconds. ``reaction_ns``: in which a command has an effect. ``stop_time_ns``: from 100 % speed to standstill.
    ``enter_ns``: in which a brake opens or closes. ``disables``: Disable Voltage is the last stop.
    """

    def __init__(
        self, reaction_ns: int, stop_time_ns: int, enter_ns: int, evidence: TorqueEvidence, *, disables: bool
    ) -> None:
        self._reaction = reaction_ns
        self._stop_time = stop_time_ns
        self._enter = enter_ns
        self._evidence = evidence
        self._disables = disables
        self._stopped_within = reaction_ns + RAMP_MARGIN * stop_time_ns
        """Time in which a drive has stopped from 100 % speed, with margin."""
        self.set_drive(0, 0.0, POSITIONS)
        self.brake: Brake = Brake.NONE
        self.order: Order = Order.NONE
        """The order in force."""
        self.began = -1
        """When the stop was commanded first, or the speed of a drive without power fell last; -1 while no stop is watched."""
        self._speed = 0
        """The speed from which the drive brakes."""
        self._line_at = -1
        """When the first speed after the order was measured: ``began``, or when it was requested by SDO; -1: none has come."""
        self._at = self._spared = 0
        """When the last speed was measured; time of the present order that does not count."""
        self._fell = self._slow = -1
        """When the speed fell last under Halt, and when it was last below what Halt allows without a task."""
        self._growth = Growth(SAMPLE_NS)
        """Of the speed under Halt, and under Quick Stop."""
        self._stop_growth = Growth(reaction_ns // STEPS)
        self._leave: Leave = Leave.NONE
        self._ignored: State | None = None
        self._ignored_since = -1
        """Since when the drive shows this state, which must end; -1 while it does not."""
        self._still_since = -1
        """Since when the shaft is inside the standstill window and in this state; -1 while it is not,"""
        self._still_at: int | None = None
        """and at which position; None: none has come since."""
        self.waits = False
        """The drive is at standstill and has not left its state in the reaction time: its brake closes."""
        self._braked = 0
        """When the NMT stop was sent; -1: the node has reported NMT Stopped. The next bring-up ends this state."""
        self._nmt_tried = False
        """An NMT stop was of no use: the drive was not off when it was there again."""
        self.last = False
        """The last stop: the drive must get Disable Voltage."""
        self.late = False
        """The drive did not follow an order in time, and has not stopped since."""
        self.ignored_at = 0
        """When the first order was given that it did not follow; 0: it has followed."""

    def set_drive(self, reference: int, counts_per_unit: float, span: int) -> None:
        """Set 100 % speed in the drive's units, position units a second of one velocity unit (0: unknown), and the number of
        positions."""
        self.reference = reference
        self._counts_per_unit = counts_per_unit
        self._span = span

    def over(self) -> None:
        """The drive is off, or follows the PLC again."""
        self._restart()
        self._nmt_tried = self.last = self.late = False
        self.ignored_at = 0

    def _restart(self) -> None:
        self.order = Order.NONE
        self.began = self._line_at = self._fell = self._slow = -1
        self._speed = 0
        self.brake = Brake.NONE
        self._left()

    def _left(self) -> None:
        """No state has to end."""
        self._ignored_since = self._still_since = -1
        self._ignored, self._leave, self.waits = None, Leave.NONE, False

    def step(
        self,
        order: Order,
        state: State | None,
        seen: bool,
        node_stopped: bool,
        velocity: int,
        velocity_ns: int,
        position: int,
        position_ns: int,
        window: int,
        now: int,
        *,
        standstill_unknown: bool = False,
    ) -> FaultNumber | None:
        """One cycle of an order; the fault, once, if the drive does not follow it in time.

        ``state``: what the drive shows. ``seen``: its values are fresh. ``node_stopped``: its heartbeat reports Stopped.
        ``velocity``: actual speed at ``velocity_ns``, standstill within ``window``; an older one is compared with the line of its
        time. ``standstill_unknown``: it is too old, or too few have come. ``position`` came at ``position_ns``. Times are
        monotonic nanoseconds.
        """
        if order is not self.order:
            if order in QUICK_STOPS or self.order in QUICK_STOPS:
                self._restart()
            self.order = order
        speed, line = abs(velocity), ORDERS[order].line
        if self.brake is Brake.NMT_STOP and self._needs_more(order, seen, node_stopped, velocity, window, now):
            return FaultNumber.STOP_IGNORED
        if self.brake is not Brake.NONE or not seen:
            return None
        if self.began < 0:
            self.began = now
            self._speed = self.reference
        at = velocity_ns
        self._follow_line(order, speed, at)
        measured = self._line_at >= 0
        if measured and order is Order.ZERO:
            self._spared += self._evidence.spares(-window, window, at - self._at)
        self._at = at
        fault: FaultNumber | None = None
        slow = standstill_unknown or speed <= window
        if measured and self._grows(order, speed, window, at):
            fault = FaultNumber.VELOCITY
        elif self._stays(order, state, slow, position, position_ns, window, now) or (
            measured and self._turns(line, speed, window, at)
        ):
            fault = ORDERS[order].fault
        if fault is not None and self._spared and not self._turns(line, speed, window, at - self._spared):
            self._evidence.excuse()
            fault = None
        if fault is None:
            return None
        self.late = True
        self.ignored_at = self.ignored_at or self.began
        if order not in QUICK_STOPS:
            if fault is FaultNumber.VELOCITY and self._disables and not self.last:
                self.last = True  # a runaway has a broken loop, which NMT stop does not open
                self._left()
            else:
                self.brake = Brake.WITHHOLD_HEARTBEAT if self._nmt_tried else Brake.NMT_STOP
                self._braked = now
            return FaultNumber.STOP_IGNORED
        return fault

    def _needs_more(self, order: Order, seen: bool, node_stopped: bool, velocity: int, window: int, now: int) -> bool:
        """One cycle after an NMT stop: whether the drive is there again and needs the last stop."""
        if node_stopped:
            self._braked = -1
        elif self._braked >= 0:
            if now - self._braked >= self._reaction:
                self.brake = Brake.WITHHOLD_HEARTBEAT
        elif seen:
            # Its heartbeat consumer needs a heartbeat before it can miss one: Disable Voltage has its own time.
            self.last = self.late = self.needs_last_stop(velocity, window, now)
            self._restart()
            self.order = order
            self._nmt_tried = True
            return self.last
        return False

    def needs_last_stop(self, velocity: int, window: int, now: int) -> bool:
        """Whether a drive that the NMT stop should have stopped turns faster than it may at this time of its stop."""
        braking = now - self.began - self._reaction
        tried = self.brake is not Brake.NONE and self.began >= 0
        return self._disables and tried and abs(velocity) > max(window, self._ramp(max(0, braking)))

    def is_unstopped(self, velocity: int, window: int, now: int) -> bool:
        """Whether the drive does not even brake while the heartbeat is withheld, the last thing that the gateway can do."""
        braking = now - self._braked - self._reaction
        return (
            self.brake is Brake.WITHHOLD_HEARTBEAT and braking > 0 and abs(velocity) > max(window, self._ramp(braking))
        )

    def coast(self, velocity: int, window: int, now: int) -> bool:
        """One cycle after a stop, with a drive that shows power off. True, once, if it turns and does not become slower."""
        self.brake = Brake.NONE
        self._nmt_tried = self.waits = self.last = False
        speed = abs(velocity)
        if speed <= window or self.order is Order.ENTER:
            self.over()
        elif speed < _SLOWER * self._speed:
            self._speed, self.began = speed, now
        elif now - self.began > self._stopped_within:
            self.over()
            return True
        return False

    # -- the speed ------------------------------------------------------------------------------------------------------

    def _follow_line(self, order: Order, speed: int, at: int) -> None:
        """The line begins with the first speed after the order, and rises with the speed in the reaction time."""
        if self._line_at < 0:
            if at >= self.began:
                self._line_at = self._at = self._slow = at
                self._speed, self._spared = speed, 0
                self._growth.restart(speed, at)
                self._stop_growth.restart(speed, at)
        elif at - self._line_at <= self._reaction:
            self._speed = max(self._speed, speed)  # the drive may still accelerate to an earlier setpoint
            if order is Order.HALT:
                self._growth.restart(speed, at)

    def _grows(self, order: Order, speed: int, window: int, now: int) -> bool:
        """Whether the drive becomes faster although Halt or Quick Stop is commanded."""
        if order is Order.STOP:
            return self._stop_growth.step(speed, window, now)
        if order is not Order.HALT and order is not Order.STANDSTILL:
            return False
        if order is Order.HALT or speed <= self.reference // _HALTED:
            self._slow = now
        return self._growth.step(speed, window, now) or now - self._slow >= _OVER_NS

    def _turns(self, line: Line, speed: int, window: int, now: int) -> bool:
        """Whether the speed is above its line."""
        since = now - self._line_at
        if speed <= window:
            if line is Line.HALT:
                self._restart()  # the next motion has its own time
            return False
        if line is Line.RAMP:
            return since > self._reaction and speed > self._ramp(since - self._reaction)
        lost = max(window, int((1 - _SLOWER) * self._speed))
        if line is Line.DRIVE:
            lost = max(window, int((1 - _SLOWER) * self._speed * since / self._stop_time))
            return since > self._reaction + self._stop_time // _JERK and speed > self._speed - lost
        if line is Line.HALT:
            if since <= self._reaction or speed <= self._speed - lost:
                self._speed, self._fell = max(speed, self._speed) if since <= self._reaction else speed, now
            return now - self._fell > self._stop_time
        return False

    def _ramp(self, braking: int) -> int:
        """The speed a drive on its ramp is below after this time, with margin."""
        return self._speed - self.reference * braking // (RAMP_MARGIN * self._stop_time)

    # -- the state ------------------------------------------------------------------------------------------------------

    def _stays(
        self, order: Order, state: State | None, slow: bool, position: int, position_ns: int, window: int, now: int
    ) -> bool:
        """Whether the drive shows a state for too long."""
        if state not in _MUST_END.get(order, ()):
            self._left()
            return False
        leave = ORDERS[order].leave
        if self._ignored_since < 0 or state is not self._ignored or (leave > self._leave and self.waits):
            self._ignored, self._ignored_since = state, now
            self._still_since = -1
        self._leave = max(leave, self._leave)
        ignored, allowed = now - self._ignored_since, self._reaction
        if self._leave is Leave.RAMP:
            allowed = self._stopped_within
        elif self._leave is Leave.ENTER:
            allowed = self._enter
        still = slow and self._is_still(position, position_ns, window, now)
        if not slow:
            self._still_since = -1
        # A drive that ignored a stop is not waited for.
        may_wait = still and not self._nmt_tried and (self._leave is Leave.BRAKE or self._leave is Leave.RAMP)
        if may_wait:
            allowed = max(allowed, self._enter)
        self.waits = may_wait and self._reaction < ignored <= allowed
        return ignored > allowed

    def _is_still(self, position: int, position_ns: int, window: int, now: int) -> bool:
        """Whether a shaft inside the standstill window keeps its position. Without a position, only its speed counts."""
        if self._still_since < 0:
            self._still_since, self._still_at = now, None
        if position_ns <= self._still_since:
            return True
        if self._still_at is None:
            self._still_at = position
        # The way that the window allows in the reaction time, or on the ramp from its edge to standstill.
        way = window * max(self._reaction, self._stop_time * window // max(1, self.reference)) / SECOND
        moved = shortest(position - self._still_at, self._span)
        return not self._counts_per_unit or abs(moved) <= max(1.0, way * self._counts_per_unit)
