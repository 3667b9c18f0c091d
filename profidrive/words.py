"""The control and status words of the telegrams, bit by bit, with the confidence of each.

Source: PROFIdrive profile 4.1 chapter 6.3, PROFIdrive encoder profile 4.1, the manufacturer's guide chapters 4.3 and 6, public
manuals of drives. The signal catalogue (``signals``) maps signals to bits; use bits by name.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace


class Confidence(enum.IntEnum):
    """How well public sources support a fact. What is not CONFIRMED is a choice of this project, and shown as one."""

    CONFIRMED = 0
    ONE_SOURCE = 1
    UNVERIFIED = 2

    @property
    def text(self) -> str:
        """For the reader, empty where nothing needs to be said."""
        return "" if self is Confidence.CONFIRMED else self.name.lower().replace("_", " ")


_ONE = Confidence.ONE_SOURCE
_UNVERIFIED = Confidence.UNVERIFIED


@dataclass(frozen=True, slots=True)
class Bit:
    """One bit or a bit range of a control or status word; ``meaning``: meaning of 1."""

    position: int
    name: str
    meaning: str
    width: int = 1
    signed: bool = False
    """A bit range that holds a two's complement number."""
    confidence: Confidence = Confidence.CONFIRMED

    @property
    def zero(self) -> str:
        """The meaning of 0, empty where ``meaning`` does not have it."""
        return self.meaning.partition("(0 = ")[2].removesuffix(")")

    @property
    def mask(self) -> int:
        return ((1 << self.width) - 1) << self.position

    def of(self, word: int) -> int:
        """The value of this field in a word."""
        value = (word & self.mask) >> self.position
        return value - (1 << self.width) if self.signed and value >> (self.width - 1) else value


SIGN_OF_LIFE = Bit(12, "SIGN_OF_LIFE", "sign of life counter 1..15", 4)

STW1_BITS = (
    Bit(0, "ON", "ON (0 = OFF1)"),
    Bit(1, "NO_COAST_STOP", "no coast stop (0 = OFF2)"),
    Bit(2, "NO_QUICK_STOP", "no quick stop (0 = OFF3)"),
    Bit(3, "ENABLE_OPERATION", "enable operation"),
    Bit(4, "ENABLE_RAMP_GENERATOR", "enable ramp generator"),
    Bit(5, "UNFREEZE_RAMP_GENERATOR", "unfreeze ramp generator"),
    Bit(6, "ENABLE_SETPOINT", "enable setpoint"),
    Bit(7, "FAULT_ACKNOWLEDGE", "fault acknowledge (rising edge)"),
    Bit(8, "JOG_1_ON", "jog 1"),
    Bit(9, "JOG_2_ON", "jog 2"),
    Bit(10, "CONTROL_BY_PLC", "control by PLC"),
    Bit(11, "DEVICE_11", "device specific (not used)"),
    Bit(12, "DEVICE_12", "device specific"),
    Bit(13, "DEVICE_13", "device specific"),
    Bit(14, "DEVICE_14", "device specific"),
    Bit(15, "DEVICE_15", "device specific"),
)
_USUAL = 0x043E
"""Bits of STW1 that a program keeps 1 from OFF to operation: no OFF2, no OFF3, STW1.3 to .5, control by PLC."""
_UPPER = 0xF000


def unswapped(word: int) -> int | None:
    """STW1 as the PLC means it if the two bytes of ``word`` are swapped; None if they are not."""
    meant = (word & 0xFF) << 8 | word >> 8
    usual = [value & (_USUAL | _UPPER) == _USUAL for value in (word, meant)]
    return meant if usual == [False, True] else None


