"""The type of a drive as one frozen value: objects with their limits, scaling, modes, homing methods, PDOs, faults and quirks.

Also the manufacturer's fault numbers with their channel error types (the tables are in ``dsp402/families``), and the error
root of this package. Source: CiA 402 (objects, 6502h, 60E3h), CiA 301 (PDO parameters). ``dsp402.identification.describe``
makes the type from the data sheet, the answers of the device, the configuration and the overlay of its family
(``dsp402.identification.overlay``). Executors read every difference between drives from here. Unknown values are refused by
name, never assumed.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Final

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.objects import Entry, ObjectAddress
from pdgw.ds301.pdo import PdoCapabilities
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import VL_MIN_MAX, VL_MIN_MAX_BY_DIRECTION


class Dsp402Error(CanopenError):
    """A drive fault or unusable drive data: names the field, the value and what would have been allowed."""


class ChannelErrorType(enum.Enum):
    """PROFINET channel error types used for the drive's faults: (number, text)."""

    SHORT_CIRCUIT = (0x0001, "short circuit")
    UNDERVOLTAGE = (0x0002, "undervoltage")
    OVERVOLTAGE = (0x0003, "overvoltage")
    OVER_TEMPERATURE = (0x0005, "over temperature")
    ERROR = (0x0009, "error")

    def __init__(self, code: int, text: str) -> None:
        self.code = code
        self.text = text


@dataclass(frozen=True, slots=True)
class DriveFault:
    """A fault of the drive: the manufacturer's number, EMCY error code (603Fh) and error register bits (1001h)."""

    number: int
    name: str
    error_code: int
    error_register: int
    channel_error: ChannelErrorType


POSITIONS: Final = 1 << 32
"""Number of values of 6064h."""

VL_RAMP: Final = 0x70
"""Controlword of velocity mode (vl): enable ramp, unlock ramp, reference ramp. All three let the setpoint through."""
VL_REFERENCE: Final = 0x40
"""The last of them: without it the ramp goes to 0, also below the minimum speed."""
_MINIMUM_SPEEDS: Final = ((VL_MIN_MAX, 1), (VL_MIN_MAX_BY_DIRECTION, 1), (VL_MIN_MAX_BY_DIRECTION, 3))
_ABSENT = "not an object of this drive"
_TASK_MODE = "1 (profile position) for a traversing task: use a drive with that mode, or a telegram without such tasks"


class Quantity(enum.Enum):
    """Quantities with a 100 % value; the value is the name in messages."""

    SPEED = "speed"
    """60FFh, 606Ch."""
    PROFILE_VELOCITY = "profile velocity"
    """6081h, while homing 6099h."""
    ACCELERATION = "acceleration"
    """6083h."""
    DECELERATION = "deceleration"
    """6084h."""
    POSITION = "position"
    """607Ah, 6064h."""


@dataclass(frozen=True, slots=True)
class Reference:
    """100 % of a quantity in the drive's own units (above 0), and a line with the value and its source."""

    value: Fraction
    source: str


@dataclass(frozen=True)
class Scaling:
    """100 % of each quantity in the units of the drive's objects; an unknown quantity has the key that defines it."""

    references: Mapping[Quantity, Reference] = field(default_factory=dict)
    unknown: Mapping[Quantity, str] = field(default_factory=dict)
    """Why a quantity is unknown, and the configuration key that sets it."""
    missing: Mapping[Quantity, tuple[str, ...]] = field(default_factory=dict)
    """Configuration keys for unknown quantities."""
    rated_speed_rpm: Fraction | None = None
    """100 % of a speed in rpm of the motor."""
    position_range: tuple[int, int] | None = None
    """Targets (607Ah) the drive can be sent, in position units; None: no limit but that of the object."""
    position_wraps: bool = False
    """The position starts again at the other end of ``position_range`` (607Bh of CiA 402)."""
    wrap_confirmed: bool = True
    """The overlay says so; otherwise only the profile does."""
    range_source: str = ""
    """The objects that make ``position_range``, with their values."""
    same_signs: bool = True
    """607Eh inverts positions and velocities alike (bits 7 and 6)."""
    position_unit: str = "increments"
    counts_per_revolution: Fraction | None = None
    """Position units in one revolution of the motor."""
    velocity_per_rpm: Fraction | None = None
    """Velocity units of one rpm of the motor."""
    acceleration_per_rpm_s: Fraction | None = None
    """Acceleration units of one rpm/s of the motor."""

    @property
    def position_span(self) -> int:
        """Number of positions after which the position starts again."""
        if not self.position_wraps or self.position_range is None:
            return POSITIONS
        low, high = self.position_range
        return high - low + 1

    @property
    def range_text(self) -> str:
        """For the user: where positions end or wrap."""
        if self.position_range is None:
            return "positions have no range (607Bh)"
        if not self.position_wraps:
            return f"positions end at {self.range_source}"
        doubt = "" if self.wrap_confirmed else ", as CiA 402 says (not confirmed: range_is_limit of the family)"
        return f"positions wrap at {self.range_source}{doubt}"

    @property
    def lines(self) -> tuple[str, ...]:
        """For the user: each quantity with its 100 % and its source, or with what is missing; the range of positions."""
        texts = {quantity: f"{quantity.value}: {found.source}" for quantity, found in self.references.items()}
        texts |= {quantity: f"{text} (not known)" for quantity, text in self.unknown.items()}
        return (*(texts[quantity] for quantity in Quantity if quantity in texts), self.range_text)

    def refusal(self, *needed: Quantity) -> str:
        """Why an axis that needs these quantities must not operate; empty when all of them are known."""
        missing = [quantity for quantity in needed if quantity not in self.references]
        return "; ".join(self.unknown.get(quantity, f"{quantity.value}: 100 % is unknown") for quantity in missing)

    def missing_keys(self, *needed: Quantity) -> tuple[str, ...]:
        """Keys of the configuration that these quantities lack, each once."""
        return tuple(dict.fromkeys(key for quantity in needed for key in self.missing.get(quantity, ())))

    def reference(self, quantity: Quantity) -> Fraction:
        """100 % in the drive's units; Dsp402Error when it is not known."""
        try:
            return self.references[quantity].value
        except KeyError:
            raise Dsp402Error("scaling", quantity.value, self.refusal(quantity)) from None


