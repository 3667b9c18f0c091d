"""The image of the simulated drive: its mappable objects, its units, its shaft, and what its modes of operation do with them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pdgw.base.durations import MS, MS_PER_SECOND, US
from pdgw.ds301.communication import SYNC_PERIOD
from pdgw.dsp402.objects import (
    HALT_OPTION,
    HOME_OFFSET,
    MAX_DECELERATION,
    MAX_MOTOR_SPEED,
    MAX_PROFILE_VELOCITY,
    MOTION_PROFILE_TYPE,
    POSITION_RANGE_LIMIT,
    PROFILE_DECELERATION,
    QUICK_STOP_DECELERATION,
    VELOCITY_ENCODER_FACTOR,
)
from pdgw.dsp402.objects import NEGATIVE_LIMIT_SWITCH as NEGATIVE_LIMIT
from pdgw.dsp402.objects import POSITIVE_LIMIT_SWITCH as POSITIVE_LIMIT
from pdgw.dsp402.states import ControlBit, State
from pdgw.peers.drive.model.ramps import SECOND_ENCODER_STEPS, TICK, TORQUE_ACCELERATION, Ramp
from pdgw.peers.drive.model.shapes import Machine, Shape
from pdgw.peers.drive.option_codes import OPTION_CODES, Braking

ObjectReader = Callable[[int, int], int]
_INT32_MAX: Final = (1 << 31) - 1


class DriveImage:
    """Mappable objects are attributes; ``read`` returns the value of the other objects (index, sub-index)."""

    def __init__(self, read: ObjectReader, machine: Machine, shape: Shape) -> None:
        self.read = read
        self.machine = machine
        self.shape = shape
        per_rpm = shape.velocity_per_rpm
        self._fixed_unit = None if per_rpm is None else float(1 / per_rpm)
        self._rate = float(1 / shape.acceleration_per_rpm_s)
        """rpm/s of one acceleration unit."""
        self.wraps = shape.wraps
        self.jerk_ms = 0
        """Time until a ramp of a speed has its full rate."""
        self.quick_stop_deceleration = 0
        """The quick stop ramp in acceleration units; 0: 6085h."""
        self.ramp_ms = 0
        """Shortest time of a ramp from standstill to the maximum speed of the motor; 0: that of the objects."""
        self.stands_at_setpoint_0 = False
        """A setpoint of 0 of velocity mode is 0, not the minimum speed (6046h/1)."""
        self.started = 0
        """Number of setpoints and homings started since the device was created."""

    state: State
    ramp: Ramp
    deviation: float
    """Speed of the shaft beyond that of the ramp, in rpm."""
    machine_position: float
    zero: float
    limited: bool
    """An internal limit prevents the commanded motion (Statusword.11)."""

    # Objects of the catalogue; ``DriveModel.power_on`` sets them from the declarations.
    controlword: int
    statusword: int
    modes_of_operation: int
    modes_of_operation_display: int
    position_actual: int
    second_position: int
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
    touch_probe_function: int
    touch_probe_status: int
    touch_probe_1_rising: int
    touch_probe_1_falling: int
    touch_probe_2_rising: int
    touch_probe_2_falling: int
    digital_inputs: int

    # -- units --------------------------------------------------------------------------------------------------------

    @property
    def unit(self) -> float:
        """rpm of one velocity unit (6094h)."""
        fixed = self._fixed_unit
        return self.read(VELOCITY_ENCODER_FACTOR, 1) / self.read(VELOCITY_ENCODER_FACTOR, 2) if fixed is None else fixed

    @property
    def max_rpm(self) -> float:
        """Maximum speed of the motor."""
        return float(self.read(MAX_MOTOR_SPEED, 0))

    @property
    def speed_limit(self) -> float:
        """Maximum speed of profiles in rpm."""
        return min(self.max_rpm, self.read(MAX_PROFILE_VELOCITY, 0) * self.unit)

    @property
    def position(self) -> float:
        """Actual position in increments."""
        return self.machine_position - self.zero

    def acceleration(self, value: int, limit_index: int) -> float:
        """Acceleration of a ramp object in rpm/s (of the ENGEL-like drive in 10 rpm/s), limited by 60C5h / 60C6h."""
        return self.profile_rate(self._rate * max(1, min(value, self.read(limit_index, 0))))

    def profile_rate(self, rate: float) -> float:
        """A rate of the profile in rpm/s, limited by ``ramp_ms``."""
        return min(rate, self.max_rpm * MS_PER_SECOND / self.ramp_ms) if self.ramp_ms else rate

    @property
    def profile_braking(self) -> int:
        """Deceleration in acceleration units: 6084h, or 6083h for a drive without it (CiA 402)."""
        one_ramp = PROFILE_DECELERATION in self.shape.lacks
        return self.profile_acceleration if one_ramp else self.profile_deceleration

    @property
    def position_range(self) -> tuple[int, int]:
        """The first position of 6064h, and the position at which it starts again."""
        low, high = (self.read(POSITION_RANGE_LIMIT, sub) if self.wraps else 0 for sub in (1, 2))
        return (low, high) if low < high else (-(1 << 31), 1 << 31)

    @property
    def position_span(self) -> int:
        """Number of positions."""
        low, high = self.position_range
        return high - low

    @property
    def slow_down_rate(self) -> float:
        """Deceleration of the slow down ramp in rpm/s."""
        return self.acceleration(self.profile_braking, MAX_DECELERATION)

    def action(self, option: int) -> object:
        """The meaning of an option code, see ``OPTION_CODES``."""
        return OPTION_CODES[option].actions[self.read(option, 0)]

    def braking_rate(self, option: int, slow_down: float) -> float:
        """Deceleration by an option code that does not free the motor. ``slow_down``: of the mode of operation (both rpm/s)."""
        braking = self.action(option)
        if braking is Braking.QUICK_STOP:
            rate = self.quick_stop_deceleration or self.read(QUICK_STOP_DECELERATION, 0)
            return self.profile_rate(self._rate * rate)
        return TORQUE_ACCELERATION * self.max_torque / 1000 if braking is Braking.CURRENT_LIMIT else slow_down

    def halt_rate(self, slow_down: float) -> float:
        """Deceleration of Halt (rpm/s)."""
        return self.braking_rate(HALT_OPTION, slow_down)

    @property
    def sine(self) -> bool:
        """Whether ramps are sine-squared (6086h)."""
        return self.read(MOTION_PROFILE_TYPE, 0) == 1

    @property
    def sine_times(self) -> tuple[float, float]:
        """Rise and fall time in seconds of a sine-squared ramp; a PDO may carry 0."""
        return max(1, self.profile_acceleration) * TICK, max(1, self.profile_braking) * TICK

    @property
    def sync_ticks(self) -> int:
        """Ticks from one SYNC to the next for a mode that needs them (1006h); 0: not monitored."""
        return self.read(SYNC_PERIOD, 0) * US // MS

    # -- motion that it shows -----------------------------------------------------------------------------------------

    @property
    def speed(self) -> float:
        """Speed of the shaft in rpm."""
        return self.ramp.speed + self.deviation

    def in_units(self, rpm: float) -> int:
        """A speed in velocity units, within the range of the objects."""
        return min(max(round(rpm / self.unit), -_INT32_MAX), _INT32_MAX)

    def show_motion(self) -> None:
        """Set velocities and positions of the image."""
        self.velocity_actual = self.in_units(self.speed)
        self.velocity_demand = self.in_units(self.ramp.speed) if self.deviation else self.velocity_actual
        low, high = self.position_range
        self.position_actual = low + (round(self.position) - low) % (high - low)
        self.second_position = _wrapped(round(self.machine_position * SECOND_ENCODER_STEPS), 32)
        self.encoder_position = _wrapped(round(self.machine_position), 16)

    # -- services for the modes ---------------------------------------------------------------------------------------

    @property
    def halted(self) -> bool:
        """Whether Halt is set in the Controlword."""
        return bool(self.controlword & ControlBit.HALT)

    def against_limit(self, speed: float) -> bool:
        """Whether a limit switch blocks this direction."""
        return bool(
            (speed < 0 and self.digital_inputs & NEGATIVE_LIMIT) or (speed > 0 and self.digital_inputs & POSITIVE_LIMIT)
        )

    def slow_down(self, deceleration: float) -> bool:
        """One tick of deceleration to standstill (rpm/s); True at standstill."""
        return self.ramp.linear(0.0, deceleration, deceleration, self.jerk_ms) == 0.0

    def follow_at_once(self, speed: float) -> None:
        """Change the speed (rpm) without a ramp, within the limits of motor and limit switches."""
        limit = self.max_rpm
        self.limited = self.against_limit(speed)
        self.ramp.set(0.0 if self.limited else min(max(speed, -limit), limit))

    def stop_at(self, position: float) -> None:
        """Stop at a position (increments)."""
        self.machine_position = position + self.zero
        self.ramp.set(0.0)

    def home_here(self) -> None:
        """Set the present position to the home position of 607Ch."""
        self.zero = self.machine_position - self.read(HOME_OFFSET, 0)
        self.ramp.set(0.0)


def _wrapped(value: int, bits: int) -> int:
    """A count that starts again after its number of bits."""
    half = 1 << bits - 1
    return (value + half) % (2 * half) - half
