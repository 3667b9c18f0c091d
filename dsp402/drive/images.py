"""Process images of a drive: values to the drive and from the drive, read and written by the PDO codecs.

Attribute names are those of the object catalogue (a test compares them). Values are raw object values.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from pdgw.dsp402.modes import Mode

DEMAND_UNKNOWN: Final = -(1 << 31)
"""``DriveFeedback.velocity_demand`` until the drive has sent one."""

UNKNOWN: Final = MappingProxyType(
    {"velocity_demand": DEMAND_UNKNOWN, "current_actual": 0, "modes_of_operation_display": 0}
)
"""Values of ``DriveFeedback`` that are evidence of nothing, for those that are old."""


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
        "second_position",
        "statusword",
        "velocity_actual",
        "velocity_demand",
    )

    def __init__(self) -> None:
        self.statusword = 0
        self.modes_of_operation_display = 0
        self.position_actual = 0
        self.second_position = 0
        self.velocity_demand = DEMAND_UNKNOWN
        self.velocity_actual = 0
        self.current_actual = 0
        self.dc_link_voltage = 0
        self.digital_inputs = 0
        self.analogue_input_1 = 0
        self.analogue_input_2 = 0
        self.encoder_position = 0
        self.error_code = 0


def attributes(image: object) -> tuple[str, ...]:
    """The value attributes of an image. Not from ``__slots__``, which a compiled class lacks."""
    return tuple(name for name in dir(image) if name.islower() and not name.startswith("_"))
