"""Telegram layouts as data, and the codec compiled from them.

Source: PROFIdrive profile 4.1 chapter 6.3.4 (standard telegrams), the encoder profile (81-84), the manufacturer's
guide chapter 4.3 (1, 9, 100), public manuals of drives and masters (4-6, 102-112, with their ``Confidence``). Left out: free
telegram configuration (999), supplementary telegrams (700 ff, safety among them).

Adding a telegram is adding one entry to ``TELEGRAMS``. A user's own is a value, which is handed to those who look for its number.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Final

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.signals import POSITIONER_FORMS, USER_WORDS, Signal, signal
from pdgw.profidrive.words import Confidence


class Direction(enum.Enum):
    """Setpoints travel PLC -> drive, actual values drive -> PLC."""

    SETPOINT = "setpoint"
    ACTUAL = "actual"

    __hash__ = object.__hash__  # members are single objects, and used as keys for every frame


class ApplicationMode(enum.Enum):
    """Function of the axis with a telegram."""

    VELOCITY = "velocity"
    POSITIONING = "positioning"
    ENCODER = "encoder"
    TRANSPARENT = "transparent"


class ApplicationClass(enum.IntEnum):
    """Location of the control loops: PROFIdrive profile chapter 6.2. Classes 2, 5 and 6 have no telegram here."""

    SPEED = 1
    """Speed controlled by the drive; the PLC closes no loop."""
    POSITIONING = 3
    """The drive positions by itself."""
    CENTRAL = 4
    """The PLC interpolates and closes the position loop over the speed setpoint, or the drive does for it (DSC)."""


@dataclass(frozen=True)
class TelegramHalf:
    """One direction of a telegram: ordered signals and the codec compiled from them.

    Values are raw integers as on the wire: N2 and N4 signed fractions, words unsigned.
    """

    telegram: int
    direction: Direction
    mode: ApplicationMode
    signals: tuple[Signal, ...]
    struct: struct.Struct = field(init=False, repr=False, compare=False)
    size: int = field(init=False)
    """Bytes on the wire."""

    def __post_init__(self) -> None:
        layout = struct.Struct(">" + "".join(s.type.char for s in self.signals))
        object.__setattr__(self, "struct", layout)
        object.__setattr__(self, "size", layout.size)

    def __repr__(self) -> str:
        return f"<{self.direction.value}s of telegram {self.telegram}: {' '.join(self.names)}>"

    @property
    def words(self) -> int:
        return self.size // 2

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.signals)

    def index(self, name: str) -> int:
        """Position of a signal in the value tuple; ProfidriveError where the telegram lacks it."""
        try:
            return self.names.index(name)
        except ValueError:
            raise ProfidriveError(
                f"signal of telegram {self.telegram} ({self.direction.value})", name, ", ".join(self.names)
            ) from None

    def signal(self, name: str) -> Signal:
        """A signal in the form this telegram carries it; ProfidriveError where it lacks it."""
        return self.signals[self.index(name)]

    def decode(self, data: bytes | bytearray | memoryview, offset: int = 0) -> tuple[int, ...]:
        """Raw signal values in telegram order; ProfidriveError when ``data`` is too short."""
        try:
            return self.struct.unpack_from(data, offset)
        except struct.error:
            raise ProfidriveError(
                f"telegram {self.telegram} {self.direction.value} data",
                f"{max(0, len(data) - offset)} bytes",
                f"at least {self.size} bytes",
            ) from None

    def encode(self, values: Sequence[int]) -> bytes:
        """The telegram's bytes; ProfidriveError names the signal that does not fit."""
        try:
            return self.struct.pack(*values)
        except struct.error:
            self._explain(values)
            raise

    def encode_into(self, buffer: bytearray, offset: int, values: Sequence[int]) -> None:
        """As ``encode``, into a buffer at an offset, without allocating."""
        try:
            self.struct.pack_into(buffer, offset, *values)
        except struct.error:
            self._explain(values)
            raise

    def _explain(self, values: Sequence[int]) -> None:
        if len(values) != len(self.signals):
            raise ProfidriveError(
                f"telegram {self.telegram} {self.direction.value} values",
                f"{len(values)} values",
                f"{len(self.signals)} values: {', '.join(self.names)}",
            )
        for item, value in zip(self.signals, values, strict=True):
            low, high = item.type.integer_range
            if not isinstance(value, int) or not low <= value <= high:
                raise ProfidriveError(item.name, value, f"an integer in {low}..{high}")

    def as_dict(self, values: Sequence[int]) -> dict[str, int]:
        """Raw values by signal name."""
        return dict(zip(self.names, values, strict=True))

    def from_dict(self, values: dict[str, int]) -> tuple[int, ...]:
        """Raw values in telegram order from values by name; a signal that is not named is 0."""
        for name in values:
            self.index(name)
        return tuple(values.get(name, 0) for name in self.names)


