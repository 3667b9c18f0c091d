"""Speed: to 60FFh (6060h = 3, else 9; 6042h in mode 2), 606Ch to a speed, a ramp stop by Target Velocity 0.

Source: docs/translation.md "Standard telegrams", docs/telegrams.md "Normalisation"; the manufacturer's guide 6.1-6.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pdgw.dsp402.drive_type import VL_REFERENCE, DriveType, Dsp402Error, Quantity
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import StatusBit
from pdgw.gateway.axis.answer import Answer
from pdgw.gateway.axis.demand_report import Flag, Report, SpeedDemand, SpeedWish
from pdgw.gateway.axis.executors.executor import AxisRecords, Executor, LimitWatch, demanded_speed, known
from pdgw.gateway.axis.executors.message_words import TOLERANCE_PERCENT
from pdgw.gateway.axis.power_states import Action
from pdgw.gateway.base.reasons import Reason
from pdgw.profidrive.datatypes import n4
from pdgw.profidrive.normalisation import Normalisation

_ENABLE_OPERATION: Final = Action.ENABLE_OPERATION
_RAMP: Final = Action.RAMP
_FOLLOW: Final = SpeedWish.FOLLOW
_FREEZE: Final = SpeedWish.FREEZE
_ZERO: Final = SpeedWish.ZERO
_JOGS: Final = (SpeedWish.JOG_1, SpeedWish.JOG_2)
_REACHED: Final = Flag.REACHED
_WITHIN_TOLERANCE: Final = Flag.WITHIN_TOLERANCE
_INTERNAL_LIMIT: Final = StatusBit.INTERNAL_LIMIT
_NEAR: Final = 20
"""Divisor of the setpoint: a speed that is further away has not reached it, if it is outside the standstill window too."""
_UNREPORTED: Final = (Mode.VL_VELOCITY, Mode.CYCLIC_VELOCITY)


@dataclass(frozen=True, slots=True)
class DriveSpeeds:
    """The speeds of the drive that is set, until another one is. In its units."""

    setpoint: Normalisation
    """For Target Velocity,"""
    actual: Normalisation
    """and for the actual velocity."""
    range: tuple[int, int]
    """Of Target Velocity."""
    jogs: tuple[int, int]
    tolerance: int
    """Largest difference to the setpoint of an axis that follows it."""
    near: int
    """Standstill window."""
    mode_bits: int
    """Controlword bits that let the setpoint through in operation."""
    minimum: int
    """``slowest`` while the PLC's setpoint, or a speed that is not 0, is in force."""
    unreported: bool
    """The mode has no "target reached" (CiA 402: bit 10 is reserved in vl and csv): the actual speed decides."""