@dataclass(frozen=True, slots=True)
class Turntable:
    """A mode that positions within one revolution and takes its direction from bits of the Controlword."""

    mode: int
    """6060h."""
    shortest: int
    """Mask of the Controlword bit for the shortest way."""
    ccw: int
    """Mask of the bit for the negative direction; neither bit: the positive one."""


@dataclass(frozen=True, slots=True)
class Quirks:
    """Differences of a family from the profile; the defaults are the profile."""

    turntable: Turntable | None = None
    range_is_limit: bool | None = None
    """607Bh limits the targets (True) or is a range that wraps (False). None: no manual says so, and the profile counts."""
    mode_shown_in_operation_only: bool = False
    """6061h follows 6060h only when the operation is enabled."""
    fault_reset_edges: int = 1
    """Number of rising edges of Controlword 7 that end a fault."""
    boot_ms: int = 0
    """Time after power-on or reset without an answer."""
    fault_number: tuple[int, int] | None = None
    """The object with the manufacturer's own fault number."""
    sync_loss_periods: int = 0
    """Number of periods (1006h) without SYNC after which the drive stops in a cyclic synchronous mode; 0: unknown."""


@dataclass(frozen=True)
class DriveType:
    """A drive as a value. ``entries`` are the objects with an image attribute that this drive has, with its own limits."""

    name: str
    family: str
    """Name of its overlay; empty for a drive that only its data sheet and answers describe."""
    entries: Mapping[str, Entry]
    scaling: Scaling
    modes: Mapping[int, str]
    """Values of 6060h it offers, with their names."""
    homing_methods: Mapping[int, str]
    """Values of 6098h it offers, with what they search for."""
    pdos: PdoCapabilities = field(default_factory=PdoCapabilities)
    faults: Mapping[int, DriveFault] = field(default_factory=dict)
    """Faults by the manufacturer's number."""
    quirks: Quirks = Quirks()
    max_torque: int = 0
    """6072h as it was found; 0 for a drive without it."""
    position_window: int | None = None
    """6067h as it was found; None for a drive without it, or that does not use it."""
    position_objects: Mapping[ObjectAddress, int] = field(default_factory=dict)
    """The objects that define the unit and the sign of positions, as they were found."""
    acting: Mapping[ObjectAddress, int] = field(default_factory=dict)
    """The objects that act in the modes of the telegram beside its setpoint (``dsp402.acting``), as the drive has them."""
    uncorrected: str = ""
    """Why the drive must not be operated: a value of another master that the gateway could not correct; empty: it may."""
    ignored_ranges: tuple[str, ...] = ()
    """For the log: ranges of setpoints in the data sheet that forbid 0."""

    def has(self, attribute: str) -> bool:
        return attribute in self.entries

    def entry(self, attribute: str) -> Entry:
        """The object of an image attribute; Dsp402Error if the drive lacks it."""
        try:
            return self.entries[attribute]
        except KeyError:
            raise Dsp402Error(attribute, _ABSENT, ", ".join(sorted(self.entries))) from None

    def limits(self, attribute: str) -> tuple[int, int]:
        """Smallest and largest value that the drive accepts for the object of an image attribute."""
        return self.entry(attribute).limits

    @property
    def speed_mode(self) -> int | None:
        """The mode for a speed setpoint: profile velocity, else cyclic synchronous velocity, else velocity mode (vl)."""
        modes = (Mode.VELOCITY, Mode.CYCLIC_VELOCITY, Mode.VL_VELOCITY)
        return next((mode.value for mode in modes if mode in self.modes), None)

    def mode_for(self, mode: Mode | None) -> int | None:
        """6060h for a requested mode: profile velocity means the speed mode that the drive offers."""
        offered = self.speed_mode if mode is Mode.VELOCITY else None
        return mode if offered is None else offered

    @property
    def speed_bits(self) -> int:
        """Controlword bits that let a speed through in operation: in velocity mode (vl) ramp enabled, unlocked, referenced."""
        return VL_RAMP if self.speed_mode == Mode.VL_VELOCITY else 0

    @property
    def minimum_speed(self) -> int:
        """The lowest speed in velocity mode (vl), in its units, at most 100 %; 0 in the other modes."""
        if self.speed_mode != Mode.VL_VELOCITY:
            return 0
        found = max(self.acting.get(address, 0) for address in _MINIMUM_SPEEDS)
        return min(found, int(self.scaling.reference(Quantity.SPEED)))

    def require_profile_position(self) -> int:
        """The mode for a traversing task; Dsp402Error for a drive without it."""
        if Mode.POSITION not in self.modes:
            raise Dsp402Error("modes of the drive (6502h)", sorted(self.modes), _TASK_MODE)
        return Mode.POSITION.value

    @property
    def fault_of_code(self) -> Mapping[int, DriveFault]:
        """Faults by their EMCY error code."""
        return {fault.error_code: fault for fault in self.faults.values()}
