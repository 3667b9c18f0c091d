"""What limits a task: required scaling, torque limit.

Requirements of a traversing task on a drive: its mode, and 100 % of position, velocity and accelerations. The torque limit
(6072h) of a positioner by SDO: lowered for a fixed stop, and the drive's own value afterwards. Source: docs/motion.md
"Traversing blocks". The positioner's PDOs have no room for 6072h, and a fixed stop is not urgent.
"""

from __future__ import annotations

from dataclasses import dataclass

from pdgw.dsp402.drive_type import DriveType, Dsp402Error, Quantity
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import MAX_TORQUE
from pdgw.gateway.axis.executors.executor import highest
from pdgw.gateway.axis.values import Outputs, SdoWrite
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.profidrive.datatypes import n4
from pdgw.profidrive.normalisation import Normalisation


def base_mode(drive: DriveType, *, modulo: bool) -> int:
    """The mode of traversing tasks; Dsp402Error for a drive without it."""
    if modulo:
        if drive.quirks.turntable is None:
            raise Dsp402Error("modulo_axis", True, "false: no turntable mode of this drive is known")
        return drive.quirks.turntable.mode
    return position_mode(drive)


def position_mode(drive: DriveType) -> int:
    """Profile position, with speeds (6081h) in the unit of 606Ch; Dsp402Error for a drive without it."""
    mode = drive.require_profile_position()
    if drive.speed_mode == Mode.VL_VELOCITY:
        raise Dsp402Error(
            "modes of the drive (6502h)",
            sorted(drive.modes),
            "3 or 9 beside 1: the unit of 6042h differs from the unit of 6081h, the speed of a traversing task",
        )
    return mode


@dataclass(frozen=True, slots=True)
class TaskScaling:
    """Conversions between fractions and the drive's units, each within the limits of its object."""

    position: Normalisation
    relative: Normalisation
    velocity: Normalisation
    acceleration: Normalisation
    deceleration: Normalisation
    one_ramp: bool
    """The drive has no 6084h: 6083h is its acceleration and its deceleration."""
    only_velocity: int
    """The drive has no 6081h: 100 %, the only velocity of its tasks; 0: any."""

    @classmethod
    def of(cls, drive: DriveType) -> TaskScaling:
        """Dsp402Error when 100 % of one of them is not known, or the drive lacks an object."""
        scaling = drive.scaling
        one_ramp = not drive.has("profile_deceleration")
        top_speed = highest(drive, Quantity.PROFILE_VELOCITY, "profile_velocity")
        has_velocity = drive.has("profile_velocity")
        speeds = drive.limits("profile_velocity")[0] if has_velocity else 0, top_speed
        positions = drive.limits("target_position")
        low, high = scaling.position_range or positions
        position = scaling.reference(Quantity.POSITION)
        return cls(
            n4(position, (max(low, positions[0]), min(high, positions[1]))),
            n4(position, positions),
            n4(scaling.reference(Quantity.PROFILE_VELOCITY), speeds, minimum=0),
            _rate(drive, Quantity.ACCELERATION, "profile_acceleration"),
            _rate(drive, Quantity.DECELERATION, "profile_acceleration" if one_ramp else "profile_deceleration"),
            one_ramp,
            0 if has_velocity else top_speed,
        )


def _rate(drive: DriveType, quantity: Quantity, attribute: str) -> Normalisation:
    """A ramp, up to 100 %."""
    limits = drive.limits(attribute)[0], highest(drive, quantity, attribute)
    return n4(drive.scaling.reference(quantity), limits)


@dataclass(slots=True, eq=False)
class TorqueLimit:
    """Call ``follow`` once per cycle; ``holds`` is True when the drive has the limit. Values in 1/1000 of the rated torque."""

    _outputs: Outputs
    _base: int = 0
    """The drive's own limit."""
    _held: int = 0
    """Present limit in the drive; -1 while it is unknown."""
    _refused: int = -1
    """The limit that the drive rejected last; -1 for none."""
    _writes: tuple[SdoWrite, ...] | None = None
    """The write that is not answered yet."""

    def set_base(self, limit: int) -> None:
        """The type of the drive was read again: its own limit in 1/1000 of the rated torque, never one that was lowered."""
        if self._held == self._base:
            self._held = limit
        self._base = limit

    def lost(self) -> None:
        """A drive that is not there takes no limit: ``follow`` asks again in each cycle."""
        if self._writes is not None:
            self._withdraw()

    def restarted(self, *, lowers: bool) -> None:
        """The drive has its own or its last limit again: write the new one once, if a task may have lowered it (``lowers``)."""
        if lowers or self._held != self._base:
            self._withdraw()
            self._refused = -1

    def _withdraw(self) -> None:
        if self._outputs.writes == self._writes:
            self._outputs.writes = None
        self._writes = None
        self._held = -1 if self._base else 0

    def _limit(self, torque: int | None) -> int:
        return self._base if torque is None else min(torque, self._base)

    def holds(self, torque: int | None) -> bool:
        """The drive has this limit."""
        return self._held == self._limit(torque)

    def follow(self, torque: int | None) -> None:
        """Requested limit in 1/1000 of the rated torque, None: the drive's own. Call it after everything that may write."""
        outputs, wanted = self._outputs, self._limit(torque)
        if self._writes is not None and outputs.writes != self._writes:
            self._writes = None  # homing has replaced the limit: write it again afterwards
        if wanted == self._held or wanted == self._refused or outputs.writes is not None:
            return
        self._held = self._refused = -1
        self._writes = outputs.writes = (SdoWrite(*MAX_TORQUE, wanted),)

    def answered(self, error: str | None) -> bool:
        """``Outputs.writes`` are done: whether they were ours."""
        writes = self._writes
        if writes is None:
            return False
        self._writes = None
        if error is None:
            self._held = writes[0].value
        else:
            outputs = self._outputs
            self._refused = writes[0].value
            outputs.reason = Reason.TORQUE_LIMIT
            outputs.warn(FaultNumber.POSITIONER, f"torque limit 6072h = {writes[0].value}: {error}")
        return True