@dataclass(frozen=True)
class Telegram:
    """A telegram: number (P922), application mode and classes, both directions, and how well its layout is known."""

    number: int
    mode: ApplicationMode
    setpoints: TelegramHalf
    actuals: TelegramHalf
    classes: tuple[ApplicationClass, ...] = ()
    confidence: Confidence = Confidence.CONFIRMED
    like: int = 0
    """A user's own: the number of the telegram that it is carried out as."""

    def __repr__(self) -> str:
        return f"<Telegram {self.number}: {' '.join(self.setpoints.names)} -> {' '.join(self.actuals.names)}>"

    @property
    def base(self) -> int:
        """The number of the telegram in this package that it is carried out as: its own, or ``like``."""
        return self.like or self.number

    @property
    def class_bits(self) -> int:
        """The application classes as in P975: bit 0 is class 1."""
        return sum(1 << item - 1 for item in self.classes)

    def half(self, direction: Direction) -> TelegramHalf:
        return self.setpoints if direction is Direction.SETPOINT else self.actuals


def _telegram(
    number: int,
    mode: ApplicationMode,
    setpoints: str,
    actuals: str,
    classes: tuple[ApplicationClass, ...] = (),
    confidence: Confidence = Confidence.CONFIRMED,
    forms: Mapping[str, Signal] = MappingProxyType({}),
) -> Telegram:
    """``forms``: signals this telegram carries in another form than the catalogue's."""

    def half(direction: Direction, names: str) -> TelegramHalf:
        return _half(number, direction, mode, map(str.strip, names.split(",")), forms)

    return Telegram(
        number, mode, half(Direction.SETPOINT, setpoints), half(Direction.ACTUAL, actuals), classes, confidence
    )


def _half(
    number: int, direction: Direction, mode: ApplicationMode, names: Iterable[str], forms: Mapping[str, Signal]
) -> TelegramHalf:
    """One direction of a telegram by the names of its signals, each in its form of ``forms``, else in the catalogue's."""
    return TelegramHalf(number, direction, mode, tuple(forms.get(name) or signal(name) for name in names))


_VELOCITY = ApplicationMode.VELOCITY
_POSITIONING = ApplicationMode.POSITIONING
_ENCODER = ApplicationMode.ENCODER
_AC1 = (ApplicationClass.SPEED,)
_AC3 = (ApplicationClass.POSITIONING,)
_AC4 = (ApplicationClass.CENTRAL,)
_AC1_AC4 = (*_AC1, *_AC4)
_ONE = Confidence.ONE_SOURCE
_UNVERIFIED = Confidence.UNVERIFIED
_ENC_ACT = "ZSW2_ENC, G1_ZSW, G1_XIST1, G1_XIST2"
_G1_ACT = "G1_ZSW, G1_XIST1, G1_XIST2"
_G2_ACT = "G2_ZSW, G2_XIST1, G2_XIST2"
_SPEED_SET = "STW1, NSOLL_B, STW2"
_SPEED_ACT = "ZSW1, NIST_B, ZSW2"
_DSC = ", XERR, KPC"
_TORQUE_SET = f"{_SPEED_SET}, MOMRED"
_MESSAGE_ACT = f"{_SPEED_ACT}, MELDW"

