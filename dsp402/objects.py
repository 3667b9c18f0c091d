"""The object catalogue of CiA 402 drives, and the indices of objects that are used by name.

Objects with a value in an image are found by its attribute; further ones are those of velocity mode, factor group, units and
homing methods. Types and PDO mapping flags are the profile's. Source: CiA 402-2, CiA DSP 402 V2.0, CiA DS 301 V4.01. Defaults
and limits come from the data sheet of a device (``dsp402.identification.describe``). A manufacturer's objects and special
units are in the overlay of its family (``dsp402.identification.overlay``). Simulator, PDO layouts, parameter channel and
decoder use this table.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Final

from pdgw.ds301.communication import communication_objects, pdo_objects
from pdgw.ds301.objects import Access, CanType, Catalogue, Entry, ObjectKind, ObjectSpec, array, var

ABORT_OPTION: Final = 0x6007
VL_TARGET_VELOCITY: Final = 0x6042
VL_MIN_MAX: Final = 0x6046
VL_MIN_MAX_BY_DIRECTION: Final = 0x6047
VL_ACCELERATION: Final = 0x6048
VL_DECELERATION: Final = 0x6049
VL_QUICK_STOP: Final = 0x604A
VL_SETPOINT_FACTOR: Final = 0x604B
VL_DIMENSION_FACTOR: Final = 0x604C
QUICK_STOP_OPTION: Final = 0x605A
SHUTDOWN_OPTION: Final = 0x605B
DISABLE_OPERATION_OPTION: Final = 0x605C
HALT_OPTION: Final = 0x605D
FAULT_REACTION_OPTION: Final = 0x605E
POSITION_ACTUAL: Final = 0x6064
FOLLOWING_ERROR_WINDOW: Final = 0x6065
FOLLOWING_ERROR_TIME: Final = 0x6066
POSITION_WINDOW: Final = 0x6067
VELOCITY_WINDOW: Final = 0x606D
VELOCITY_THRESHOLD: Final = 0x606F
TARGET_TORQUE: Final = 0x6071
MAX_CURRENT: Final = 0x6073
RATED_CURRENT: Final = 0x6075
RATED_TORQUE: Final = 0x6076
TARGET_POSITION: Final = 0x607A
POSITION_RANGE_LIMIT: Final = 0x607B
HOME_OFFSET: Final = 0x607C
SOFTWARE_POSITION_LIMIT: Final = 0x607D
POLARITY: Final = 0x607E
MAX_PROFILE_VELOCITY: Final = 0x607F
MAX_MOTOR_SPEED: Final = 0x6080
PROFILE_VELOCITY: Final = 0x6081
END_VELOCITY: Final = 0x6082
PROFILE_ACCELERATION: Final = 0x6083
PROFILE_DECELERATION: Final = 0x6084
QUICK_STOP_DECELERATION: Final = 0x6085
MOTION_PROFILE_TYPE: Final = 0x6086
TORQUE_SLOPE: Final = 0x6087
POSITION_NOTATION: Final = 0x6089
POSITION_DIMENSION: Final = 0x608A
VELOCITY_NOTATION: Final = 0x608B
VELOCITY_DIMENSION: Final = 0x608C
ACCELERATION_NOTATION: Final = 0x608D
ACCELERATION_DIMENSION: Final = 0x608E
POSITION_ENCODER_RESOLUTION: Final = 0x608F
VELOCITY_ENCODER_RESOLUTION: Final = 0x6090
GEAR_RATIO: Final = 0x6091
FEED_CONSTANT: Final = 0x6092
POSITION_FACTOR: Final = 0x6093
VELOCITY_ENCODER_FACTOR: Final = 0x6094
VELOCITY_FACTOR: Final = 0x6096
ACCELERATION_FACTOR: Final = 0x6097
HOMING_SPEEDS: Final = 0x6099
HOMING_ACCELERATION: Final = 0x609A
PROFILE_JERK: Final = 0x60A4
SI_UNIT_POSITION: Final = 0x60A8
SI_UNIT_VELOCITY: Final = 0x60A9
SI_UNIT_ACCELERATION: Final = 0x60AA
POSITION_OFFSET: Final = 0x60B0
VELOCITY_OFFSET: Final = 0x60B1
TORQUE_OFFSET: Final = 0x60B2
INTERPOLATION_TIME: Final = 0x60C2
MAX_ACCELERATION: Final = 0x60C5
MAX_DECELERATION: Final = 0x60C6
POSITIVE_TORQUE_LIMIT: Final = 0x60E0
NEGATIVE_TORQUE_LIMIT: Final = 0x60E1
SUPPORTED_HOMING_METHODS: Final = 0x60E3
POSITIONING_OPTION: Final = 0x60F2
MAX_SLIPPAGE: Final = 0x60F8
TARGET_VELOCITY: Final = 0x60FF
SUPPORTED_DRIVE_MODES: Final = 0x6502


RO, RW, CONST = Access.RO, Access.RW, Access.CONST
I8, I16, I32 = CanType.I8, CanType.I16, CanType.I32
U8, U16, U32 = CanType.U8, CanType.U16, CanType.U32

DRIVE_PROFILE: Final = 402
"""Number of this profile in the device type 1000h."""
PDOS = 5
"""PDOs of each direction that have an identifier of their own."""
VELOCITY_UNIT = "velocity units"
ACCELERATION_UNIT = "acceleration units"
POSITION_UNIT = "position units"
CURRENT_UNIT = "1/1000 of 6075h"
TORQUE_UNIT = "1/1000 of the rated torque"
NEGATIVE_LIMIT_SWITCH = 1 << 0
"""Bits of 60FDh (CiA 402)."""
POSITIVE_LIMIT_SWITCH = 1 << 1
CONTROL_ATTRIBUTE: Final = "controlword"
STATUS_ATTRIBUTE: Final = "statusword"
"""Image attributes of the two words without which nothing is commanded and nothing known."""

DRIVE_OBJECTS = Catalogue(
    (
        var(ABORT_OPTION, "Abort Connection Option Code", I16, RW),
        var(0x603F, "Error Code", U16, RO, pdo=True, attribute="emcy_code"),
        var(0x6040, "Controlword", U16, RW, pdo=True, attribute=CONTROL_ATTRIBUTE),
        var(0x6041, "Statusword", U16, RO, pdo=True, attribute=STATUS_ATTRIBUTE),
        var(QUICK_STOP_OPTION, "Quick Stop Option Code", I16, RW),
        var(SHUTDOWN_OPTION, "Shutdown Option Code", I16, RW),
        var(DISABLE_OPERATION_OPTION, "Disable Operation Option Code", I16, RW),
        var(HALT_OPTION, "Halt Option Code", I16, RW),
        var(FAULT_REACTION_OPTION, "Fault Reaction Option Code", I16, RW),
        var(0x6060, "Modes of Operation", I8, RW, pdo=True, attribute="modes_of_operation"),
        var(0x6061, "Modes of Operation Display", I8, RO, pdo=True, attribute="modes_of_operation_display"),
        var(
            POSITION_ACTUAL, "Position Actual Value", I32, RO, pdo=True, unit=POSITION_UNIT, attribute="position_actual"
        ),
        var(FOLLOWING_ERROR_WINDOW, "Following Error Window", U32, RW, unit=POSITION_UNIT),
        var(POSITION_WINDOW, "Position Window", U32, RW, unit=POSITION_UNIT),
        var(0x606B, "Velocity Demand Value", I32, RO, pdo=True, unit=VELOCITY_UNIT, attribute="velocity_demand"),
        var(0x606C, "Velocity Actual Value", I32, RO, pdo=True, unit=VELOCITY_UNIT, attribute="velocity_actual"),
        var(VELOCITY_WINDOW, "Velocity Window", U16, RW, unit=VELOCITY_UNIT),
        var(VELOCITY_THRESHOLD, "Velocity Threshold", U16, RW, unit=VELOCITY_UNIT),
        var(TARGET_TORQUE, "Target Torque", I16, RW, pdo=True, unit=TORQUE_UNIT, attribute="target_torque"),
        var(0x6072, "Max Torque", U16, RW, pdo=True, unit=TORQUE_UNIT, attribute="max_torque"),
        var(MAX_CURRENT, "Max Current", U16, RW, unit=CURRENT_UNIT),
        var(RATED_CURRENT, "Motor Rated Current", U32, RW, unit="mA"),
        var(0x6078, "Current Actual Value", I16, RO, pdo=True, unit=CURRENT_UNIT, attribute="current_actual"),
        var(0x6079, "DC Link Circuit Voltage", U32, RO, pdo=True, unit="mV", attribute="dc_link_voltage"),
        var(TARGET_POSITION, "Target Position", I32, RW, pdo=True, unit=POSITION_UNIT, attribute="target_position"),
        array(
            POSITION_RANGE_LIMIT,
            "Position Range Limit",
            Entry(POSITION_RANGE_LIMIT, 1, "Min Position Range Limit", I32, RW, unit=POSITION_UNIT),
            Entry(POSITION_RANGE_LIMIT, 2, "Max Position Range Limit", I32, RW, unit=POSITION_UNIT),
        ),
        var(HOME_OFFSET, "Home Offset", I32, RW, unit=POSITION_UNIT),
        var(MAX_PROFILE_VELOCITY, "Max Profile Velocity", U32, RW, unit=VELOCITY_UNIT),
        var(MAX_MOTOR_SPEED, "Max Motor Speed", U32, RW, unit="rpm"),
        var(PROFILE_VELOCITY, "Profile Velocity", U32, RW, pdo=True, unit=VELOCITY_UNIT, attribute="profile_velocity"),
        var(
            PROFILE_ACCELERATION,
            "Profile Acceleration",
            U32,
            RW,
            pdo=True,
            unit=ACCELERATION_UNIT,
            attribute="profile_acceleration",
        ),
        var(
            PROFILE_DECELERATION,
            "Profile Deceleration",
            U32,
            RW,
            pdo=True,
            unit=ACCELERATION_UNIT,
            attribute="profile_deceleration",
        ),
        var(QUICK_STOP_DECELERATION, "Quick Stop Deceleration", U32, RW, unit=ACCELERATION_UNIT),
        var(MOTION_PROFILE_TYPE, "Motion Profile Type", I16, RW),
        array(
            VELOCITY_ENCODER_FACTOR,
            "Velocity Encoder Factor",
            Entry(VELOCITY_ENCODER_FACTOR, 1, "Numerator", U32, RW),
            Entry(VELOCITY_ENCODER_FACTOR, 2, "Divisor", U32, RW),
        ),
        var(0x6098, "Homing Method", I8, RW, attribute="homing_method"),
        array(
            HOMING_SPEEDS,
            "Homing Speeds",
            Entry(HOMING_SPEEDS, 1, "Speed during search for switch", U32, RW, unit=VELOCITY_UNIT),
            Entry(HOMING_SPEEDS, 2, "Speed during search for zero", U32, RW, unit=VELOCITY_UNIT),
        ),
        var(HOMING_ACCELERATION, "Homing Acceleration", U32, RW, unit=ACCELERATION_UNIT),
        var(VELOCITY_OFFSET, "Velocity Offset", I32, RW, pdo=True, unit=VELOCITY_UNIT, attribute="velocity_offset"),
        array(
            INTERPOLATION_TIME,
            "Interpolation Time Period",
            Entry(INTERPOLATION_TIME, 1, "Period", U8, RW),
            Entry(INTERPOLATION_TIME, 2, "Index", I8, RW),
            kind=ObjectKind.RECORD,
        ),
        var(MAX_ACCELERATION, "Max Acceleration", U32, RW, unit=ACCELERATION_UNIT),
        var(MAX_DECELERATION, "Max Deceleration", U32, RW, unit=ACCELERATION_UNIT),
        array(
            0x60E4,
            "Additional Position Actual Value",
            Entry(
                0x60E4,
                1,
                "1st additional position actual value",
                I32,
                RO,
                pdo=True,
                unit="increments of the second encoder",
                attribute="second_position",
            ),
        ),
        var(0x60FD, "Digital Inputs", U32, RO, pdo=True, attribute="digital_inputs"),
        array(
            0x60FE,
            "Digital Outputs",
            Entry(0x60FE, 1, "Physical outputs", U32, RW, pdo=True, attribute="digital_outputs"),
            Entry(0x60FE, 2, "Bit mask", U32, RW, pdo=True, attribute="digital_outputs_mask"),
        ),
        var(TARGET_VELOCITY, "Target Velocity", I32, RW, pdo=True, unit=VELOCITY_UNIT, attribute="target_velocity"),
        var(SUPPORTED_DRIVE_MODES, "Supported Drive Modes", U32, RO),
    )
)
"""The profile area; the communication area (1000h-1FFFh) is in ``ds301.communication``."""
CONTROLWORD: Final = DRIVE_OBJECTS.attribute(CONTROL_ATTRIBUTE).address
STATUSWORD: Final = DRIVE_OBJECTS.attribute(STATUS_ATTRIBUTE).address
MODE: Final = DRIVE_OBJECTS.attribute("modes_of_operation").address
MODE_DISPLAY: Final = DRIVE_OBJECTS.attribute("modes_of_operation_display").address
ERROR_CODE: Final = DRIVE_OBJECTS.attribute("emcy_code").address
MAX_TORQUE: Final = DRIVE_OBJECTS.attribute("max_torque").address
HOMING_METHOD: Final = DRIVE_OBJECTS.attribute("homing_method").address
"""Addresses of some of them, for SDO."""


def _of_a_family(attribute: str, name: str, type_: CanType) -> Entry:
    return Entry(0, 0, name, type_, attribute=attribute)


FAMILY_VALUES: Mapping[str, Entry] = {
    entry.attribute: entry
    for entry in (
        _of_a_family("dynamic_speed_limit", "Dynamic Speed Limit", U16),
        _of_a_family("dynamic_torque_limit", "Dynamic Torque Limit", U16),
        _of_a_family("error_code", "Error Number", U16),
        _of_a_family("analogue_input_1", "Analogue Input 1", I16),
        _of_a_family("analogue_input_2", "Analogue Input 2", I16),
        _of_a_family("encoder_position", "Encoder Position Value", I16),
    )
}
"""Values of the images the profile has no object for, without an address: the overlay of a family says which object has one."""


@cache
def known_objects() -> tuple[ObjectSpec, ...]:
    """Everything of the profile that has a name here, communication area included; what of it a drive has is not said."""
    return (
        *communication_objects(0, "", (0, 0, 0, 0), ("", "")),
        *pdo_objects(PDOS, PDOS, ()),
        *DRIVE_OBJECTS.objects,
    )


_METHODS = 37


def _ratio(index: int, name: str, first: str, second: str, type_: CanType = U32) -> ObjectSpec:
    return array(index, name, Entry(index, 1, first, type_, RW), Entry(index, 2, second, type_, RW))


FURTHER_OBJECTS: tuple[ObjectSpec, ...] = (
    var(VL_TARGET_VELOCITY, "vl target velocity", I16, RW, pdo=True, attribute="target_velocity"),
    var(0x6043, "vl velocity demand", I16, RO, pdo=True, attribute="velocity_demand"),
    var(0x6044, "vl velocity actual value", I16, RO, pdo=True, attribute="velocity_actual"),
    _ratio(VL_MIN_MAX, "vl velocity min max amount", "Minimum", "Maximum"),
    array(
        VL_MIN_MAX_BY_DIRECTION,
        "vl velocity min max",
        *(
            Entry(VL_MIN_MAX_BY_DIRECTION, sub, name, U32)
            for sub, name in enumerate(("Minimum pos", "Maximum pos", "Minimum neg", "Maximum neg"), 1)
        ),
    ),
    _ratio(VL_ACCELERATION, "vl velocity acceleration", "Delta speed", "Delta time"),
    _ratio(VL_DECELERATION, "vl velocity deceleration", "Delta speed", "Delta time"),
    _ratio(VL_QUICK_STOP, "vl velocity quick stop", "Delta speed", "Delta time"),
    _ratio(VL_SETPOINT_FACTOR, "vl setpoint factor", "Numerator", "Denominator", I16),
    _ratio(VL_DIMENSION_FACTOR, "vl dimension factor", "Numerator", "Denominator", I32),
    var(FOLLOWING_ERROR_TIME, "Following error time out", U16, unit="ms"),
    _ratio(SOFTWARE_POSITION_LIMIT, "Software position limit", "Minimum", "Maximum", I32),
    var(POLARITY, "Polarity", U8),
    var(END_VELOCITY, "End velocity", U32, unit=VELOCITY_UNIT),
    var(TORQUE_SLOPE, "Torque slope", U32),
    var(POSITION_NOTATION, "Position notation index", I8),
    var(POSITION_DIMENSION, "Position dimension index", U8),
    var(VELOCITY_NOTATION, "Velocity notation index", I8),
    var(VELOCITY_DIMENSION, "Velocity dimension index", U8),
    var(ACCELERATION_NOTATION, "Acceleration notation index", I8),
    var(ACCELERATION_DIMENSION, "Acceleration dimension index", U8),
    _ratio(POSITION_ENCODER_RESOLUTION, "Position encoder resolution", "Encoder increments", "Motor revolutions"),
    _ratio(
        VELOCITY_ENCODER_RESOLUTION,
        "Velocity encoder resolution",
        "Encoder increments per second",
        "Motor revolutions per second",
    ),
    _ratio(GEAR_RATIO, "Gear ratio", "Motor revolutions", "Shaft revolutions"),
    _ratio(FEED_CONSTANT, "Feed constant", "Feed", "Shaft revolutions"),
    _ratio(POSITION_FACTOR, "Position factor", "Numerator", "Divisor"),
    _ratio(VELOCITY_FACTOR, "Velocity factor", "Numerator", "Divisor"),
    _ratio(ACCELERATION_FACTOR, "Acceleration factor", "Numerator", "Divisor"),
    array(PROFILE_JERK, "Profile jerk", Entry(PROFILE_JERK, 1, "Profile jerk 1", U32)),
    var(SI_UNIT_POSITION, "SI unit position", U32),
    var(SI_UNIT_VELOCITY, "SI unit velocity", U32),
    var(SI_UNIT_ACCELERATION, "SI unit acceleration", U32),
    var(POSITION_OFFSET, "Position offset", I32, unit=POSITION_UNIT),
    var(TORQUE_OFFSET, "Torque offset", I16, unit=TORQUE_UNIT),
    var(POSITIVE_TORQUE_LIMIT, "Positive torque limit value", U16, unit=TORQUE_UNIT),
    var(NEGATIVE_TORQUE_LIMIT, "Negative torque limit value", U16, unit=TORQUE_UNIT),
    array(
        SUPPORTED_HOMING_METHODS,
        "Supported homing methods",
        *(Entry(SUPPORTED_HOMING_METHODS, sub, f"Homing method {sub}", I8, RO) for sub in range(1, _METHODS + 1)),
    ),
    var(POSITIONING_OPTION, "Positioning option code", U16),
    var(MAX_SLIPPAGE, "Max slippage", I32, unit=VELOCITY_UNIT),
)
"""Objects with an image attribute belong to velocity mode (vl): they replace it in a drive with no other speed mode."""

VL_ENTRIES: Final[Mapping[str, Entry]] = {
    entry.attribute: entry for spec in FURTHER_OBJECTS for entry in spec.entries if entry.attribute
}
"""Objects of velocity mode (vl), by image attribute."""
