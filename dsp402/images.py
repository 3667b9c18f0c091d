"""What a drive is told and what it tells: the process images the PDO codecs read and write.

Attribute names are those of the object catalogue (a test holds them together). Values are raw object values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Final

from pdgw.dsp402.errors import Dsp402Error
from pdgw.dsp402.modes import Mode


class DriveCommand:
    """Values for the drive (RPDO objects). One instance per axis, updated in place each cycle."""

    __slots__ = (
        "controlword",
        "digital_outputs",
        "digital_outputs_mask",
        "dynamic_speed_limit",
        "dynamic_torque_limit",
        "max_torque",
        "modes_of_operation",
        "profile_acceleration",
        "profile_deceleration",
        "profile_velocity",
        "target_position",
        "target_torque",
        "target_velocity",
        "velocity_offset",
    )

    def __init__(self) -> None:
        self.controlword = 0
        self.modes_of_operation: int = Mode.POSITION
        self.target_torque = 0
        self.target_position = 0
        self.profile_velocity = 0
        self.profile_acceleration = 1
        self.profile_deceleration = 1
        self.dynamic_speed_limit = 0
        self.dynamic_torque_limit = 0
        self.max_torque = 0
        self.digital_outputs = 0
        self.digital_outputs_mask = 0
        self.target_velocity = 0
        self.velocity_offset = 0


class DriveFeedback:
    """Values from the drive (TPDO objects). One instance per axis, updated in place."""

    __slots__ = (
        "analogue_input_1",
        "analogue_input_2",
        "current_actual",
        "dc_link_voltage",
        "digital_inputs",
        "encoder_position",
        "error_code",
        "modes_of_operation_display",
        "position_actual",
        "statusword",
        "velocity_actual",
        "velocity_demand",
    )

    def __init__(self) -> None:
        self.statusword = 0
        self.modes_of_operation_display = 0
        self.position_actual = 0
        self.velocity_demand = 0
        self.velocity_actual = 0
        self.current_actual = 0
        self.dc_link_voltage = 0
        self.digital_inputs = 0
        self.analogue_input_1 = 0
        self.analogue_input_2 = 0
        self.encoder_position = 0
        self.error_code = 0


def _attributes(image: object) -> tuple[str, ...]:
    """Of an image; not by ``__slots__``, which a compiled class does not have."""
    return tuple(name for name in dir(image) if not name.startswith("_"))


COMMAND_NAMES: Final = _attributes(DriveCommand())
FEEDBACK_NAMES: Final = _attributes(DriveFeedback())
"""What the images hold."""


@dataclass(frozen=True, slots=True)
class References:
    """The drive's reference objects, read at start and after every change.

    Units are the objects' own: 6080h in rpm, 607Fh in velocity units, 607Bh in increments, 60C5h/60C6h in 10 rpm/s.
    """

    max_motor_speed: int = 3000
    velocity_numerator: int = 1
    velocity_denominator: int = 2
    max_profile_velocity: int = 6000
    position_min: int = -500000
    position_max: int = 500000
    max_acceleration: int = 1000
    max_deceleration: int = 1000
    max_torque: int = 3000
    """Torque limit (6072h) as it was found; 0 where the drive has none."""
    counts_per_revolution: Fraction | None = Fraction(4096)
    """Position units in one revolution of the motor; this and the next two are None where nothing tells them."""
    velocity_per_rpm: Fraction | None = Fraction(2)
    acceleration_per_rpm_s: Fraction | None = Fraction(1, 10)

    @classmethod
    def of(cls, values: Mapping[str, int]) -> References:
        """With the values of objects by the name of their field; the others as they come."""
        known: dict[str, Any] = dict(values)
        return replace(cls(), **known)

    def check(self) -> None:
        """Dsp402Error names the first reference that is 0 or negative: the axis must refuse operation then."""
        for name, value in (
            ("Max Motor Speed 6080h", self.max_motor_speed),
            ("Velocity Encoder Factor 6094h/1", self.velocity_numerator),
            ("Velocity Encoder Factor 6094h/2", self.velocity_denominator),
            ("Max Profile Velocity 607Fh", self.max_profile_velocity),
            ("Position Range Limit 607Bh/2", self.position_max),
            ("Max Acceleration 60C5h", self.max_acceleration),
            ("Max Deceleration 60C6h", self.max_deceleration),
        ):
            if value <= 0:
                raise Dsp402Error(name, value, "a value above 0")

    @property
    def speed_reference(self) -> Fraction:
        """100 % of NSOLL/NIST in velocity units of the drive."""
        return Fraction(self.max_motor_speed * self.velocity_denominator, self.velocity_numerator)

    @property
    def profile_velocity_reference(self) -> Fraction:
        """100 % of MDI_VELOCITY in velocity units: the smaller of 607Fh and 6080h, compared in rpm."""
        return min(Fraction(self.max_profile_velocity), self.speed_reference)


MAX_TORQUE = (0x6072, 0)
REFERENCE_OBJECTS: tuple[tuple[str, int, int], ...] = (
    ("max_motor_speed", 0x6080, 0),
    ("velocity_numerator", 0x6094, 1),
    ("velocity_denominator", 0x6094, 2),
    ("max_profile_velocity", 0x607F, 0),
    ("position_min", 0x607B, 1),
    ("position_max", 0x607B, 2),
    ("max_acceleration", 0x60C5, 0),
    ("max_deceleration", 0x60C6, 0),
    ("max_torque", *MAX_TORQUE),
)
"""Where each field of ``References`` is read from."""
