"""Requirements of a traversing task on a drive: its mode, and 100 % of position, velocity and accelerations."""

from __future__ import annotations

from dataclasses import dataclass

from pdgw.dsp402.drive_type import DriveType, Quantity
from pdgw.dsp402.errors import Dsp402Error
from pdgw.dsp402.modes import Mode
from pdgw.gateway.axis.executors.base import highest
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

    @classmethod
    def of(cls, drive: DriveType) -> TaskScaling:
        """Dsp402Error when 100 % of one of them is not known, or the drive lacks an object."""
        scaling = drive.scaling
        one_ramp = not drive.has("profile_deceleration")
        positions = drive.limits("target_position")
        low, high = scaling.position_range or positions
        position = scaling.reference(Quantity.POSITION)
        return cls(
            n4(position, (max(low, positions[0]), min(high, positions[1]))),
            n4(position, positions),
            _rate(drive, Quantity.PROFILE_VELOCITY, "profile_velocity", minimum=0),
            _rate(drive, Quantity.ACCELERATION, "profile_acceleration"),
            _rate(drive, Quantity.DECELERATION, "profile_acceleration" if one_ramp else "profile_deceleration"),
            one_ramp,
        )


def _rate(drive: DriveType, quantity: Quantity, attribute: str, minimum: int | None = None) -> Normalisation:
    """A speed or a ramp, up to 100 %."""
    limits = drive.limits(attribute)[0], highest(drive, quantity, attribute)
    return n4(drive.scaling.reference(quantity), limits, minimum=minimum)
