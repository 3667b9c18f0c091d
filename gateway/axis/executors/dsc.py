"""Cyclic synchronous position (6060h = 8) or velocity (9) for DSC: telegrams 5, 6, 105 and 106.

Source: docs/motion.md "DSC". These modes have no ramp: this module makes a ramp stop, cycle by cycle, with 60C6h. While the
axis is not in operation, the setpoint is its actual position.
"""

from __future__ import annotations

from fractions import Fraction

from pdgw.base.durations import MS, SECOND, SECONDS_PER_MINUTE
from pdgw.dsp402.drive_type import DriveType, Dsp402Error, Quantity
from pdgw.gateway.axis.demand_report import Flag, Report, SpeedDemand, SpeedWish
from pdgw.gateway.axis.executors.executor import AxisRecords, Executor, LimitWatch, demanded_speed, known
from pdgw.gateway.axis.executors.message_words import TOLERANCE_PERCENT, reduced_torque
from pdgw.gateway.axis.power_states import Action
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.dsc_setpoint import Dsc, DscChoices, DscForm, DscSettings, wrapped
from pdgw.gateway.motion.modulo import difference
from pdgw.gateway.motion.units import round_half_away
from pdgw.profidrive.datatypes import DataType, n4
from pdgw.profidrive.normalisation import Normalisation

_GAIN = warning_bits(FaultNumber.DSC_GAIN)
_OUT_OF_DATE = warning_bits(FaultNumber.DSC_OUT_OF_DATE)
_BY_SPEED = DscForm.SPEED
_FREEZE = SpeedWish.FREEZE
_I32 = DataType.INTEGER32.integer_range


