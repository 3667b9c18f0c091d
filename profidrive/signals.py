"""The signal catalogue: every word of the cyclic telegrams, declared once.

Source: PROFIdrive profile 4.1 chapter 6.3, PROFIdrive encoder profile 4.1, the manufacturer's guide chapters 4.3 and 6; words
of telegrams 4-6, 102-106, 110 and 111 from public manuals of drives and a public master, each with its ``Confidence``. Not
here: signals that no telegram of this project carries, and supplementary telegrams. Codec, decoder, simulator, test
strategies, scapy layers and documentation use this table for names, types and bits; ``words`` declares the bits.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pdgw.profidrive.datatypes import N2_100_PERCENT, N4_100_PERCENT, DataType, float_of
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.words import (
    BLOCK_ACTIVE,
    BLOCK_SELECTION,
    G_STW_BITS,
    G_ZSW_BITS,
    MELDW_BITS,
    POS_STW1_BITS,
    POS_STW2_BITS,
    POS_STW_BITS,
    POS_ZSW1_BITS,
    POS_ZSW2_BITS,
    POS_ZSW_BITS,
    SIGN_OF_LIFE,
    STW1_BITS,
    STW1_POSITIONING,
    STW2_BITS,
    ZSW1_BITS,
    ZSW1_POSITIONING,
    ZSW2_BITS,
    Bit,
    Confidence,
)


class SignalQuantity(enum.Enum):
    """Quantity of a signal; the value is its name in messages and pictures."""

    SPEED = "speed"
    MOTION_VELOCITY = "velocity of a motion task"
    ACCELERATION = "acceleration"
    DECELERATION = "deceleration"
    POSITION = "position"
    POSITION_ERROR = "position error"
    OVERRIDE = "override"
    CURRENT = "current"
    TORQUE = "torque"
    TORQUE_REDUCTION = "torque reduction"
    POWER = "power"
    VOLTAGE = "voltage"


@dataclass(frozen=True, slots=True)
class Signal:
    """A signal of a telegram.

    ``number`` is the PROFIdrive signal number (0 for manufacturer signals without one); ``quantity`` what the value
    measures, None for words and numbers that measure nothing; ``unit`` the physical unit, ``%`` for a normalised
    fraction of the quantity's reference; ``bits`` the fields of a word; ``positioning_bits`` those whose meaning
    differs in the positioning telegrams (7, 9, 110 to 112). ``is_float``: the raw value is the bit pattern of an
    IEEE 754 number. ``is_word``: bits whose meaning the telegram does not define, for a reader hexadecimal.
    """

    name: str
    number: int
    type: DataType
    description: str
    unit: str = ""
    bits: tuple[Bit, ...] = ()
    positioning_bits: tuple[Bit, ...] = ()
    confidence: Confidence = Confidence.CONFIRMED
    is_float: bool = False
    quantity: SignalQuantity | None = None
    is_word: bool = False

    def __repr__(self) -> str:
        return f"<Signal {self.name} ({self.type.name}): {self.description}>"

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
        """The bits in ascending order, on request with the positioning meanings."""
        if not positioning or not self.positioning_bits:
            yield from self.bits
            return
        overrides = {bit.position: bit for bit in self.positioning_bits}
        positions = {bit.position: bit for bit in self.bits} | overrides
        for position in sorted(positions):
            yield positions[position]

    def word(self, *names: str, positioning: bool = False) -> int:
        """A word with these bits set, all others 0; ProfidriveError for an unknown name."""
        word = 0
        for name in names:
            word |= self.bit(name, positioning=positioning).mask
        return word

    def value_of(self, raw: int) -> int | float:
        """The value of a raw one: for a float the number of its bit pattern, else the raw value."""
        return float_of(raw) if self.is_float else raw

    def percent(self, raw: int) -> float | None:
        """The value in percent of its reference for N2/N4 signals, None for the others."""
        full_scale = _FULL_SCALE.get(self.type)
        return None if full_scale is None else raw * 100 / full_scale

    def raw(self, percent: float) -> int:
        """The wire value nearest to a percentage; ProfidriveError for a signal other than N2 or N4, or one out of its range."""
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

_U16 = DataType.UNSIGNED16
_U32 = DataType.UNSIGNED32
_I16 = DataType.INTEGER16
_I32 = DataType.INTEGER32
_V2 = DataType.V2
_N2 = DataType.N2
_N4 = DataType.N4


def _float(name: str, description: str, unit: str, quantity: SignalQuantity) -> Signal:
    return Signal(name, 0, _U32, description, unit, confidence=Confidence.UNVERIFIED, is_float=True, quantity=quantity)


USER_WORDS = ("USER", "USER_2", "USER_3", "USER_4", "USER_5", "USER_6")
"""Words without a meaning for the gateway; a user's own telegram may have several."""
CATALOGUE: tuple[Signal, ...] = (
    Signal("STW1", 1, _V2, "control word 1", "", STW1_BITS, STW1_POSITIONING),
    Signal("ZSW1", 2, _V2, "status word 1", "", ZSW1_BITS, ZSW1_POSITIONING),
    Signal("STW2", 3, _V2, "control word 2", "", STW2_BITS),
    Signal("ZSW2", 4, _V2, "status word 2", "", ZSW2_BITS),
    Signal("NSOLL_A", 5, _N2, "speed setpoint A", "%", quantity=SignalQuantity.SPEED),
    Signal("NIST_A", 6, _N2, "speed actual value A", "%", quantity=SignalQuantity.SPEED),
    Signal("NSOLL_B", 7, _N4, "speed setpoint B", "%", quantity=SignalQuantity.SPEED),
    Signal("NIST_B", 8, _N4, "speed actual value B", "%", quantity=SignalQuantity.SPEED),
    Signal("G1_STW", 9, _V2, "sensor 1 control word", "", G_STW_BITS),
    Signal("G1_ZSW", 10, _V2, "sensor 1 status word", "", G_ZSW_BITS),
    Signal("G1_XIST1", 11, _U32, "sensor 1 position actual value 1", "increments", quantity=SignalQuantity.POSITION),
    Signal(
        "G1_XIST2",
        12,
        _U32,
        "sensor 1 position actual value 2 or error code",
        "increments",
        quantity=SignalQuantity.POSITION,
    ),
    Signal("G2_STW", 13, _V2, "sensor 2 control word", "", G_STW_BITS, confidence=Confidence.UNVERIFIED),
    Signal("G2_ZSW", 14, _V2, "sensor 2 status word", "", G_ZSW_BITS, confidence=Confidence.UNVERIFIED),
    Signal(
        "G2_XIST1",
        15,
        _U32,
        "sensor 2 position actual value 1",
        "increments",
        confidence=Confidence.UNVERIFIED,
        quantity=SignalQuantity.POSITION,
    ),
    Signal(
        "G2_XIST2",
        16,
        _U32,
        "sensor 2 position actual value 2 or error code",
        "increments",
        confidence=Confidence.UNVERIFIED,
        quantity=SignalQuantity.POSITION,
    ),
    # In the units of G1_XIST1 with its fine resolution.
    Signal(
        "XERR",
        25,
        _I32,
        "position error of the controller in the PLC",
        "increments",
        confidence=Confidence.UNVERIFIED,
        quantity=SignalQuantity.POSITION_ERROR,
    ),
    Signal(
        "KPC", 26, _I32, "gain of the position controller, 0 = DSC off", "0.001/s", confidence=Confidence.UNVERIFIED
    ),
    Signal("XIST_A", 28, _N4, "position actual value A", "%", quantity=SignalQuantity.POSITION),
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
    Signal("MDI_TARPOS", 34, _N4, "MDI target position", "%", quantity=SignalQuantity.POSITION),
    Signal("MDI_VELOCITY", 35, _N4, "MDI velocity", "%", quantity=SignalQuantity.MOTION_VELOCITY),
    Signal("MDI_ACC", 36, _N2, "MDI acceleration", "%", quantity=SignalQuantity.ACCELERATION),
    Signal("MDI_DEC", 37, _N2, "MDI deceleration", "%", quantity=SignalQuantity.DECELERATION),
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
    Signal("IAIST_GLATT", 51, _N2, "current actual value, smoothed", "%", quantity=SignalQuantity.CURRENT),
    Signal("MIST_GLATT", 53, _N2, "torque actual value, smoothed", "%", quantity=SignalQuantity.TORQUE),
    Signal("PIST_GLATT", 54, _N2, "power actual value, smoothed", "%", quantity=SignalQuantity.POWER),
    Signal("NIST_A_GLATT", 57, _N2, "speed actual value A, smoothed", "%", quantity=SignalQuantity.SPEED),
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
            SIGN_OF_LIFE,
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
            SIGN_OF_LIFE,
        ),
    ),
    Signal(
        "MOMRED",
        101,
        _N2,
        "torque reduction, 100 % = no torque",
        "%",
        confidence=Confidence.UNVERIFIED,
        quantity=SignalQuantity.TORQUE_REDUCTION,
    ),
    Signal("MELDW", 102, _V2, "message word", "", MELDW_BITS),
    Signal(
        "POS_STW",
        203,
        _V2,
        "positioner control word of telegram 110",
        "",
        POS_STW_BITS,
        confidence=Confidence.ONE_SOURCE,
    ),
    Signal(
        "POS_ZSW",
        204,
        _V2,
        "positioner status word of telegram 110",
        "",
        POS_ZSW_BITS,
        confidence=Confidence.ONE_SOURCE,
    ),
    Signal("OVERRIDE", 205, _N2, "override of the speed, negative = 0", "%", quantity=SignalQuantity.OVERRIDE),
    Signal("POS_STW1", 220, _V2, "positioner control word 1", "", POS_STW1_BITS),
    Signal("POS_ZSW1", 221, _V2, "positioner status word 1", "", POS_ZSW1_BITS),
    Signal("POS_STW2", 222, _V2, "positioner control word 2", "", POS_STW2_BITS),
    Signal("POS_ZSW2", 223, _V2, "positioner status word 2", "", POS_ZSW2_BITS),
    Signal("FAULT_CODE", 301, _U16, "number of the first active fault (P947)"),
    Signal("WARN_CODE", 303, _U16, "number of the first warning (P953)"),
    *(Signal(name, 0, _U16, "for the user") for name in USER_WORDS),
    # Telegram 112: numbers in a unit of length that the user selects. Two sources confirm the layout, none the units.
    _float("MDI_TARPOS_F", "MDI target position", "unit of length", SignalQuantity.POSITION),
    _float("MDI_VELOCITY_F", "MDI velocity", "unit of length per minute or second", SignalQuantity.MOTION_VELOCITY),
    _float("MDI_ACC_F", "MDI acceleration", "% of max_acceleration", SignalQuantity.ACCELERATION),
    _float("MDI_DEC_F", "MDI deceleration", "% of max_deceleration", SignalQuantity.DECELERATION),
    _float("REF_COORDINATE", "position of the reference point", "unit of length", SignalQuantity.POSITION),
    _float("XIST_F", "position actual value", "unit of length", SignalQuantity.POSITION),
    _float("VIST_F", "velocity actual value", "unit of length per minute or second", SignalQuantity.MOTION_VELOCITY),
    Signal("RESERVED", 0, _U16, "reserved, 0"),
    Signal("RESERVED_2", 0, _U32, "reserved, 0"),
    Signal(
        "G1_XIST3",
        84,
        DataType.UNSIGNED64,
        "sensor 1 position actual value 3",
        "increments",
        quantity=SignalQuantity.POSITION,
    ),
    # Telegram 100 of the manufacturer: values pass unchanged, names as in its guide.
    Signal("Controlword", 0, _U16, "Controlword", is_word=True),
    Signal(
        "Modes of Operation",
        0,
        _U16,
        "modes of operation",
        "",
        (Bit(0, "MODE", "mode of operation", 8, signed=True), Bit(8, "RESERVED", "reserved, 0", 8)),
    ),
    Signal("Target Torque", 0, _I16, "target torque", "1/1000 rated current", quantity=SignalQuantity.TORQUE),
    Signal("Target Position", 0, _I32, "target position", "increments", quantity=SignalQuantity.POSITION),
    Signal("Profile Velocity", 0, _U32, "profile velocity", "velocity units", quantity=SignalQuantity.MOTION_VELOCITY),
    Signal("Profile Acceleration", 0, _U32, "profile acceleration", "10 rpm/s", quantity=SignalQuantity.ACCELERATION),
    Signal("Profile Deceleration", 0, _U32, "profile deceleration", "10 rpm/s", quantity=SignalQuantity.DECELERATION),
    Signal("Dynamic Speed Limit", 0, _U16, "dynamic speed limit", "0.5 rpm"),
    Signal("Dynamic Torque Limit", 0, _U16, "dynamic torque limit", "1/1000 rated current"),
    Signal("Digital Outputs", 0, _U32, "physical outputs", is_word=True),
    Signal("Digital Outputs Mask", 0, _U32, "bit mask of the outputs under user control", is_word=True),
    Signal("Target Velocity", 0, _I32, "target velocity", "velocity units", quantity=SignalQuantity.SPEED),
    Signal("Statusword", 0, _U16, "Statusword", is_word=True),
    Signal(
        "Modes of Operation Display",
        0,
        _U16,
        "modes of operation display",
        "",
        (Bit(0, "MODE", "mode of operation", 8, signed=True), Bit(8, "RESERVED", "0", 8)),
    ),
    Signal("Position Actual Value", 0, _I32, "position actual value", "increments", quantity=SignalQuantity.POSITION),
    Signal("Velocity Demand Value", 0, _I32, "velocity demand value", "velocity units", quantity=SignalQuantity.SPEED),
    Signal("Velocity Actual Value", 0, _I32, "velocity actual value", "velocity units", quantity=SignalQuantity.SPEED),
    Signal(
        "Current Actual Value", 0, _I16, "current actual value", "1/1000 rated current", quantity=SignalQuantity.CURRENT
    ),
    Signal("DC-link Circuit Voltage", 0, _U32, "DC-link circuit voltage", "mV", quantity=SignalQuantity.VOLTAGE),
    Signal("Digital Inputs", 0, _U32, "digital inputs", is_word=True),
    Signal("Analogue Input 1", 0, _I16, "analogue input AI1", "10/32767 V", quantity=SignalQuantity.VOLTAGE),
    Signal("Analogue Input 2", 0, _I16, "analogue input AI2", "10/32767 V", quantity=SignalQuantity.VOLTAGE),
    Signal(
        "Encoder Position Value", 0, _I16, "incremental encoder counter", "increments", quantity=SignalQuantity.POSITION
    ),
    Signal("Error Code", 0, _U16, "manufacturer's error number"),
)

SIGNALS: MappingProxyType[str, Signal] = MappingProxyType({signal.name: signal for signal in CATALOGUE})
"""Every signal by name."""

POSITIONER_FORMS: Mapping[str, Signal] = MappingProxyType(
    {
        form.name: form
        for form in (
            Signal("XIST_A", 28, _I32, "position actual value A", "LU", quantity=SignalQuantity.POSITION),
            Signal("SATZANW", 32, _V2, "traversing block selection", "", BLOCK_SELECTION),
            Signal("AKTSATZ", 33, _V2, "traversing block active", "", BLOCK_ACTIVE),
            Signal("MDI_TARPOS", 34, _I32, "MDI target position", "LU", quantity=SignalQuantity.POSITION),
            Signal(
                "MDI_VELOCITY",
                35,
                _U32,
                "MDI velocity",
                "1000 LU/min",
                confidence=Confidence.UNVERIFIED,
                quantity=SignalQuantity.MOTION_VELOCITY,
            ),
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
        from difflib import get_close_matches  # noqa: PLC0415

        near = ", ".join(get_close_matches(name.upper(), SIGNALS))
        expected = "a name of the signal catalogue" + (f"; did you mean {near}?" if near else "")
        raise ProfidriveError("signal", name, expected) from None
