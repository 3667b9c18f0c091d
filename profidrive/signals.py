"""The signal catalogue: every word of the cyclic telegrams, declared once.

Source: PROFIdrive profile 4.1 chapter 6.3, PROFIdrive encoder profile 4.1, the manufacturer's guide chapters
4.3 and 6; words of telegrams 4-6, 102-106, 110 and 111 from public manuals of drives and a public master, each with the
``Confidence`` it deserves. Left out: signals no telegram of this project carries, and supplementary telegrams.

Codec, decoder, simulator, test strategies, scapy layers and documentation ask this table for names, types and
bits; nothing else gives a bit a number.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from pdgw.profidrive.datatypes import N2_100_PERCENT, N4_100_PERCENT, DataType
from pdgw.profidrive.errors import ProfidriveError


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
    """One bit or a bit range of a control or status word; ``meaning`` tells what 1 stands for."""

    position: int
    name: str
    meaning: str
    width: int = 1
    signed: bool = False
    """A bit range that holds a two's complement number."""
    confidence: Confidence = Confidence.CONFIRMED

    @property
    def mask(self) -> int:
        return ((1 << self.width) - 1) << self.position

    def of(self, word: int) -> int:
        """The value of this field in a word."""
        value = (word & self.mask) >> self.position
        return value - (1 << self.width) if self.signed and value >> (self.width - 1) else value