_CATALOGUE: dict[int, Telegram] = {
    telegram.number: telegram
    for telegram in (
        _telegram(1, _VELOCITY, "STW1, NSOLL_A", "ZSW1, NIST_A", _AC1),
        _telegram(2, _VELOCITY, _SPEED_SET, _SPEED_ACT, _AC1),
        _telegram(3, _VELOCITY, f"{_SPEED_SET}, G1_STW", f"{_SPEED_ACT}, {_G1_ACT}", _AC1_AC4),
        _telegram(
            4,
            _VELOCITY,
            f"{_SPEED_SET}, G1_STW, G2_STW",
            f"{_SPEED_ACT}, {_G1_ACT}, {_G2_ACT}",
            _AC1_AC4,
            _ONE,
        ),
        _telegram(5, _VELOCITY, f"{_SPEED_SET}, G1_STW{_DSC}", f"{_SPEED_ACT}, {_G1_ACT}", _AC4, _UNVERIFIED),
        _telegram(
            6,
            _VELOCITY,
            f"{_SPEED_SET}, G1_STW, G2_STW{_DSC}",
            f"{_SPEED_ACT}, {_G1_ACT}, {_G2_ACT}",
            _AC4,
            _UNVERIFIED,
        ),
        _telegram(7, _POSITIONING, "STW1, SATZANW", "ZSW1, AKTSATZ", _AC3, forms=POSITIONER_FORMS),
        _telegram(
            9,
            _POSITIONING,
            "STW1, SATZANW, STW2, MDI_TARPOS, MDI_VELOCITY, MDI_ACC, MDI_DEC, MDI_MOD",
            "ZSW1, AKTSATZ, ZSW2, XIST_A",
            _AC3,
        ),
        _telegram(
            20,
            _VELOCITY,
            "STW1, NSOLL_A",
            "ZSW1, NIST_A_GLATT, IAIST_GLATT, MIST_GLATT, PIST_GLATT, MELD_NAMUR",
            _AC1,
        ),
        _telegram(81, _ENCODER, "STW2_ENC, G1_STW", _ENC_ACT),
        _telegram(82, _ENCODER, "STW2_ENC, G1_STW", _ENC_ACT + ", NIST_A"),
        _telegram(83, _ENCODER, "STW2_ENC, G1_STW", _ENC_ACT + ", NIST_B"),
        _telegram(84, _ENCODER, "STW2_ENC, G1_STW", "ZSW2_ENC, G1_ZSW, G1_XIST3, G1_XIST2, NIST_B"),
        _telegram(
            100,
            ApplicationMode.TRANSPARENT,
            "Controlword, Modes of Operation, Target Torque, Target Position, Profile Velocity,"
            "Profile Acceleration, Profile Deceleration, Dynamic Speed Limit, Dynamic Torque Limit,"
            "Digital Outputs, Digital Outputs Mask, Target Velocity",
            "Statusword, Modes of Operation Display, Position Actual Value, Velocity Demand Value,"
            "Velocity Actual Value, Current Actual Value, DC-link Circuit Voltage, Digital Inputs,"
            "Analogue Input 1, Analogue Input 2, Encoder Position Value, Error Code",
        ),
        _telegram(102, _VELOCITY, f"{_TORQUE_SET}, G1_STW", f"{_MESSAGE_ACT}, {_G1_ACT}", _AC1_AC4),
        _telegram(
            103,
            _VELOCITY,
            f"{_TORQUE_SET}, G1_STW, G2_STW",
            f"{_MESSAGE_ACT}, {_G1_ACT}, {_G2_ACT}",
            _AC1_AC4,
            _ONE,
        ),
        _telegram(105, _VELOCITY, f"{_TORQUE_SET}, G1_STW{_DSC}", f"{_MESSAGE_ACT}, {_G1_ACT}", _AC4),
        _telegram(
            106,
            _VELOCITY,
            f"{_TORQUE_SET}, G1_STW, G2_STW{_DSC}",
            f"{_MESSAGE_ACT}, {_G1_ACT}, {_G2_ACT}",
            _AC4,
            _UNVERIFIED,
        ),
        _telegram(
            110,
            _POSITIONING,
            "STW1, SATZANW, POS_STW, STW2, OVERRIDE, MDI_TARPOS, MDI_VELOCITY, MDI_ACC, MDI_DEC, MDI_MOD",
            "ZSW1, AKTSATZ, POS_ZSW, ZSW2, MELDW, XIST_A",
            _AC3,
            _ONE,
            POSITIONER_FORMS,
        ),
        _telegram(
            111,
            _POSITIONING,
            "STW1, POS_STW1, POS_STW2, STW2, OVERRIDE, MDI_TARPOS, MDI_VELOCITY, MDI_ACC, MDI_DEC, USER",
            "ZSW1, POS_ZSW1, POS_ZSW2, ZSW2, MELDW, XIST_A, NIST_B, FAULT_CODE, WARN_CODE, USER",
            _AC3,
            forms=POSITIONER_FORMS,
        ),
        _telegram(
            112,
            _POSITIONING,
            "STW1, POS_STW1, POS_STW2, STW2, OVERRIDE, MDI_TARPOS_F, MDI_VELOCITY_F, MDI_ACC_F, MDI_DEC_F,"
            "RESERVED_2, REF_COORDINATE",
            "ZSW1, POS_ZSW1, POS_ZSW2, ZSW2, RESERVED, XIST_F, VIST_F, MELDW, FAULT_CODE, WARN_CODE",
            _AC3,
            _ONE,
        ),
    )
}
TELEGRAMS: Final = MappingProxyType(_CATALOGUE)
"""Every telegram of this package by its number, and those of ``register``."""
OWN_NUMBERS: Final = range(999, 0x8000)
"""Numbers of a user's own telegrams: 999 is the profile's free configuration, and no vendor's telegram is above it."""