STW1_POSITIONING = (
    Bit(4, "DO_NOT_REJECT", "do not reject traversing task"),
    Bit(5, "NO_INTERMEDIATE_STOP", "no intermediate stop"),
    Bit(6, "ACTIVATE_TASK", "activate traversing task (rising edge)"),
    Bit(11, "START_HOMING", "start homing procedure (0 = stop)"),
    Bit(12, "OPEN_BRAKE", "open the holding brake", confidence=_ONE),
    Bit(13, "EXTERNAL_BLOCK_CHANGE", "next block of a chain (rising edge)", confidence=_ONE),
)
ZSW1_BITS = (
    Bit(0, "READY_TO_SWITCH_ON", "ready to switch on"),
    Bit(1, "READY_TO_OPERATE", "ready to operate"),
    Bit(2, "OPERATION_ENABLED", "operation enabled"),
    Bit(3, "FAULT", "fault present"),
    Bit(4, "NO_COAST_STOP", "coast stop not activated"),
    Bit(5, "NO_QUICK_STOP", "quick stop not activated"),
    Bit(6, "SWITCHING_ON_INHIBITED", "switching on inhibited"),
    Bit(7, "WARNING", "warning present"),
    Bit(8, "WITHIN_TOLERANCE", "speed within tolerance of its demand value"),
    Bit(9, "CONTROL_REQUESTED", "control requested"),
    Bit(10, "TARGET_REACHED", "target speed reached"),
    Bit(11, "DEVICE_11", "device specific"),
    Bit(12, "DEVICE_12", "device specific"),
    Bit(13, "DEVICE_13", "device specific"),
    Bit(14, "DEVICE_14", "device specific"),
    Bit(15, "DEVICE_15", "device specific"),
)
ZSW1_POSITIONING = (
    Bit(8, "WITHIN_TOLERANCE", "following error within tolerance"),
    Bit(10, "TARGET_REACHED", "target position reached"),
    Bit(11, "HOME_POSITION_SET", "home position set"),
    Bit(12, "TASK_ACKNOWLEDGE", "traversing task acknowledge"),
    Bit(13, "DRIVE_STOPPED", "drive stopped"),
    Bit(14, "ACCELERATES", "axis accelerates", confidence=_ONE),
    Bit(15, "DECELERATES", "axis decelerates", confidence=_ONE),
)
G_STW_BITS = (
    Bit(0, "FUNCTION_1", "request function 1 (reference mark / measuring 1)"),
    Bit(1, "FUNCTION_2", "request function 2"),
    Bit(2, "FUNCTION_3", "request function 3"),
    Bit(3, "FUNCTION_4", "request function 4"),
    Bit(4, "COMMAND", "command 0 none, 1 activate, 2 read value, 3 abort", 3),
    Bit(7, "MODE", "mode 0 reference mark search, 1 measurement on the fly"),
    Bit(11, "PRESET_RELATIVE", "preset is relative (0 = absolute)"),
    Bit(12, "PRESET", "request preset (shift of the home position)"),
    Bit(13, "REQUEST_ABSOLUTE", "request the absolute value cyclically in XIST2"),
    Bit(14, "PARK", "park the sensor"),
    Bit(15, "ERROR_ACKNOWLEDGE", "acknowledge a sensor error"),
)
G_ZSW_BITS = (
    Bit(0, "FUNCTION_1", "function 1 active"),
    Bit(1, "FUNCTION_2", "function 2 active"),
    Bit(2, "FUNCTION_3", "function 3 active"),
    Bit(3, "FUNCTION_4", "function 4 active"),
    Bit(4, "VALUE_1", "value 1 available"),
    Bit(5, "VALUE_2", "value 2 available"),
    Bit(6, "VALUE_3", "value 3 available"),
    Bit(7, "VALUE_4", "value 4 available"),
    Bit(8, "PROBE_1", "probe 1 deflected"),
    Bit(9, "PROBE_2", "probe 2 deflected"),
    Bit(11, "ERROR_ACKNOWLEDGED", "error acknowledge being processed"),
    Bit(12, "PRESET_DONE", "preset executed"),
    Bit(13, "ABSOLUTE_VALID", "absolute value is transmitted in XIST2"),
    Bit(14, "PARKED", "sensor is parked"),
    Bit(15, "ERROR", "sensor error, code in XIST2"),
)