@dataclass(frozen=True, slots=True)
class Signal:
    """A signal of a telegram.

    ``number`` is the PROFIdrive signal number (0 for manufacturer signals without one); ``unit`` the physical
    unit, ``%`` for normalised fractions; ``bits`` the fields of a word; ``positioning_bits`` those whose meaning
    differs in the positioning telegrams (7, 9, 110, 111).
    """

    name: str
    number: int
    type: DataType
    description: str
    unit: str = ""
    bits: tuple[Bit, ...] = ()
    positioning_bits: tuple[Bit, ...] = ()
    confidence: Confidence = Confidence.CONFIRMED

    @property
    def words(self) -> int:
        """16-bit words this signal occupies."""
        return max(1, self.type.size // 2)

    @property
    def identifier(self) -> str:
        """The name as a Python identifier, lower case."""
        return self.name.lower().replace(" ", "_").replace("-", "_")

    def bit(self, name: str, *, positioning: bool = False) -> Bit:
        """The bit with this name; ProfidriveError where there is none."""
        for bit in self.fields(positioning=positioning):
            if bit.name == name:
                return bit
        raise ProfidriveError(f"bit of {self.name}", name, "one of " + ", ".join(b.name for b in self.bits))

    def fields(self, *, positioning: bool = False) -> Iterator[Bit]:
        """The bits in ascending order, with the positioning meanings where asked."""
        if not positioning or not self.positioning_bits:
            yield from self.bits
            return
        overrides = {bit.position: bit for bit in self.positioning_bits}
        positions = {bit.position: bit for bit in self.bits} | overrides
        for position in sorted(positions):
            yield positions[position]

    def word(self, *names: str, positioning: bool = False) -> int:
        """A word with these bits set, all others 0; ProfidriveError for a name that is no bit of it."""
        word = 0
        for name in names:
            word |= self.bit(name, positioning=positioning).mask
        return word

    def percent(self, raw: int) -> float | None:
        """The value in percent of its reference for N2/N4 signals, None for the others."""
        full_scale = _FULL_SCALE.get(self.type)
        return None if full_scale is None else raw * 100 / full_scale

    def raw(self, percent: float) -> int:
        """The wire value nearest to a percentage; ProfidriveError for a signal that is no N2 or N4, or one out of its range."""
        full_scale = _FULL_SCALE.get(self.type)
        if full_scale is None:
            raise ProfidriveError(
                f"percent of {self.name}", percent, f"a signal of type N2 or N4, not {self.type.name}"
            )
        low, high = self.type.integer_range
        value = percent * full_scale / 100
        if not low <= value <= high:
            raise ProfidriveError(
                f"{self.name} in percent", percent, f"{low * 100 / full_scale:g} to below {-low * 100 / full_scale:g}"
            )
        return round(value)


_FULL_SCALE = {DataType.N2: N2_100_PERCENT, DataType.N4: N4_100_PERCENT}

_SIGN_OF_LIFE = Bit(12, "SIGN_OF_LIFE", "sign of life counter 1..15", 4)

_STW1_BITS = (
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
_STW1_POSITIONING = (
    Bit(4, "DO_NOT_REJECT", "do not reject traversing task"),
    Bit(5, "NO_INTERMEDIATE_STOP", "no intermediate stop"),
    Bit(6, "ACTIVATE_TASK", "activate traversing task (rising edge)"),
    Bit(11, "START_HOMING", "start homing procedure (0 = stop)"),
    Bit(12, "OPEN_BRAKE", "open the holding brake", confidence=_ONE),
    Bit(13, "EXTERNAL_BLOCK_CHANGE", "next block of a chain (rising edge)", confidence=_ONE),
)
_ZSW1_BITS = (
    Bit(0, "READY_TO_SWITCH_ON", "ready to switch on"),
    Bit(1, "READY_TO_OPERATE", "ready to operate"),
    Bit(2, "OPERATION_ENABLED", "operation enabled"),
    Bit(3, "FAULT", "fault present"),
    Bit(4, "NO_COAST_STOP", "coast stop not activated"),
    Bit(5, "NO_QUICK_STOP", "quick stop not activated"),
    Bit(6, "SWITCHING_ON_INHIBITED", "switching on inhibited"),
    Bit(7, "WARNING", "warning present"),
    Bit(8, "WITHIN_TOLERANCE", "speed error within tolerance (telegrams with MELDW)"),
    Bit(9, "CONTROL_REQUESTED", "control requested"),
    Bit(10, "TARGET_REACHED", "target speed reached"),
    Bit(11, "DEVICE_11", "device specific"),
    Bit(12, "DEVICE_12", "device specific"),
    Bit(13, "DEVICE_13", "device specific"),
    Bit(14, "DEVICE_14", "device specific"),
    Bit(15, "DEVICE_15", "device specific"),
)
_ZSW1_POSITIONING = (
    Bit(8, "WITHIN_TOLERANCE", "following error within tolerance (not used)"),
    Bit(10, "TARGET_REACHED", "target position reached"),
    Bit(11, "HOME_POSITION_SET", "home position set"),
    Bit(12, "TASK_ACKNOWLEDGE", "traversing task acknowledge"),
    Bit(13, "DRIVE_STOPPED", "drive stopped"),
    Bit(14, "ACCELERATES", "axis accelerates", confidence=_ONE),
    Bit(15, "DECELERATES", "axis decelerates", confidence=_ONE),
)
_G_STW_BITS = (
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
_G_ZSW_BITS = (
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

_STW2_BITS = (
    Bit(0, "DATA_SET", "drive data set", 5),
    Bit(7, "PARK_AXIS", "park the axis"),
    Bit(8, "TO_FIXED_STOP", "move to the fixed stop"),
    _SIGN_OF_LIFE,
)
_ZSW2_BITS = (
    Bit(7, "PARKED", "axis is parked", confidence=_ONE),
    Bit(8, "TO_FIXED_STOP", "moving to the fixed stop"),
    Bit(10, "PULSES_ENABLED", "pulses enabled (another vendor: bit 11, not set)", confidence=_ONE),
    _SIGN_OF_LIFE,
)
_BLOCK_SELECTION = (Bit(0, "BLOCK", "traversing block", 6), Bit(15, "MDI", "MDI sub mode selected"))
_BLOCK_ACTIVE = (Bit(0, "BLOCK", "active traversing block", 6), Bit(15, "MDI_ACTIVE", "MDI sub mode active"))
_POS_STW1_BITS = (
    Bit(0, "BLOCK", "traversing block (Siemens: bits 0-5)", 7, confidence=_ONE),
    Bit(8, "ABSOLUTE", "absolute positioning (0 = relative)", confidence=_ONE),
    Bit(9, "POSITIVE_DIRECTION", "positive direction", confidence=_ONE),
    Bit(10, "NEGATIVE_DIRECTION", "negative direction", confidence=_ONE),
    Bit(12, "CONTINUOUS_UPDATE", "changed setpoints are taken without an edge", confidence=_ONE),
    Bit(14, "SETTING_UP", "setting up with a speed (0 = positioning)", confidence=_ONE),
    Bit(15, "MDI", "MDI sub mode selected (0 = traversing blocks)", confidence=_ONE),
)
_POS_STW_BITS = (
    Bit(0, "TRACKING", "position setpoint follows the actual value", confidence=_ONE),
    Bit(1, "SET_REFERENCE_POINT", "set the reference point (rising edge)", confidence=_ONE),
    Bit(2, "REFERENCE_CAM", "reference cam reached", confidence=_ONE),
    Bit(5, "JOG_INCREMENTAL", "jog by a distance (0 = with a speed)", confidence=_ONE),
)
_POS_STW2_BITS = (
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
_POS_ZSW1_BITS = (
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
_POS_ZSW2_BITS = (
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
_POS_ZSW_BITS = (
    *(replace(bit, confidence=_ONE) for bit in _MOTION_BITS[:3]),
    Bit(3, "TARGET_REACHED", "target position reached", confidence=_ONE),
    *(replace(bit, confidence=_ONE) for bit in _MOTION_BITS[3:]),
)
_MELDW_BITS = (
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

_U16 = DataType.UNSIGNED16
_U32 = DataType.UNSIGNED32
_I16 = DataType.INTEGER16
_I32 = DataType.INTEGER32
_V2 = DataType.V2
_N2 = DataType.N2
_N4 = DataType.N4

CATALOGUE: tuple[Signal, ...] = (
    Signal("STW1", 1, _V2, "control word 1", "", _STW1_BITS, _STW1_POSITIONING),
    Signal("ZSW1", 2, _V2, "status word 1", "", _ZSW1_BITS, _ZSW1_POSITIONING),
    Signal("STW2", 3, _V2, "control word 2", "", _STW2_BITS),
    Signal("ZSW2", 4, _V2, "status word 2", "", _ZSW2_BITS),
    Signal("NSOLL_A", 5, _N2, "speed setpoint A", "%"),
    Signal("NIST_A", 6, _N2, "speed actual value A", "%"),
    Signal("NSOLL_B", 7, _N4, "speed setpoint B", "%"),
    Signal("NIST_B", 8, _N4, "speed actual value B", "%"),
    Signal("G1_STW", 9, _V2, "sensor 1 control word", "", _G_STW_BITS),
    Signal("G1_ZSW", 10, _V2, "sensor 1 status word", "", _G_ZSW_BITS),
    Signal("G1_XIST1", 11, _U32, "sensor 1 position actual value 1", "increments"),
    Signal("G1_XIST2", 12, _U32, "sensor 1 position actual value 2 or error code", "increments"),
    Signal("G2_STW", 13, _V2, "sensor 2 control word", "", _G_STW_BITS, confidence=_UNVERIFIED),
    Signal("G2_ZSW", 14, _V2, "sensor 2 status word", "", _G_ZSW_BITS, confidence=_UNVERIFIED),
    Signal("G2_XIST1", 15, _U32, "sensor 2 position actual value 1", "increments", confidence=_UNVERIFIED),
    Signal(
        "G2_XIST2", 16, _U32, "sensor 2 position actual value 2 or error code", "increments", confidence=_UNVERIFIED
    ),
    # In the units of G1_XIST1 with its fine resolution.
    Signal("XERR", 25, _I32, "position error of the controller in the PLC", "increments", confidence=_UNVERIFIED),
    Signal("KPC", 26, _I32, "gain of the position controller, 0 = DSC off", "0.001/s", confidence=_UNVERIFIED),
    Signal("XIST_A", 28, _N4, "position actual value A", "%"),
    Signal(
        "SATZANW",
        32,
        _V2,
        "traversing block selection",
        "",
        (
            Bit(0, "HOMING_METHOD", "homing method", 8, signed=True),
            Bit(15, "MDI", "MDI sub mode selected"),
        ),
    ),
    Signal(
        "AKTSATZ",
        33,
        _V2,
        "traversing block active",
        "",
        (
            Bit(0, "HOMING_METHOD", "actual homing method", 8, signed=True),
            Bit(15, "MDI_ACTIVE", "MDI sub mode active"),
        ),
    ),
    Signal("MDI_TARPOS", 34, _N4, "MDI target position", "%"),
    Signal("MDI_VELOCITY", 35, _N4, "MDI velocity", "%"),
    Signal("MDI_ACC", 36, _N2, "MDI acceleration", "%"),
    Signal("MDI_DEC", 37, _N2, "MDI deceleration", "%"),
    Signal(
        "MDI_MOD",
        38,
        _V2,
        "MDI mode",
        "",
        (
            Bit(0, "ABSOLUTE", "absolute positioning (0 = relative)"),
            Bit(1, "POSITIVE_DIRECTION", "modulo axis: positive direction"),
            Bit(2, "NEGATIVE_DIRECTION", "modulo axis: negative direction"),
        ),
    ),
    Signal("IAIST_GLATT", 51, _N2, "current actual value, smoothed", "%"),
    Signal("MIST_GLATT", 53, _N2, "torque actual value, smoothed", "%"),
    Signal("PIST_GLATT", 54, _N2, "power actual value, smoothed", "%"),
    Signal("NIST_A_GLATT", 57, _N2, "speed actual value A, smoothed", "%"),
    Signal(
        "MELD_NAMUR",
        58,
        _V2,
        "VIK-NAMUR message bits",
        "",
        (
            Bit(0, "CONVERTER", "fault of the control unit"),
            Bit(1, "LINE", "line fault: phase or voltage"),
            Bit(2, "DC_LINK_OVERVOLTAGE", "overvoltage of the DC link"),
            Bit(3, "POWER_UNIT", "fault of the power unit"),
            Bit(4, "OVERTEMPERATURE", "overtemperature of the converter"),
            Bit(5, "GROUND_FAULT", "ground fault of cable or motor"),
            Bit(6, "MOTOR_OVERLOAD", "motor overload"),
            Bit(7, "COMMUNICATION", "communication with the controller"),
            Bit(8, "SAFETY", "safety monitoring (not set)"),
            Bit(10, "INTERNAL_COMMUNICATION", "communication inside the converter (not set)"),
            Bit(11, "LINE_SYSTEM", "line system (not set)"),
            Bit(15, "OTHER", "other fault"),
        ),
    ),
    Signal(
        "STW2_ENC",
        80,
        _V2,
        "encoder control word 2",
        "",
        (
            Bit(7, "FAULT_ACKNOWLEDGE", "fault acknowledge (rising edge)"),
            Bit(10, "CONTROL_BY_PLC", "control by PLC"),
            _SIGN_OF_LIFE,
        ),
    ),
    Signal(
        "ZSW2_ENC",
        81,
        _V2,
        "encoder status word 2",
        "",
        (
            Bit(3, "FAULT", "fault present"),
            Bit(7, "WARNING", "warning present"),
            Bit(9, "CONTROL_REQUESTED", "control requested"),
            _SIGN_OF_LIFE,
        ),
    ),
    Signal("MOMRED", 101, _N2, "torque reduction, 100 % = no torque", "%", confidence=_UNVERIFIED),
    Signal("MELDW", 102, _V2, "message word", "", _MELDW_BITS),
    Signal("POS_STW", 203, _V2, "positioner control word of telegram 110", "", _POS_STW_BITS, confidence=_ONE),
    Signal("POS_ZSW", 204, _V2, "positioner status word of telegram 110", "", _POS_ZSW_BITS, confidence=_ONE),
    Signal("OVERRIDE", 205, _N2, "override of the speed, negative = 0", "%"),
    Signal("POS_STW1", 220, _V2, "positioner control word 1", "", _POS_STW1_BITS),
    Signal("POS_ZSW1", 221, _V2, "positioner status word 1", "", _POS_ZSW1_BITS),
    Signal("POS_STW2", 222, _V2, "positioner control word 2", "", _POS_STW2_BITS),
    Signal("POS_ZSW2", 223, _V2, "positioner status word 2", "", _POS_ZSW2_BITS),
    Signal("FAULT_CODE", 301, _U16, "number of the first fault that stands (P947)"),
    Signal("WARN_CODE", 303, _U16, "number of the first warning (P953)"),
    Signal("USER", 0, _U16, "for the user"),
    Signal("G1_XIST3", 84, DataType.UNSIGNED64, "sensor 1 position actual value 3", "increments"),
    # Telegram 100 of the manufacturer: values pass unchanged, names as its guide spells them.
    Signal("Controlword", 0, _U16, "Controlword"),
    Signal(
        "Modes of Operation",
        0,
        _U16,
        "modes of operation",
        "",
        (Bit(0, "MODE", "mode of operation", 8, signed=True), Bit(8, "RESERVED", "reserved, 0", 8)),
    ),
    Signal("Target Torque", 0, _I16, "target torque", "1/1000 rated current"),
    Signal("Target Position", 0, _I32, "target position", "increments"),
    Signal("Profile Velocity", 0, _U32, "profile velocity", "velocity units"),
    Signal("Profile Acceleration", 0, _U32, "profile acceleration", "10 rpm/s"),
    Signal("Profile Deceleration", 0, _U32, "profile deceleration", "10 rpm/s"),
    Signal("Dynamic Speed Limit", 0, _U16, "dynamic speed limit", "0.5 rpm"),
    Signal("Dynamic Torque Limit", 0, _U16, "dynamic torque limit", "1/1000 rated current"),
    Signal("Digital Outputs", 0, _U32, "physical outputs"),
    Signal("Digital Outputs Mask", 0, _U32, "bit mask of the outputs under user control"),
    Signal("Target Velocity", 0, _I32, "target velocity", "velocity units"),
    Signal("Statusword", 0, _U16, "Statusword"),
    Signal(
        "Modes of Operation Display",
        0,
        _U16,
        "modes of operation display",
        "",
        (Bit(0, "MODE", "mode of operation", 8, signed=True), Bit(8, "RESERVED", "0", 8)),
    ),
    Signal("Position Actual Value", 0, _I32, "position actual value", "increments"),
    Signal("Velocity Demand Value", 0, _I32, "velocity demand value", "velocity units"),
    Signal("Velocity Actual Value", 0, _I32, "velocity actual value", "velocity units"),
    Signal("Current Actual Value", 0, _I16, "current actual value", "1/1000 rated current"),
    Signal("DC-link Circuit Voltage", 0, _U32, "DC-link circuit voltage", "mV"),
    Signal("Digital Inputs", 0, _U32, "digital inputs"),
    Signal("Analogue Input 1", 0, _I16, "analogue input AI1", "10/32767 V"),
    Signal("Analogue Input 2", 0, _I16, "analogue input AI2", "10/32767 V"),
    Signal("Encoder Position Value", 0, _I16, "incremental encoder counter", "increments"),
    Signal("Error Code", 0, _U16, "manufacturer's error number"),
)

SIGNALS: MappingProxyType[str, Signal] = MappingProxyType({signal.name: signal for signal in CATALOGUE})
"""Every signal by name."""

POSITIONER_FORMS: Mapping[str, Signal] = MappingProxyType(
    {
        form.name: form
        for form in (
            Signal("XIST_A", 28, _I32, "position actual value A", "LU"),
            Signal("SATZANW", 32, _V2, "traversing block selection", "", _BLOCK_SELECTION),
            Signal("AKTSATZ", 33, _V2, "traversing block active", "", _BLOCK_ACTIVE),
            Signal("MDI_TARPOS", 34, _I32, "MDI target position", "LU"),
            Signal("MDI_VELOCITY", 35, _U32, "MDI velocity", "1000 LU/min", confidence=_UNVERIFIED),
        )
    }
)
"""What telegrams 7, 110 and 111 carry under a name of the catalogue: positions in length units (LU) instead of fractions of a
reference, and block numbers where telegram 9 has the manufacturer's homing method."""


def signal(name: str) -> Signal:
    """The signal with this name; ProfidriveError where there is none."""
    try:
        return SIGNALS[name]
    except KeyError:
        raise ProfidriveError("signal", name, "a name of the signal catalogue") from None
