"""The simulated drive: state machine, modes, homing, limits and faults, without CANopen around it.

Source: the manufacturer's guide chapters 5 and 7, CiA DSP 402 V2.0, readings of docs/translation.md. Time is simulated in
whole milliseconds. Left out: following error, temperature and current models beyond a torque-proportional acceleration.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from pdgw.ds301.errors import CanopenError
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.objects import NEGATIVE_LIMIT_SWITCH as NEGATIVE_LIMIT
from pdgw.dsp402.objects import POSITIVE_LIMIT_SWITCH as POSITIVE_LIMIT
from pdgw.dsp402.states import STATUS_OF, Command, ControlBit, State, StatusBit, next_state
from pdgw.peers.drive.family import DRIVE_FAULTS, HOMING_METHODS
from pdgw.peers.drive.motion import INCREMENTS_PER_REVOLUTION, TICK, Ramp, increments_per_second, speed_toward
from pdgw.peers.drive.shapes import ENGEL, Shape

MS = 1_000_000
DI1 = 1 << 16
_INT32_MAX = (1 << 31) - 1
_RAMPED_STATES = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
_POSITION_MODES = (Mode.POSITION, Mode.TURNTABLE)
_EVEN_MODES = (
    Mode.VELOCITY,
    Mode.VL_VELOCITY,
    Mode.CYCLIC_VELOCITY,
    Mode.SPEED_CONTROL,
    Mode.TORQUE,
    Mode.CURRENT_CONTROL,
)
"""At constant speed nothing but the position changes in these."""
_ABORT_COMMANDS = {2: Command.DISABLE_VOLTAGE, 3: Command.QUICK_STOP}
"""Device control command of 6007h."""
_VL_RAMP = 0x70
"""Controlword of velocity mode (vl): enable ramp, unlock ramp, reference ramp. All three let the set-point through."""
COAST_DECELERATION = 1500.0
"""rpm/s of the free-running motor."""
TORQUE_ACCELERATION = 6000.0
"""rpm/s that rated current gives the unloaded motor."""

_CATCH_UP_TICKS = 1000
"""So much of a gap is simulated; a drive that was not asked for longer has lost time."""

ObjectReader = Callable[[int, int], int]


@dataclass(frozen=True, slots=True)
class Machine:
    """Where the simulated axis ends, in increments of the machine (power-on position is 0); a shaft turns for ever."""

    negative_limit: float | None = None
    positive_limit: float | None = None
    negative_stop: float = -math.inf
    positive_stop: float = math.inf


ROTARY = Machine()
LINEAR = Machine(-550_000, 550_000, -600_000, 600_000)
"""A slide with limit switches 134 revolutions away on either side, and stops behind them."""
MACHINES = {"rotary": ROTARY, "linear": LINEAR}


@dataclass(slots=True)
class _Setpoint:
    target: float
    speed: float
    acceleration: float
    deceleration: float


class DriveModel:
    """The image of the mappable objects (their attributes) and the drive behind it.

    ``read`` gives the value of the other objects (index, sub-index). ``emcy`` collects (error code, error register).
    """

    def __init__(self, read: ObjectReader, machine: Machine | None = None, shape: Shape = ENGEL) -> None:
        self.read = read
        self.machine = machine or ROTARY
        self.shape = shape
        per_rpm = shape.velocity_per_rpm
        self._fixed_unit = None if per_rpm is None else float(1 / per_rpm)
        self._rate = float(1 / shape.acceleration_per_rpm_s)
        """rpm/s of one acceleration unit."""
        self.emcy: list[tuple[int, int]] = []
        self.disguises: list[Callable[[DriveModel, int], None]] = []
        self.stop_ramp = True
        """The quick stop brakes; without it the drive turns on until the connection is lost, and its power goes off then."""
        """What shows something else than the drive does; called with the model's time after each update of the image."""
        self.watchers: list[Callable[[State], None]] = []
        """Called with each state that is entered."""
        self.started = 0
        """Set-points and homings that were begun, since the device was made."""
        self.power_on()

    def power_on(self) -> None:
        """Everything back to its value after power-on; the axis stands at machine position 0."""
        for entry in DRIVE_OBJECTS.entries:
            if entry.attribute:
                setattr(self, entry.attribute, entry.default)
        for spec in self.shape.has:
            for entry in spec.entries:
                if entry.attribute:
                    setattr(self, entry.attribute, entry.default)
        self.error_register = 0
        self.state = State.NOT_READY_TO_SWITCH_ON
        modes = self.shape.modes
        self.mode = Mode.POSITION if Mode.POSITION in modes else Mode(min(modes))
        self.ramp = Ramp()
        self.machine_position = 0.0
        self.zero = 0.0
        self.digital_inputs = DI1
        self.causes: set[int] = set()
        self._time = -1
        self._previous_controlword = 0
        self._setpoint: _Setpoint | None = None
        self._queued: _Setpoint | None = None
        self._acknowledged = False
        self._position_reached = True
        self._limited = False
        self._homing_phase = ""
        self._homing_attained = False
        self._homing_error = False
        self._index_from = 0.0
        self._interpolation_left = 0
        """Ticks to the end of the way in cyclic synchronous position."""
        self.wake()
        self._update()

    def reset(self) -> None:
        """The firmware starts again; inputs, causes of faults and the turning shaft stay as they are."""
        inputs, causes, position, ramp = self.digital_inputs, self.causes, self.machine_position, self.ramp
        self.power_on()
        self.digital_inputs, self.causes, self.ramp = inputs, causes, ramp
        self.machine_position = self.zero = position
        if causes:
            self._fault(min(causes))
        self._update()

    # The attributes of the catalogue, for the type checker; ``power_on`` sets them from the declarations.
    controlword: int
    statusword: int
    modes_of_operation: int
    modes_of_operation_display: int
    position_actual: int
    velocity_demand: int
    velocity_actual: int
    target_velocity: int
    target_position: int
    target_torque: int
    max_torque: int
    velocity_offset: int
    profile_velocity: int
    profile_acceleration: int
    profile_deceleration: int
    dynamic_speed_limit: int
    dynamic_torque_limit: int
    current_actual: int
    dc_link_voltage: int
    digital_outputs: int
    digital_outputs_mask: int
    analogue_input_1: int
    analogue_input_2: int
    encoder_position: int
    error_code: int
    emcy_code: int
    homing_method: int

    # -- units --------------------------------------------------------------------------------------------------------

    @property
    def _unit(self) -> float:
        """rpm of one velocity unit (6094h)."""
        fixed = self._fixed_unit
        return self.read(0x6094, 1) / self.read(0x6094, 2) if fixed is None else fixed

    @property
    def _max_rpm(self) -> float:
        return float(self.read(0x6080, 0))

    @property
    def position(self) -> float:
        """Actual position in increments."""
        return self.machine_position - self.zero

    def _acceleration(self, value: int, limit_index: int) -> float:
        """rpm/s of a ramp object (of the ENGEL-like drive in 10 rpm/s), limited by 60C5h / 60C6h."""
        return self._rate * max(1, min(value, self.read(limit_index, 0)))

    @property
    def _sine(self) -> bool:
        return self.read(0x6086, 0) == 1

    def _sine_times(self) -> tuple[float, float]:
        """Rise and fall time in seconds of a sine-squared ramp; a PDO may carry 0."""
        return max(1, self.profile_acceleration) * TICK, max(1, self.profile_deceleration) * TICK

    # -- commands -----------------------------------------------------------------------------------------------------

    def inject(self, number: int) -> None:
        """Raise one of the faults 1-12; CanopenError for another number. Its cause stays until ``clear``."""
        if number not in DRIVE_FAULTS:
            raise CanopenError("fault number", number, f"one of {list(DRIVE_FAULTS)}")
        self.causes.add(number)
        self._fault(number)

    def clear(self) -> None:
        """Remove the causes of all faults, so that a fault reset is accepted."""
        self.causes.clear()
        self.wake()

    def set_enable_input(self, on: bool) -> None:
        """Digital input DI1: the power stage is only enabled while it is set."""
        self.digital_inputs = self.digital_inputs | DI1 if on else self.digital_inputs & ~DI1
        if not on and self.state is State.OPERATION_ENABLED:
            self._enter(State.SWITCHED_ON)
        # The Controlword is a level: an Enable Operation that still stands takes effect as soon as the input allows.
        self.command()

    def abort_connection(self) -> None:
        """The connection to the master is lost: react as 6007h says.

        In Switched On too: its last Controlword may be an Enable Operation that only waits for DI1.
        """
        self.wake()
        if not self.stop_ramp and self.state is State.QUICK_STOP_ACTIVE:
            self._enter(State.SWITCH_ON_DISABLED)
        if self.state not in {State.SWITCHED_ON, State.OPERATION_ENABLED}:
            return
        option = self.read(0x6007, 0)
        if option == 1:
            self._fault(12)
        elif option in _ABORT_COMMANDS:
            self._enter(next_state(self.state, _ABORT_COMMANDS[option].word, self.controlword))
        self._update()

    def command(self) -> None:
        """Evaluate Controlword and mode as they stand in the image now; called for every one received."""
        self.wake()
        word, previous = self.controlword, self._previous_controlword
        self._previous_controlword = word
        self._select_mode(word)
        if self.state is State.FAULT:
            reset = next_state(self.state, word, previous) is not State.FAULT
            if reset and not self.causes:
                self.error_code = self.emcy_code = self.error_register = 0
                self.emcy.append((0, 0))
                self._enter(State.SWITCH_ON_DISABLED)
        else:
            target = next_state(self.state, word, previous)
            if target is State.SWITCHED_ON and self.state is State.READY_TO_SWITCH_ON:
                self._enter(target)
                target = next_state(self.state, word, previous)
            if target is not self.state and not (target is State.OPERATION_ENABLED and not self.digital_inputs & DI1):
                self._enter(target)
        if self.state is State.OPERATION_ENABLED:
            self._evaluate_bit_4(word, previous)
        if self.mode is Mode.CYCLIC_POSITION:
            period = self.read(0x60C2, 1) * 10.0 ** self.read(0x60C2, 2)
            self._interpolation_left = max(1, round(period / TICK))
        self._update()

    def _select_mode(self, word: int) -> None:
        if (
            self.modes_of_operation == self.mode
            or word & ControlBit.HALT
            or self.modes_of_operation not in self.shape.modes
        ):
            return
        self.mode = Mode(self.modes_of_operation)
        self._setpoint = self._queued = None
        self._acknowledged = False
        self._homing_phase = ""
        self._homing_attained = self._homing_error = False
        self._position_reached = True

    def _enter(self, state: State) -> None:
        powered = self.state in _RAMPED_STATES
        self.state = state
        for watch in self.watchers:
            watch(state)
        if state is State.OPERATION_ENABLED and not powered:
            self._setpoint = self._queued = None
            self._acknowledged = False
            self._position_reached = True
        if state is not State.OPERATION_ENABLED:
            self._setpoint = self._queued = None
            self._acknowledged = False
            self._homing_phase = ""
        if state is State.QUICK_STOP_ACTIVE and self.read(0x605A, 0) == 0:
            self.state = State.SWITCH_ON_DISABLED

    def _fault(self, number: int) -> None:
        fault = DRIVE_FAULTS[number]
        if self.state in {State.FAULT, State.FAULT_REACTION_ACTIVE}:
            return
        self.error_code = number
        self.emcy_code = fault.error_code
        self.error_register = fault.error_register
        self.emcy.append((fault.error_code, fault.error_register))
        self.wake()
        self._enter(State.FAULT_REACTION_ACTIVE)
        self._update()

    # -- set-points ---------------------------------------------------------------------------------------------------

    def _evaluate_bit_4(self, word: int, previous: int) -> None:
        rising = word & ControlBit.NEW_SETPOINT and not previous & ControlBit.NEW_SETPOINT
        # Resetting Halt and setting bit 4 in one Controlword is not allowed: the set-point is not taken.
        allowed = not (word | previous) & ControlBit.HALT
        if self.mode in _POSITION_MODES:
            if rising and allowed and not self._acknowledged:
                self._take_setpoint(word)
            elif not word & ControlBit.NEW_SETPOINT and self._queued is None:
                self._acknowledged = False
        elif self.mode is Mode.HOMING:
            if rising and allowed:
                self._start_homing()
            elif not word & ControlBit.NEW_SETPOINT and self._homing_phase:
                self._homing_phase = "stopping"

    def _take_setpoint(self, word: int) -> None:
        unit = self._unit
        limit = min(self.read(0x607F, 0) * unit, self._max_rpm)
        setpoint = _Setpoint(
            self._absolute_target(word),
            min(self.profile_velocity * unit, limit),
            self._acceleration(self.profile_acceleration, 0x60C5),
            self._acceleration(self.profile_deceleration, 0x60C6),
        )
        self._acknowledged = True
        if self._setpoint is not None and not word & ControlBit.CHANGE_IMMEDIATELY:
            self._queued = setpoint
            return
        self._activate(setpoint)

    def _activate(self, setpoint: _Setpoint) -> None:
        self.started += 1
        self._setpoint = setpoint
        self._position_reached = False

    def _absolute_target(self, word: int) -> float:
        if word & ControlBit.RELATIVE:
            target = self.position + self.target_position
        elif self.mode is Mode.TURNTABLE:
            target = self._turntable_target(word)
        else:
            target = float(self.target_position)
        if self.mode is Mode.TURNTABLE:
            return target
        low, high = self.read(0x607B, 1), self.read(0x607B, 2)
        if low == high == 0:
            return target
        limited = min(max(target, low), high)
        self._limited = limited != target
        return limited

    def _turntable_target(self, word: int) -> float:
        """The nearest absolute position with this angle in the wanted direction."""
        rev = INCREMENTS_PER_REVOLUTION
        forward = (self.target_position - self.position) % rev
        if word & ControlBit.TURNTABLE_SHORTEST:
            distance = forward if forward <= rev / 2 else forward - rev
        elif word & ControlBit.TURNTABLE_CCW:
            distance = forward - rev if forward else 0.0
        else:
            distance = forward
        return self.position + distance

    def _start_homing(self) -> None:
        self.started += 1
        self._homing_attained = self._homing_error = False
        self._position_reached = False
        if self.homing_method not in HOMING_METHODS:
            self._homing_error = True
        elif self.homing_method == 35:
            self._home_here()
        else:
            self._homing_phase = "search"

    def _home_here(self) -> None:
        self.zero = self.machine_position - self.read(0x607C, 0)
        self._homing_phase = ""
        self._homing_attained = True
        self._position_reached = True
        self.ramp.set(0.0)

    # -- time ---------------------------------------------------------------------------------------------------------

    def advance(self, now: int) -> None:
        """Simulate up to ``now`` (monotonic ns)."""
        if self._time < 0:
            self._time = now
            if self.state is State.NOT_READY_TO_SWITCH_ON:
                self._enter(State.SWITCH_ON_DISABLED)
            self._update()
        steps = (now - self._time) // MS
        if steps <= 0:
            return
        self._time += steps * MS
        if not self._resting:
            left = min(steps, _CATCH_UP_TICKS)
            while left and not self._resting:
                left -= self._cruise(left) if self._even else self._watched_tick()
            self._update()
        elif self.disguises:
            self._update()

    def next_change(self) -> int | None:
        """When the image may change by itself; None while nothing moves and nothing was changed."""
        return None if self._resting and not self.disguises else self._time + MS

    def turned(self, now: int) -> float:
        """Increments of the machine at ``now``, the part of a tick in it."""
        self.advance(now)
        return self.machine_position + increments_per_second(self.ramp.speed) * (now - self._time) / 1e9

    def wake(self) -> None:
        """Something was changed from outside: do not take it for unchanged any more."""
        self._resting = self._even = False

    def _watched_tick(self) -> int:
        """One tick, and whether the next ones would do the same: nothing, or turn on as evenly."""
        before = self._condition()
        self._tick()
        if before == self._condition():
            self._resting = self.ramp.speed == 0.0
            self._even = not self._resting and self.state is State.OPERATION_ENABLED and self.mode in _EVEN_MODES
        return 1

    def _condition(self) -> tuple[object, ...]:
        """All that a tick can change; of a turning axis without its position."""
        speed = self.ramp.speed
        return (
            self.state,
            speed,
            self.machine_position if speed == 0.0 else None,
            self.zero,
            self.digital_inputs,
            self.current_actual,
            self.target_velocity,
            self.target_position,
            self._interpolation_left,
            self._setpoint,
            self._queued,
            self._acknowledged,
            self._position_reached,
            self._limited,
            self._homing_phase,
            self._homing_attained,
            self._homing_error,
        )

    def _cruise(self, ticks: int) -> int:
        """At constant speed, so many ticks at once, fewer where a limit switch or stop is met; returns how many."""
        position = self.machine_position + ticks * increments_per_second(self.ramp.speed) * TICK
        if self._inputs_at(position) != self.digital_inputs or not self._within_stops(position):
            self._even = False
            return self._watched_tick()
        self.machine_position = position
        return ticks

    def _tick(self) -> None:
        state = self.state
        if state is State.OPERATION_ENABLED:
            self._move()
        elif state is State.QUICK_STOP_ACTIVE:
            if self.stop_ramp and self._stop(self._quick_deceleration(self.read(0x605A, 0) == 2)):
                self._enter(State.SWITCH_ON_DISABLED)
        elif state is State.FAULT_REACTION_ACTIVE:
            option = self.read(0x605E, 0)
            if option == 0 or self._stop(self._quick_deceleration(option == 2)):
                self._enter(State.FAULT)
        else:
            self.ramp.linear(0.0, COAST_DECELERATION, COAST_DECELERATION)
            self.current_actual = 0
        self._turn()

    def _quick_deceleration(self, quick: bool) -> float:
        if quick:
            return self._rate * self.read(0x6085, 0)
        return self._acceleration(self.profile_deceleration, 0x60C6)

    def _stop(self, deceleration: float) -> bool:
        return self.ramp.linear(0.0, deceleration, deceleration) == 0.0

    def _turn(self) -> None:
        """Move the axis; a mechanical stop holds it."""
        position = self.machine_position + increments_per_second(self.ramp.speed) * TICK
        if not self._within_stops(position):
            machine = self.machine
            position = min(max(position, machine.negative_stop), machine.positive_stop)
            self.ramp.set(0.0)
        self.machine_position = position
        self.digital_inputs = self._inputs_at(position)

    def _within_stops(self, position: float) -> bool:
        return self.machine.negative_stop < position < self.machine.positive_stop

    def _inputs_at(self, position: float) -> int:
        """The digital inputs with the limit switches as they are at a position of the machine."""
        machine = self.machine
        inputs = self.digital_inputs & ~(NEGATIVE_LIMIT | POSITIVE_LIMIT)
        if machine.negative_limit is not None and position <= machine.negative_limit:
            inputs |= NEGATIVE_LIMIT
        if machine.positive_limit is not None and position >= machine.positive_limit:
            inputs |= POSITIVE_LIMIT
        return inputs

    def _move(self) -> None:
        mode = self.mode
        if mode is Mode.CYCLIC_POSITION:
            self._interpolate()
        elif mode in _POSITION_MODES:
            self._move_to_position()
        elif mode is Mode.HOMING:
            self._move_homing()
        elif mode is Mode.TORQUE or mode is Mode.CURRENT_CONTROL:
            self._move_with_torque()
        else:
            self._move_with_speed()

    def _interpolate(self) -> None:
        """To the newest target in a straight line over 60C2h; a target that stays away is the end of the way."""
        distance = self.target_position - self.position
        ticks = max(1, self._interpolation_left)
        self._interpolation_left = ticks - 1
        self._follow_at_once(distance / (ticks * TICK) * 60 / INCREMENTS_PER_REVOLUTION)

    def _follow_at_once(self, wanted: float) -> None:
        """A speed without a ramp, as far as motor and limit switches let it."""
        limit = self._max_rpm
        self._limited = self._against_limit(wanted)
        self.ramp.set(0.0 if self._limited else min(max(wanted, -limit), limit))

    def _halted(self) -> bool:
        return bool(self.controlword & ControlBit.HALT)

    def _against_limit(self, speed: float) -> bool:
        """A limit switch forbids this direction."""
        return bool(
            (speed < 0 and self.digital_inputs & NEGATIVE_LIMIT) or (speed > 0 and self.digital_inputs & POSITIVE_LIMIT)
        )

    def _follow_ramp(self, target: float) -> None:
        """Toward a speed with the profile's ramps; limit switches stop motion in their direction."""
        self._limited = self._against_limit(target)
        if self._limited:
            target = 0.0
        if self._sine:
            self.ramp.sine_squared(target, *self._sine_times())
        else:
            acceleration = self._acceleration(self.profile_acceleration, 0x60C5)
            if self.mode is Mode.VL_VELOCITY:
                up, down = (self.read(index, 1) / max(1, self.read(index, 2)) for index in (0x6048, 0x6049))
                self.ramp.linear(target, up, down)
                return
            if self.mode is Mode.CYCLIC_VELOCITY:
                # The master makes the ramp: the drive follows as fast as it can.
                most = self._acceleration(self.read(0x60C5, 0), 0x60C5)
                self.ramp.linear(target, most, most)
                return
            acceleration = min(acceleration, TORQUE_ACCELERATION * self.max_torque / 1000)
            if self.mode is Mode.SPEED_CONTROL:
                torque = min(self.dynamic_torque_limit, self.read(0x6073, 0))
                acceleration = min(acceleration, TORQUE_ACCELERATION * torque / 1000)
            self.ramp.linear(target, acceleration, self._acceleration(self.profile_deceleration, 0x60C6))

    def _speed_limit(self) -> float:
        return min(self._max_rpm, self.read(0x607F, 0) * self._unit)

    def _move_with_speed(self) -> None:
        if self._halted():
            self.target_velocity = 0
        wanted = self.target_velocity * self._unit
        if self.mode is Mode.VL_VELOCITY and self.controlword & _VL_RAMP != _VL_RAMP:
            wanted = 0.0
        limit = self._speed_limit()
        self._follow_ramp(min(max(wanted, -limit), limit))

    def _move_with_torque(self) -> None:
        rated = min(1000, self.read(0x6073, 0))
        torque = 0 if self._halted() else min(max(self.target_torque, -rated), rated)
        limit = self._max_rpm
        if self.mode is Mode.CURRENT_CONTROL:
            limit = min(limit, self.dynamic_speed_limit * 0.5)
        if torque == 0:
            deceleration = self._acceleration(self.profile_deceleration, 0x60C6)
            self.ramp.linear(0.0, deceleration, deceleration)
        else:
            rate = TORQUE_ACCELERATION * abs(torque) / 1000
            target = math.copysign(limit, torque)
            self._limited = self._against_limit(target)
            self.ramp.linear(0.0 if self._limited else target, rate, rate)
        self.current_actual = torque

    def _move_to_position(self) -> None:
        setpoint = self._setpoint
        if self._halted() or setpoint is None:
            if self._halted():
                self._setpoint = self._queued = None
            deceleration = setpoint.deceleration if setpoint else self._acceleration(self.profile_deceleration, 0x60C6)
            if self._stop(deceleration) and self._halted():
                self._position_reached = True
            return
        distance = setpoint.target - self.position
        if self._sine:
            target = self._sine_speed(setpoint, distance)
        else:
            target = speed_toward(distance, setpoint.speed, setpoint.deceleration)
        self._limited = self._limited and self.read(0x607B, 2) != 0
        if self._against_limit(target):
            self._limited = True
            self._stop(setpoint.deceleration)
            return
        if self._sine:
            self.ramp.sine_squared(target, *self._sine_times())
        else:
            self.ramp.linear(target, setpoint.acceleration, setpoint.deceleration + 1e-6)
        step = increments_per_second(self.ramp.speed) * TICK
        slow = increments_per_second(2 * setpoint.deceleration * TICK) * TICK
        if abs(distance) <= max(1.0, abs(slow)) and abs(step) <= max(1.0, 2 * abs(slow)):
            self._arrive(setpoint)

    def _sine_speed(self, setpoint: _Setpoint, distance: float) -> float:
        """Speed setpoint for sine-squared ramps: the braking distance of a whole ramp is half speed times ramp time."""
        rise, fall = self._sine_times()
        if self.ramp.speed == 0.0 and abs(distance) > 1:
            rpm = 2 * abs(distance) / (rise + fall) * 60 / INCREMENTS_PER_REVOLUTION
            return math.copysign(min(setpoint.speed, rpm), distance)
        braking = increments_per_second(abs(self.ramp.speed)) * fall / 2
        if self.ramp._to == 0.0 or abs(distance) <= braking or distance * self.ramp.speed < 0:
            # The last increments are crept: a ramp by time cannot meet a position exactly.
            creep = math.copysign(min(setpoint.speed, abs(distance) * 60 / INCREMENTS_PER_REVOLUTION * 5), distance)
            return creep if abs(self.ramp.speed) < 1.0 else 0.0
        return self.ramp._to

    def _arrive(self, setpoint: _Setpoint) -> None:
        self.machine_position = setpoint.target + self.zero
        self.ramp.set(0.0)
        self._setpoint = None
        if self._queued is not None:
            self._activate(self._queued)
            self._queued = None
            if not self.controlword & ControlBit.NEW_SETPOINT:
                self._acknowledged = False
        else:
            self._position_reached = True

    def _move_homing(self) -> None:
        phase = self._homing_phase
        acceleration = self._acceleration(self.read(0x609A, 0), 0x60C5)
        if not phase or phase == "stopping" or self._halted():
            if self._stop(acceleration):
                self._position_reached = self._position_reached or not phase or self._halted()
                if phase == "stopping":
                    self._homing_phase = ""
                    self._position_reached = True
            return
        method = self.homing_method
        direction = -1.0 if method in {1, 17, -17} else 1.0
        fast, slow = (min(self.read(0x6099, sub) * self._unit, self._speed_limit()) for sub in (1, 2))
        switch = NEGATIVE_LIMIT if direction < 0 else POSITIVE_LIMIT
        stop = self.machine.negative_stop if direction < 0 else self.machine.positive_stop
        on_switch = bool(self.digital_inputs & switch)
        if phase == "search":
            self._search(direction, fast, acceleration, stop, on_switch)
        elif phase == "leave":
            self.ramp.linear(-direction * slow, acceleration, acceleration)
            if not on_switch and self.ramp.speed * direction < 0:
                if method in {1, 2}:
                    self._homing_phase = "index"
                    self._index_from = self.machine_position
                else:
                    self._home_here()
        elif phase == "index":
            self.ramp.linear(-direction * slow, acceleration, acceleration)
            before = math.floor(self._index_from / INCREMENTS_PER_REVOLUTION)
            after = math.floor(self.machine_position / INCREMENTS_PER_REVOLUTION)
            if before != after:
                pulse = max(before, after) * INCREMENTS_PER_REVOLUTION
                self.machine_position = float(pulse)
                self._home_here()

    def _search(self, direction: float, speed: float, acceleration: float, stop: float, on_switch: bool) -> None:
        """Toward the limit switch or the mechanical stop; a switch that is not there is a homing error."""
        at_stop = self.machine_position == stop
        if self.homing_method < 0:
            if at_stop:
                self._home_here()
                return
        elif on_switch:
            if self._stop(acceleration):
                self._homing_phase = "leave"
            return
        elif at_stop:
            self._homing_phase = ""
            self._homing_error = True
            self.ramp.set(0.0)
            return
        self.ramp.linear(direction * speed, acceleration, acceleration)

    # -- image --------------------------------------------------------------------------------------------------------

    def _update(self) -> None:
        speed = self.ramp.speed
        unit = self._unit
        units = min(max(round(speed / unit), -_INT32_MAX), _INT32_MAX)
        self.velocity_actual = self.velocity_demand = units
        self.position_actual = _wrap32(round(self.position))
        self.encoder_position = _wrap16(round(self.machine_position))
        self.modes_of_operation_display = self.mode
        self.statusword = STATUS_OF[self.state] | self._mode_bits(units) | StatusBit.VOLTAGE_ENABLED | StatusBit.REMOTE
        if self.state is not State.QUICK_STOP_ACTIVE:
            self.statusword |= StatusBit.NO_QUICK_STOP
        if self._limited:
            self.statusword |= StatusBit.INTERNAL_LIMIT
        for disguise in self.disguises:
            disguise(self, self._time)

    def _mode_bits(self, units: int) -> int:
        mode = self.mode
        bits = 0
        halted = self._halted() and self.state is State.OPERATION_ENABLED
        if mode in _POSITION_MODES:
            if self._acknowledged:
                bits |= StatusBit.MODE_12
            if units == 0 if halted else self._position_reached:
                bits |= StatusBit.TARGET_REACHED
        elif mode is Mode.HOMING:
            if self._homing_attained:
                bits |= StatusBit.MODE_12
            if self._homing_error:
                bits |= StatusBit.MODE_13
            if self._position_reached or (halted and units == 0):
                bits |= StatusBit.TARGET_REACHED
        elif mode is Mode.VELOCITY or mode is Mode.SPEED_CONTROL:
            if abs(units) <= self.read(0x606F, 0):
                bits |= StatusBit.MODE_12
            if abs(units - self.target_velocity) <= self.read(0x606D, 0):
                bits |= StatusBit.TARGET_REACHED
        elif halted and units == 0:
            bits |= StatusBit.TARGET_REACHED
        return bits


def _wrap32(value: int) -> int:
    return (value + (1 << 31)) % (1 << 32) - (1 << 31)


def _wrap16(value: int) -> int:
    return (value + (1 << 15)) % (1 << 16) - (1 << 15)