STW2_BITS = (
    Bit(0, "DATA_SET", "drive data set", 5),
    Bit(7, "PARK_AXIS", "park the axis"),
    Bit(8, "TO_FIXED_STOP", "move to the fixed stop"),
    SIGN_OF_LIFE,
)
ZSW2_BITS = (
    Bit(7, "PARKED", "axis is parked", confidence=_ONE),
    Bit(8, "TO_FIXED_STOP", "moving to the fixed stop"),
    Bit(10, "PULSES_ENABLED", "pulses enabled (another vendor: bit 11, not set)", confidence=_ONE),
    SIGN_OF_LIFE,
)
BLOCK_SELECTION = (Bit(0, "BLOCK", "traversing block", 6), Bit(15, "MDI", "MDI sub mode selected"))
BLOCK_ACTIVE = (Bit(0, "BLOCK", "active traversing block", 6), Bit(15, "MDI_ACTIVE", "MDI sub mode active"))
POS_STW1_BITS = (
    Bit(0, "BLOCK", "traversing block (Siemens: bits 0-5)", 7, confidence=_ONE),
    Bit(8, "ABSOLUTE", "absolute positioning (0 = relative)", confidence=_ONE),
    Bit(9, "POSITIVE_DIRECTION", "positive direction", confidence=_ONE),
    Bit(10, "NEGATIVE_DIRECTION", "negative direction", confidence=_ONE),
    Bit(12, "CONTINUOUS_UPDATE", "changed setpoints are taken without an edge", confidence=_ONE),
    Bit(14, "SETTING_UP", "setting up with a speed (0 = positioning)", confidence=_ONE),
    Bit(15, "MDI", "MDI sub mode selected (0 = traversing blocks)", confidence=_ONE),
)
POS_STW_BITS = (
    Bit(0, "TRACKING", "position setpoint follows the actual value", confidence=_ONE),
    Bit(1, "SET_REFERENCE_POINT", "set the reference point (rising edge)", confidence=_ONE),
    Bit(2, "REFERENCE_CAM", "reference cam reached", confidence=_ONE),
    Bit(5, "JOG_INCREMENTAL", "jog by a distance (0 = with a speed)", confidence=_ONE),
)
POS_STW2_BITS = (
    Bit(0, "TRACKING", "position setpoint follows the actual value"),
    Bit(1, "SET_REFERENCE_POINT", "set the reference point (rising edge)"),
    Bit(2, "REFERENCE_CAM", "reference cam reached", confidence=_ONE),
    Bit(5, "JOG_INCREMENTAL", "jog by a distance (0 = with a speed)"),
    Bit(8, "PASSIVE_HOMING", "homing on the fly (0 = search)", confidence=_UNVERIFIED),
    Bit(9, "HOMING_NEGATIVE", "homing starts in negative direction", confidence=_UNVERIFIED),
    Bit(10, "PROBE_2", "probe 2 (0 = probe 1)", confidence=_ONE),
    Bit(11, "PROBE_FALLING_EDGE", "falling edge of the probe (0 = rising)", confidence=_ONE),
    Bit(14, "SOFTWARE_LIMITS", "software limits are watched", confidence=_ONE),
    Bit(15, "HARDWARE_LIMITS", "hardware limits are watched", confidence=_ONE),
)
POS_ZSW1_BITS = (
    Bit(0, "BLOCK", "active traversing block, 0 for none or MDI", 7, confidence=_ONE),
    Bit(8, "NEGATIVE_HARDWARE_LIMIT", "negative hardware limit active", confidence=_ONE),
    Bit(9, "POSITIVE_HARDWARE_LIMIT", "positive hardware limit active", confidence=_ONE),
    Bit(10, "JOGGING", "jogging active", confidence=_ONE),
    Bit(11, "HOMING", "homing active", confidence=_ONE),
    Bit(12, "PASSIVE_HOMING", "homing on the fly active", confidence=_UNVERIFIED),
    Bit(13, "BLOCK_MODE", "traversing blocks active", confidence=_ONE),
    Bit(14, "SETTING_UP", "setting up active", confidence=_ONE),
    Bit(15, "MDI_ACTIVE", "MDI sub mode active", confidence=_ONE),
)
_MOTION_BITS = (
    Bit(0, "TRACKING", "tracking active"),
    Bit(1, "SPEED_LIMITED", "speed is limited"),
    Bit(2, "SETPOINT_STATIONARY", "setpoint is stationary"),
    Bit(4, "MOVES_FORWARD", "axis moves forward"),
    Bit(5, "MOVES_BACKWARD", "axis moves backward"),
    Bit(6, "SOFTWARE_LIMIT_MINUS", "negative software limit reached"),
    Bit(7, "SOFTWARE_LIMIT_PLUS", "positive software limit reached"),
)
POS_ZSW2_BITS = (
    *_MOTION_BITS[:3],
    Bit(3, "SETPOINT_REACHED", "position setpoint has reached the target", confidence=_ONE),
    *_MOTION_BITS[3:],
    Bit(8, "CAM_1", "position at or below cam 1", confidence=_ONE),
    Bit(9, "CAM_2", "position at or below cam 2", confidence=_ONE),
    Bit(10, "OUTPUT_1", "output 1 of the traversing blocks", confidence=_ONE),
    Bit(11, "OUTPUT_2", "output 2 of the traversing blocks", confidence=_ONE),
    Bit(12, "FIXED_STOP_REACHED", "fixed stop reached", confidence=_ONE),
    Bit(13, "CLAMPING_TORQUE_REACHED", "clamping torque reached", confidence=_ONE),
    Bit(14, "TO_FIXED_STOP", "moving to the fixed stop", confidence=_ONE),
    Bit(15, "TRAVERSING", "traversing command active", confidence=_ONE),
)
POS_ZSW_BITS = (
    *(replace(bit, confidence=_ONE) for bit in _MOTION_BITS[:3]),
    Bit(3, "TARGET_REACHED", "target position reached", confidence=_ONE),
    *(replace(bit, confidence=_ONE) for bit in _MOTION_BITS[3:]),
)
MELDW_BITS = (
    Bit(0, "RAMP_COMPLETED", "ramp-up or ramp-down completed", confidence=_ONE),
    Bit(1, "TORQUE_BELOW_THRESHOLD", "torque below its threshold", confidence=_ONE),
    Bit(2, "SPEED_BELOW_THRESHOLD_3", "speed below threshold 3", confidence=_ONE),
    Bit(3, "SPEED_BELOW_THRESHOLD_2", "speed at or below threshold 2", confidence=_ONE),
    Bit(5, "VARIABLE_MESSAGE", "variable message function", confidence=_ONE),
    Bit(6, "NO_MOTOR_OVERTEMPERATURE", "no overtemperature of the motor", confidence=_ONE),
    Bit(7, "NO_POWER_STAGE_OVERTEMPERATURE", "no overtemperature of the power stage", confidence=_ONE),
    Bit(8, "SPEED_WITHIN_TOLERANCE", "speed deviation within tolerance", confidence=_ONE),
    Bit(11, "CONTROLLER_ENABLED", "controller enabled", confidence=_ONE),
    Bit(12, "DRIVE_READY", "drive ready", confidence=_ONE),
    Bit(13, "PULSES_ENABLED", "pulses enabled", confidence=_ONE),
)