class DscExecutor(Executor):
    """One axis under DSC. GatewayError without the user's choice where the loop is closed."""

    def __init__(self, records: AxisRecords) -> None:
        super().__init__(records)
        assert isinstance(records.demand, SpeedDemand), "the adapter of its telegrams has one"
        self._asked = records.demand
        if self.settings.dsc is None:
            raise GatewayError('dsc is missing: a telegram with DSC needs dsc = "position" or "speed"')
        self.choices: DscChoices = self.settings.dsc
        self.dsc: Dsc | None = None
        self._actual: Normalisation | None = None
        self._torque = 0
        self._deceleration = 1
        """Velocity units by which a ramp slows down in one cycle."""
        self._way = (0, 1)
        """Position units in one cycle at a velocity of one unit."""
        self._rest = 0
        self._velocity = 0
        self._near = self._tolerance = 0
        """Largest difference to the setpoint of an axis that has reached it, and to the drive's demand value within tolerance."""
        self._at_target = 0
        """Largest way that is left at the target, in position units."""
        self._limit = LimitWatch()
        self._held = 0
        self._last_frame_ns = 0
        """Arrival of the newest setpoints; this cycle while DSC is off."""
        self._replaced: Reason | None = None
        """Why the PLC's setpoint is not in force. SETPOINT_DISABLED: the speed of the moment STW1.5 fell stays, without DSC;
        DSC_OUT_OF_DATE: no new setpoints for too long, the axis stops, whatever arrives during the stop."""

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        if drive.max_torque <= 0:
            raise Dsp402Error("Max Torque 6072h", drive.max_torque, "a value above 0, which MOMRED reduces")
        scaling = drive.scaling
        counts = known(scaling.counts_per_revolution, "position units per revolution", "counts_per_revolution")
        velocity = known(scaling.velocity_per_rpm, "velocity units per rpm", "velocity_unit")
        acceleration = known(scaling.acceleration_per_rpm_s, "acceleration units", "acceleration_unit")
        if counts.denominator != 1:
            raise Dsp402Error("position units per revolution", counts, "a whole number for DSC")
        choices, cycle_ns, reference = self.choices, self.settings.cycle_ns, scaling.reference(Quantity.SPEED)
        settings = DscSettings(
            choices,
            int(counts),
            reference / velocity,
            velocity,
            cycle_ns,
            position_span=scaling.position_span,
            velocity_range=drive.limits("target_velocity" if choices.form is _BY_SPEED else "velocity_offset"),
        )
        self.dsc = Dsc(settings)
        self._actual = n4(reference, _I32)
        self._torque = self.command.max_torque = drive.max_torque
        cycle = Fraction(cycle_ns, SECOND)
        self._deceleration = max(1, int(scaling.reference(Quantity.DECELERATION) / acceleration * cycle * velocity))
        self._way = (counts / velocity / SECONDS_PER_MINUTE * cycle).as_integer_ratio()
        self._near = int(reference * self.settings.standstill_window)
        self._tolerance = int(reference) * TOLERANCE_PERCENT // 100
        self._at_target = int(counts) * TOLERANCE_PERCENT // 100

    @property
    def limit_side(self) -> int:
        return self._held

    def refuse(self) -> Report:
        self.outputs.warned = 0
        self._track_actual_position()
        self.command.controlword = self.interlock.controlword
        return self.report.fill(self.interlock.reason)

    def step(self) -> Report:
        interlock, dsc, actual = self.interlock, self.dsc, self._actual
        reason, cell = interlock.reason, interlock.cell
        if dsc is None or actual is None:
            return self.report.fill(reason)
        command, demand, feedback = self.command, self._asked, self.feedback
        if cell.operating:
            reason = self._control(dsc)
            self._report_gain(dsc)
            reason = self._held_at_limit() or reason
        elif cell.action is Action.RAMP:
            self._ramp(dsc)
            self._report_gain(dsc)
        else:
            self._held = self.outputs.warned = 0
            self._replaced = None
            self._limit.step(0, 0, self)
            self._track_actual_position()
        command.controlword = interlock.controlword
        command.max_torque = reduced_torque(self._torque, demand.torque_reduction if demand.connected else 0)
        velocity, flags = feedback.velocity_actual, 0
        if cell.operating and reason is None and abs(velocity - self._velocity) <= self._near:
            flags = Flag.REACHED
        if abs(velocity - feedback.velocity_demand) <= self._tolerance:
            flags |= Flag.WITHIN_TOLERANCE
        return self.report.fill(reason, flags, actual.to_wire(velocity))

    def _control(self, dsc: Dsc) -> Reason | None:
        demand, position = self._asked, self.feedback.position_actual
        # Without control the last words may stay; an earlier position error must not count as a present one.
        fresh = self.inputs.fresh and demand.connected and demand.in_control
        self._check_age(dsc, fresh=fresh)
        if self._replaced is Reason.DSC_OUT_OF_DATE:
            self._ramp(dsc)
            self.outputs.warn(FaultNumber.DSC_OUT_OF_DATE, "DSC stops the axis: no new setpoint for too long")
            return self._replaced
        self.outputs.end_warnings(_OUT_OF_DATE)
        if demand.speed_wish is _FREEZE:
            self._freeze(dsc)
            return self._replaced
        self._replaced = None
        result = dsc.step(demand.speed, *demand.position_error, position, fresh=fresh)
        command, self._velocity = self.command, result.velocity
        if self.choices.form is _BY_SPEED:
            command.target_velocity = result.velocity
            return result.reason
        command.velocity_offset = result.velocity
        if result.position is not None:
            command.target_position = result.position
            self._rest = 0
        else:
            self._travel(result.velocity)
        return result.reason

    def speeds(self) -> tuple[int, int]:
        """The speed setpoint; with a target position also the present speed, as far as XERR is a way in its direction."""
        velocity, actual, dsc = self._velocity, self.feedback.velocity_actual, self.dsc
        if dsc is None or (setpoint := dsc.setpoint).target is None:
            return velocity, velocity
        numerator, denominator = self._way
        way = difference(setpoint.target, setpoint.sent[0]) * denominator // numerator
        return min(velocity, max(way, min(actual, 0))), max(velocity, min(way, max(actual, 0)))

    def _freeze(self, dsc: Dsc) -> None:
        """Continue with the demand speed from the moment STW1.5 fell; XERR and KPC are ignored, DSC starts again afterwards."""
        command = self.command
        if self._replaced is None:
            self._replaced = Reason.SETPOINT_DISABLED
            low, high = dsc.settings.velocity_range
            self._velocity = max(low, min(demanded_speed(self.feedback), high))
        dsc.stop()
        if self.choices.form is _BY_SPEED:
            command.target_velocity = self._velocity
        else:
            command.velocity_offset = self._velocity
            self._travel(self._velocity)

    def _check_age(self, dsc: Dsc, *, fresh: bool) -> None:
        """Stop the axis before DSC starts again, independent of the watchdog time, if the setpoints are too old."""
        now = self.inputs.now
        if dsc.setpoint.active and now - self._last_frame_ns > dsc.hold_ns:
            self._replaced = Reason.DSC_OUT_OF_DATE
        elif self._replaced is Reason.DSC_OUT_OF_DATE and not self._velocity and fresh:
            self._replaced = None
        if fresh or not dsc.setpoint.active:
            self._last_frame_ns = now

    def _held_at_limit(self) -> Reason | None:
        """An axis that was stopped at a limit of the drive does not move after the release until speed 0 and KPC 0."""
        demand, way = self._asked, self._velocity
        if not way and self.choices.form is not _BY_SPEED:
            way = self.command.target_position - self.feedback.position_actual
            way *= abs(way) > self._at_target
        if self._limit.step(way, self._tolerance, self):
            self._held = 1 if way > 0 else -1
        elif not demand.position_error[1] and not demand.speed:
            self._held = 0
        if self._held:
            self._track_actual_position()
        return self._limit.report(self.outputs, held=self._held != 0)

    def _report_gain(self, dsc: Dsc) -> None:
        if not dsc.setpoint.gain_clamped:
            self.outputs.end_warnings(_GAIN)
        elif not self.outputs.warned & _GAIN:
            text = f"KPC is limited to {dsc.gain_limit / 1000:.1f} 1/s (dead time {dsc.dead_time_ns / MS:.1f} ms)"
            self.outputs.warn(FaultNumber.DSC_GAIN, text)

    def _travel(self, velocity: int) -> None:
        """The setpoint of one cycle further on at a speed, without losing fractions."""
        numerator, denominator = self._way
        total = velocity * numerator + self._rest
        way = round_half_away(total, denominator)
        self._rest = total - way * denominator
        self.command.target_position = wrapped(self.command.target_position + way)

    def _ramp(self, dsc: Dsc) -> None:
        """Down from the speed there is."""
        if dsc.setpoint.position is not None:
            # NSOLL_B, the feed-forward, may differ from the speed of the positions.
            self._velocity = self.feedback.velocity_actual
        dsc.stop()
        speed = self._velocity
        speed = max(0, speed - self._deceleration) if speed > 0 else min(0, speed + self._deceleration)
        self._velocity = self.command.target_velocity = self.command.velocity_offset = speed
        if self.choices.form is DscForm.POSITION:
            self._travel(speed)

    def _track_actual_position(self) -> None:
        """Not in operation, or held: where the axis is, so that nothing jumps when it is enabled."""
        if self.dsc is not None:
            self.dsc.stop()
        command, feedback = self.command, self.feedback
        command.target_velocity = command.velocity_offset = 0
        command.target_position = feedback.position_actual
        self._velocity = feedback.velocity_actual
        self._rest = 0
