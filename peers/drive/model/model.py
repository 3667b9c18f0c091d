"""The simulated drive without CANopen: the image of its objects, its power section, and time.

Source: the manufacturer's guide chapters 5 and 7, CiA DSP 402 V2.0, interpretations in docs/translation.md. Time is
simulated in whole milliseconds. The modes of operation are in ``modes``. Not simulated: following error, temperature, and
currents beyond an acceleration proportional to torque.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import CanopenError
from pdgw.dsp402.drive_type import DriveFault
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import (
    ABORT_OPTION,
    DISABLE_OPERATION_OPTION,
    FAULT_REACTION_OPTION,
    HALT_OPTION,
    QUICK_STOP_OPTION,
    SHUTDOWN_OPTION,
)
from pdgw.dsp402.objects import NEGATIVE_LIMIT_SWITCH as NEGATIVE_LIMIT
from pdgw.dsp402.objects import POSITIVE_LIMIT_SWITCH as POSITIVE_LIMIT
from pdgw.dsp402.states import STATUS_OF, Command, ControlBit, State, StatusBit, next_state
from pdgw.peers.drive.model.image import DriveImage, ObjectReader
from pdgw.peers.drive.model.latency import DelayLine, Latency
from pdgw.peers.drive.model.modes import MODES
from pdgw.peers.drive.model.probe import TouchProbe
from pdgw.peers.drive.model.ramps import COAST_DECELERATION, TICK, Ramp, increments_per_second
from pdgw.peers.drive.model.shapes import ENGEL, ROTARY_AXIS, Machine, Shape
from pdgw.peers.drive.objects import DRIVE_FAULTS, OBJECTS
from pdgw.peers.drive.option_codes import STAYS_STOPPED, Braking

DI1: Final = 1 << 16
_LIMITS: Final = NEGATIVE_LIMIT | POSITIVE_LIMIT
_RAMPED_STATES: Final = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
_ENDS_BY_ITSELF: Final = (State.NOT_READY_TO_SWITCH_ON, State.QUICK_STOP_ACTIVE)
"""The drive leaves them without a command."""
_DISABLING: Final = {State.READY_TO_SWITCH_ON: SHUTDOWN_OPTION, State.SWITCHED_ON: DISABLE_OPERATION_OPTION}
"""The option code of a transition from Operation Enabled, by its target."""
_SYNC_FAULT: Final = replace(DRIVE_FAULTS[12], name="SYNC missing", error_code=0x8700)
_STATE_BITS: Final = {
    state: bits
    | StatusBit.VOLTAGE_ENABLED
    | StatusBit.REMOTE
    | (0 if state is State.QUICK_STOP_ACTIVE else StatusBit.NO_QUICK_STOP)
    for state, bits in STATUS_OF.items()
}
"""Bits of the Statusword in each state, without those of the mode."""
_STANDSTILL_RPM: Final = 10.0
"""A load moves the shaft no faster at the end of a stop."""
_CATCH_UP_TICKS: Final = 1000
"""Longest simulated gap. After a longer gap between two calls the drive loses the rest of the time."""


class DriveModel(DriveImage):
    """Power section and time. ``emcy`` collects (error code, error register)."""

    def __init__(self, read: ObjectReader, machine: Machine | None = None, shape: Shape = ENGEL) -> None:
        super().__init__(read, machine or ROTARY_AXIS, shape)
        self.emcy: list[tuple[int, int]] = []
        self.disguises: list[Callable[[DriveModel, int], None]] = []
        """Functions that falsify the image; called with the model's time after each of its updates."""
        self.loads: list[Callable[[DriveModel], float]] = []
        """Functions that add a speed (rpm) to that of the ramp in each tick: what the machine does to the shaft."""
        self._disguised = False
        """The image is falsified: it shows the drive again after the next update without disguises."""
        self.latency = Latency()
        self.stop_ramp = True
        """The quick stop brakes. If not, the drive turns until the connection is lost, then its power is off."""
        self.stops_in_pre_operational = True
        """NMT pre-operational counts as a lost connection."""
        self.transition_ms: dict[tuple[State, State], int] = {}
        """Time from a command, or from standstill, until the drive changes from one state to another."""
        self.opening_ms = 0
        """Time from the start of operation until the drive moves."""
        self.fault_reset_edges = 1
        """Number of rising edges of Controlword 7 that reset a fault."""
        self.starts_in_fault = False
        self.free_rpm = 0.0
        """Speed to which the load turns a motor without power."""
        self.watchers: list[Callable[[State], None]] = []
        """Functions called with each new state."""
        self.power_on()

    def power_on(self) -> None:
        """Reset everything to its power-on value; the axis is at machine position 0."""
        for spec in (*OBJECTS.objects, *self.shape.has):
            for entry in spec.entries:
                if entry.attribute:
                    setattr(self, entry.attribute, entry.default or 0)
        self.error_register = 0
        self.state = State.NOT_READY_TO_SWITCH_ON
        self.ramp = Ramp()
        self.deviation = 0.0
        self.machine_position = 0.0
        self.zero = 0.0
        self.digital_inputs = DI1
        self.limited = False
        self._pressed = 0
        """Torque against a mechanical stop."""
        self.causes: set[int] = set()
        self.probe = TouchProbe(self)
        self._time = -1
        self._shown_state: State | None = None
        self._state_bits = 0
        """Bits of the state that was shown last."""
        self._late_status = DelayLine()
        self._next_state: State | None = None
        """The state to which the drive is on its way,"""
        self._waited = 0
        """and the ticks at standstill since then."""
        self._closed_ticks = 0
        """Ticks until the drive moves."""
        self._without_sync = 0
        """Ticks since the last SYNC."""
        self._previous_controlword = 0
        self._reset_edges = 0
        self._processed = False
        """The Controlword has been processed: the same one changes nothing before ``wake`` or a tick."""
        self._modes = {number: MODES[number](self) for number in self.shape.modes}
        self.mode: int = Mode.POSITION if Mode.POSITION in self._modes else min(self._modes)
        self.motion = self._modes[self.mode]
        """The active mode of operation."""
        self.wake()
        self._update()

    def reset(self) -> None:
        """Restart the firmware. Inputs, causes of faults and the turning shaft do not change."""
        inputs, causes, position, ramp = self.digital_inputs, self.causes, self.machine_position, self.ramp
        self.power_on()
        self.digital_inputs, self.causes, self.ramp = inputs, causes, ramp
        self.machine_position = self.zero = position
        if causes:
            self._fault(DRIVE_FAULTS[min(causes)])
        self._update()

    # -- commands -----------------------------------------------------------------------------------------------------

    def inject(self, fault: int | str) -> None:
        """Raise one of the faults 1-12, by number or name; CanopenError for another one. Its cause stays until ``clear``."""
        found = next((number for number, item in DRIVE_FAULTS.items() if fault in {number, item.name}), None)
        if found is None:
            known = ", ".join(f"{number} {item.name}" for number, item in DRIVE_FAULTS.items())
            raise CanopenError("drive fault", fault, f"one of {known}")
        self.causes.add(found)
        self._fault(DRIVE_FAULTS[found])

    def clear(self) -> None:
        """Remove the causes of all faults, so that a fault reset is accepted."""
        self.causes.clear()
        self.wake()

    def set_enable_input(self, on: bool) -> None:
        """Digital input DI1: Enable Operation is Disable Operation without it."""
        self.digital_inputs = self.digital_inputs | DI1 if on else self.digital_inputs & ~DI1
        # The Controlword is a level: an active Enable Operation takes effect as soon as the input permits.
        self.wake()
        self.command()

    def synchronised(self) -> None:
        """A SYNC has arrived."""
        self._without_sync = 0

    @property
    def _sync_ticks(self) -> int:
        return self.sync_ticks if self.motion.synchronous else 0

    def abort_connection(self) -> None:
        """The connection to the master is lost: react according to 6007h.

        Also without power: its last Controlword may be an Enable Operation that waits only for DI1.
        """
        self.wake()
        if not self.stop_ramp and self.state is State.QUICK_STOP_ACTIVE:
            self._enter(State.SWITCH_ON_DISABLED)
        if self.state is State.NOT_READY_TO_SWITCH_ON:
            return
        action = self.action(ABORT_OPTION)
        if isinstance(action, Command):
            target = next_state(self.state, action.word, self.controlword)
            if target is not self.state:
                self._enter(target)
        elif action is not None:
            self._fault(DRIVE_FAULTS[12])
        self._update()

    def command(self) -> None:
        """Process Controlword and mode in the image. Called for every one received."""
        word, previous = self.controlword, self._previous_controlword
        if self._processed and word == previous:
            return
        self._previous_controlword = word
        before = self.mode, self._condition()
        self._select_mode(word)
        if self.state is State.FAULT:
            # An edge while a cause is present is lost.
            self._reset_edges += not self.causes and next_state(self.state, word, previous) is not State.FAULT
            if self._reset_edges >= self.fault_reset_edges:
                self._reset_edges = 0
                self.error_code = self.emcy_code = self.error_register = 0
                self.emcy.append((0, 0))
                self._enter(State.SWITCH_ON_DISABLED)
        else:
            target = next_state(self.state, word, previous)
            if target is State.SWITCHED_ON and self.state is State.READY_TO_SWITCH_ON:
                self._enter(target)
                target = next_state(self.state, word, previous)
            if target is State.OPERATION_ENABLED and not self.digital_inputs & DI1:
                target = State.SWITCHED_ON
            if target is self.state:
                self._next_state = self._next_state if self.state in _ENDS_BY_ITSELF else None
            else:
                self._enter(target)
        if self.state is State.OPERATION_ENABLED:
            self.motion.command(word, previous)
        self.motion.received()
        if word != previous or before != (self.mode, self._condition()):
            self.wake()
        else:
            self._processed = self._resting or self._even
        self._update()

    def _select_mode(self, word: int) -> None:
        if (
            self.modes_of_operation == self.mode
            or word & ControlBit.HALT
            or self.modes_of_operation not in self.shape.modes
        ):
            return
        self.mode = self.modes_of_operation
        self.motion = self._modes[self.mode]
        self.motion.selected()

    def _enter(self, state: State) -> None:
        if state is not self._next_state:
            self._next_state, self._waited = state, 0
        if state is State.QUICK_STOP_ACTIVE and self.action(QUICK_STOP_OPTION) is Braking.NONE:
            state = State.SWITCH_ON_DISABLED
        powered = self.state is State.OPERATION_ENABLED
        if powered and self.ramp.speed and state in _DISABLING and self.action(_DISABLING[state]) is not Braking.NONE:
            return  # it slows down first
        if self._waited < self.transition_ms.get((self.state, state), 0) and (powered or self.ramp.speed == 0.0):
            return
        self._next_state = None
        ramped = self.state in _RAMPED_STATES
        self.state = state
        self._closed_ticks = self.opening_ms if state is State.OPERATION_ENABLED else 0
        for watch in self.watchers:
            watch(state)
        if state is not State.OPERATION_ENABLED:
            self.motion.disabled()
        elif not ramped:
            self.motion.enabled()

    def _fault(self, fault: DriveFault) -> None:
        if self.state in {State.FAULT, State.FAULT_REACTION_ACTIVE}:
            return
        self.error_code = fault.number
        self.emcy_code = fault.error_code
        self.error_register = fault.error_register
        self.emcy.append((fault.error_code, fault.error_register))
        self._reset_edges = 0
        self.wake()
        self._enter(State.FAULT_REACTION_ACTIVE)
        self._update()

    # -- time ---------------------------------------------------------------------------------------------------------

    def advance(self, now: int) -> None:
        """Simulate up to ``now`` (monotonic ns)."""
        if self._time < 0:
            self._time = now
            if self.state is State.NOT_READY_TO_SWITCH_ON:
                self._enter(State.FAULT if self.starts_in_fault else State.SWITCH_ON_DISABLED)
            self._update()
        steps = (now - self._time) // MS
        if steps <= 0:
            return
        end = self._time + steps * MS
        if not self._resting:
            left = min(steps, _CATCH_UP_TICKS)
            while left and not self._resting:
                left -= self._cruise(left) if self._even else self._watched_tick()
                if self.latency.status_ms:
                    self._time = end - left * MS
                    if left:
                        self._show_status(self.in_units(self.speed))
                    else:
                        self._update()
            if self._time < end:
                self._time = end
                self._update()
        else:
            self._time = end
            if self._disguised or self.disguises or self._late_status.next_change is not None:
                self._update()

    def next_change(self) -> int | None:
        """Time of the next possible change of the image without an input; None if the drive is at rest and unchanged."""
        return (
            self._late_status.next_change
            if self._resting and not (self._disguised or self.disguises)
            else self._time + MS
        )

    def cruises(self, ticks: int) -> bool:
        """Whether after this number of ticks only the position will have changed."""
        if not self._even or self.disguises or self._late_status.next_change is not None:
            return False
        position = self.machine_position + ticks * increments_per_second(self.ramp.speed) * TICK
        return self._inputs_at(position) == self.digital_inputs and self.machine.within_stops(position)

    def turned(self, now: int) -> float:
        """Increments of the machine at ``now``, including the part of a tick."""
        self.advance(now)
        return self.machine_position + increments_per_second(self.speed) * (now - self._time) / SECOND

    def wake(self) -> None:
        """Something outside has changed: the next tick may differ from the last one."""
        self._resting = self._even = self._processed = False

    def _watched_tick(self) -> int:
        """Simulate one tick. Return how many following ticks are equal: at rest, or at constant speed."""
        speed = self.ramp.speed
        before = self._condition()
        self._processed = False
        self._tick()
        if (
            self.ramp.speed == speed  # not on a ramp; the rest takes longer to compare
            and before == self._condition()
            and not self.loads
            and not (self._sync_ticks and self.state is State.OPERATION_ENABLED)
        ):
            self._resting = self.ramp.speed == 0.0
            self._even = not self._resting and self.state is State.OPERATION_ENABLED and self.motion.even
        return 1

    def _condition(self) -> tuple[object, ...]:
        """Everything that a tick can change, except the position of a turning axis."""
        speed = self.ramp.speed
        return (
            self.state,
            self._waited,
            self._closed_ticks,
            speed,
            self.machine_position if speed == 0.0 else None,
            self.zero,
            self.digital_inputs,
            self.current_actual,
            self.target_velocity,
            self.target_position,
            self.limited,
            *self.motion.condition(),
        )

    def _cruise(self, ticks: int) -> int:
        """Simulate this number of ticks at constant speed, or fewer until a limit switch or stop. Return the number."""
        position = self.machine_position + ticks * increments_per_second(self.ramp.speed) * TICK
        if self._inputs_at(position) != self.digital_inputs or not self.machine.within_stops(position):
            self._even = False
            return self._watched_tick()
        self.probe.turned(self.machine_position, position)
        self.machine_position = position
        return ticks

    def _tick(self) -> None:
        if self._next_state is not None:
            self._waited += self.ramp.speed == 0.0
            self._enter(self._next_state)
        state = self.state
        if state is State.OPERATION_ENABLED:
            if self._next_state is not None:
                self.slow_down(self.motion.slow_down_rate)
            elif self.halted and self.motion.halts and self.action(HALT_OPTION) is Braking.NONE:
                self._enter(State.SWITCH_ON_DISABLED)
            elif self._closed_ticks:
                self._closed_ticks -= 1
                self.slow_down(COAST_DECELERATION)  # a shaft that still turns rubs at its brake
            elif not self._sync_is_lost():
                self.motion.move()
        elif state is State.QUICK_STOP_ACTIVE:
            stopped = self.stop_ramp and self._brakes(QUICK_STOP_OPTION)
            if stopped and self.read(QUICK_STOP_OPTION, 0) < STAYS_STOPPED:
                self._enter(State.SWITCH_ON_DISABLED)
        elif state is State.FAULT_REACTION_ACTIVE:
            if self._brakes(FAULT_REACTION_OPTION):
                self._enter(State.FAULT)
        else:
            self.ramp.linear(self.free_rpm, COAST_DECELERATION, COAST_DECELERATION)
            self.current_actual = 0
        self._turn()

    def _sync_is_lost(self) -> bool:
        period = self._sync_ticks
        self._without_sync = self._without_sync + 1 if period else 0
        lost = self._without_sync > self.shape.sync_tolerance * period
        if lost:
            self._fault(_SYNC_FAULT)
        return lost

    def _brakes(self, option: int) -> bool:
        """Brake for one tick. Return whether that has ended: at standstill, or at once without power."""
        if self.action(option) is Braking.NONE:
            return True
        stopped = self.slow_down(self.braking_rate(option, self.motion.slow_down_rate))
        return stopped and abs(self.deviation) < _STANDSTILL_RPM

    def _turn(self) -> None:
        """Move the axis up to a mechanical stop."""
        self.deviation = sum(load(self) for load in self.loads)
        position = self.machine_position + increments_per_second(self.speed) * TICK
        pressing = not self.machine.within_stops(position)
        if pressing:
            position = min(max(position, self.machine.negative_stop), self.machine.positive_stop)
            self._pressed = self.max_torque if self.speed > 0 else -self.max_torque
            self.ramp.set(0.0)
            self.deviation = 0.0
        if self._pressed and not self.motion.makes_torque:
            self.current_actual = self._pressed = self._pressed if pressing else 0
        self.probe.turned(self.machine_position, position)
        self.machine_position = position
        self.digital_inputs = self._inputs_at(position)

    def _inputs_at(self, position: float) -> int:
        """The digital inputs, with the limit switches at a position of the machine."""
        return self.digital_inputs & ~_LIMITS | self.machine.switches(position)

    # -- image --------------------------------------------------------------------------------------------------------

    def _update(self) -> None:
        self.show_motion()
        self.modes_of_operation_display = self.mode
        self._show_status(self.velocity_actual)

    def _show_status(self, units: int) -> None:
        """Set the Statusword: through the delay line, then by the disguises. ``units``: actual velocity."""
        state = self.state
        if state is not self._shown_state:
            self._shown_state, self._state_bits = state, _STATE_BITS[state]
        halted = self.halted and state is State.OPERATION_ENABLED
        if halted and self.ramp.speed == 0 and abs(self.deviation) < _STANDSTILL_RPM:
            units = 0
        status = self._state_bits | self.motion.bits(halted, units)
        if self.limited:
            status |= StatusBit.INTERNAL_LIMIT
        self.statusword = self._late_status.show(status, self._time, self.latency.status_ms)
        for disguise in self.disguises:
            disguise(self, self._time)
        self._disguised = bool(self.disguises)