def telegram(number: int, known: Mapping[int, Telegram] = TELEGRAMS) -> Telegram:
    """The telegram with this number; ProfidriveError lists the known ones.

    >>> telegram(1).setpoints.encode((0x047F, 0x2000)).hex(" ")
    '04 7f 20 00'
    """
    try:
        return known[number]
    except KeyError:
        raise ProfidriveError("telegram", number, f"one of {sorted(known)}") from None


def own_telegram(number: int, like: Telegram, setpoints: Sequence[str], actuals: Sequence[str]) -> Telegram:
    """A user's own telegram: signals by name in the form that ``like`` gives them, with its mode and classes.

    The second USER has the name USER_2, and so on. ProfidriveError for a number outside of ``OWN_NUMBERS``, an unknown signal, or
    a repeated one.
    """
    if number not in OWN_NUMBERS:
        raise ProfidriveError("number of a telegram of your own", number, f"{OWN_NUMBERS[0]}..{OWN_NUMBERS[-1]}")

    def half(direction: Direction, names: Sequence[str]) -> TelegramHalf:
        words = iter(USER_WORDS)
        names = [next(words, name) if name == USER_WORDS[0] else name for name in names]
        twice = [name for position, name in enumerate(names) if name in names[:position]]
        if twice:
            raise ProfidriveError(
                f"{direction.value}s of telegram {number}",
                ", ".join(twice),
                f"each signal once, {USER_WORDS[0]} {len(USER_WORDS)} times",
            )
        forms = {item.name: item for item in like.half(direction).signals}
        return _half(number, direction, like.mode, names, forms)

    halves = half(Direction.SETPOINT, setpoints), half(Direction.ACTUAL, actuals)
    return Telegram(number, like.mode, *halves, like.classes, like=like.number)


def by_number(own: Iterable[Telegram]) -> dict[int, Telegram]:
    """A user's own telegrams by their numbers; ProfidriveError where one number has two layouts."""
    found: dict[int, Telegram] = {}
    for item in own:
        if found.setdefault(item.number, item) != item:
            raise ProfidriveError("telegram", f"{item.number} with two layouts", "a number for each layout")
    return found


def register(own: Telegram) -> None:
    """Add to ``TELEGRAMS``, for a program; ProfidriveError where its number has another layout already."""
    by_number((_CATALOGUE.get(own.number, own), own))
    _CATALOGUE[own.number] = own


def likeliest(numbers: Iterable[int], known: Mapping[int, Telegram] = TELEGRAMS) -> int:
    """Select a telegram if only the length is known: best-known layout first, then lowest number."""
    return min(numbers, key=lambda number: (known[number].confidence, number))