class SpeedExecutor(Executor):
    """An axis that a limit switch has stopped does not move by itself after the release.

    60FFh is 0 until the PLC's setpoint passes through 0, changes its direction, or the axis leaves operation.
    """

    def __init__(self, records: AxisRecords) -> None:
        super().__init__(records)
        assert isinstance(records.demand, SpeedDemand), "the adapter of its telegrams has one"
        self._asked = records.demand
        self._drive: DriveSpeeds | None = None
        self._wire: int | None = None
        self._value = 0
        """The setpoint ``_wire`` of the PLC in the drive's units,"""
        self._limited = False
        """and whether a limit of 60FFh cuts it."""
        self._target = 0
        """The setpoint in force; 0 out of operation."""
        self._bits = 0
        """Controlword bits that let it through in operation."""
        self._begun: SpeedWish | None = None
        """The jog that was begun at standstill, or FREEZE: the ramp is frozen, with the target of its first cycle."""
        self._limit = LimitWatch()
        self._stopped = 0
        """The setpoint at which the axis was stopped at a limit; 0: none."""
        self._sent = 0
        """60FFh of the cycle before."""
        self._arrival = Answer(self.settings.latency_ns)
        """Target reached, in answer to the setpoint."""

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        if drive.speed_mode is None:
            raise Dsp402Error("modes of the drive (6502h)", sorted(drive.modes), "3, 9 or 2 for a speed")
        reference = drive.scaling.reference(Quantity.SPEED)
        low, high = drive.limits("target_velocity")
        jogs, speeds = (0, 0), self.settings.jog_speeds_rpm
        if speeds is not None:
            unit = known(drive.scaling.velocity_per_rpm, "velocity units per rpm", "velocity_unit")
            first, second = (max(low, min(round(rpm * unit), high)) for rpm in speeds)
            jogs = first, second
        self._drive = DriveSpeeds(
            n4(reference, (low, high)),
            n4(reference, drive.limits("velocity_actual")),
            (low, high),
            jogs,
            int(reference) * TOLERANCE_PERCENT // 100,
            max(1, int(reference * self.settings.standstill_window)),
            drive.speed_bits,
            drive.minimum_speed,
            drive.speed_mode in _UNREPORTED,
        )
        self._wire, self._bits, self.slowest = None, drive.speed_bits, 0

    @property
    def limit_side(self) -> int:
        return (self._stopped > 0) - (self._stopped < 0)

    def refuse(self) -> Report:
        self.outputs.warned = 0
        self.command.controlword, self.command.target_velocity = self.interlock.controlword, 0
        return self.report.fill(self.interlock.reason)

    def step(self) -> Report:
        interlock, demand, feedback, drive = self.interlock, self._asked, self.feedback, self._drive
        assert drive is not None, "a drive that is not set is refused"
        cell, controlword, reason = interlock.cell, interlock.controlword, interlock.reason
        if not cell.operating:
            # Also after Enable Operation, until the drive shows that it is in operation.
            self._target, self._begun = 0, None
        elif demand.speed_wish is _FOLLOW:
            self._begun = None
            wire = demand.speed
            if wire != self._wire:
                self._wire, setpoint = wire, drive.setpoint
                self._value = value = setpoint.to_value(wire)
                self._limited = not setpoint.value_min < value < setpoint.value_max and self.cuts(setpoint, wire)
            self._target = self._value
        else:
            reason = self._replace_setpoint(demand.speed_wish, drive)
        target = self._target
        statusword = feedback.statusword
        if self._stopped or statusword & _INTERNAL_LIMIT:
            target = self._held_at_limit(target, drive.tolerance)
            at_limit = self._limit.report(self.outputs, held=self._stopped != 0)
            reason = at_limit if reason is None else reason
        elif self._limit.shown:
            self._limit.reset()
            self.outputs.warned = 0
        if drive.minimum:
            asks = cell.operating and demand.speed_wish is _FOLLOW and not self._stopped
            self.slowest = drive.minimum if target or asks else 0
            self._bits = drive.mode_bits if self.slowest else drive.mode_bits & ~VL_REFERENCE
        if cell.action is _ENABLE_OPERATION or cell.action is _RAMP:
            controlword |= self._bits
        command, velocity = self.command, feedback.velocity_actual
        command.controlword = controlword | demand.device_bits
        command.target_velocity = target
        flags = _REACHED if self._reached(target, statusword, velocity, drive) else 0
        # Without a demand value the difference would be large.
        if -drive.tolerance <= velocity - feedback.velocity_demand <= drive.tolerance:
            flags |= _WITHIN_TOLERANCE
        return self.report.fill(reason, flags, drive.actual.to_wire(velocity))

    def speeds(self) -> tuple[int, int]:
        target, slowest = self.command.target_velocity, self.slowest
        if -slowest < target < slowest:  # also with the sign of the last setpoint, or at standstill
            lowest, highest = (-slowest if target <= 0 else target), (slowest if target >= 0 else target)
            target = max(lowest, min(self.feedback.velocity_actual, highest))
        return target, target

    def _replace_setpoint(self, wish: SpeedWish, drive: DriveSpeeds) -> Reason | None:
        """The target without the PLC's setpoint."""
        if wish is _FREEZE:
            if self._begun is not wish and not self._stopped:
                # The present value of the ramp. An axis stopped at a limit stays stopped.
                low, high = drive.range
                self._target = max(low, min(demanded_speed(self.feedback), high))
            self._begun = wish
        elif wish is _ZERO or (wish in _JOGS and wish is not self._begun and not self.inputs.standstill):
            self._target, self._begun = 0, None
        elif wish in _JOGS:
            self._begun = wish
            self._target = drive.jogs[_JOGS.index(wish)]
        if wish in _JOGS and self._target:
            return None
        if not self._asked.jogs:
            return Reason.SETPOINT_DISABLED
        # STW1.4 to .6 = 1 would start the setpoint, which the PLC does not ask for.
        if wish in _JOGS and drive.jogs[_JOGS.index(wish)]:
            return Reason.JOG_WAITS
        both = wish is _ZERO and any(drive.jogs)
        return Reason.LOST_JOG if both else Reason.NO_JOG_SPEED

    def _reached(self, target: int, statusword: int, velocity: int, drive: DriveSpeeds) -> bool:
        """Whether the drive follows the setpoint in force, and that is the PLC's own."""
        now = self.inputs.now
        if target != self._sent:
            self._sent = target
            self._arrival.command(now)
        apart = velocity - target
        near = -drive.tolerance <= apart <= drive.tolerance
        said = near if drive.unreported else statusword & _REACHED != 0
        answered = self._arrival.read(said, now)
        if not said or not (answered or near) or self.interlock.cell.action is not _ENABLE_OPERATION:
            return False
        if not near and abs(apart) > max(drive.near, abs(target) // _NEAR):
            return False  # the bit is stuck, or older than the setpoint
        own = self._begun is not _FREEZE and not (self._limited and self._asked.speed_wish is _FOLLOW)
        return own and target == self._target

    def _held_at_limit(self, target: int, tolerance: int) -> int:
        """The target, or 0 if an axis stopped at a limit gets a setpoint in the same direction again."""
        if target * self._stopped > 0:
            return 0
        self._stopped = target if self._limit.step(target, tolerance, self) else 0
        return 0 if self._stopped else target
