"""Telegram layouts as data, and the codec compiled from them.

Source: PROFIdrive profile 4.1 chapter 6.3.4 (standard telegrams), the encoder profile (81-84), the manufacturer's
guide chapter 4.3 (1, 9, 100). Left out: telegram 111 and free telegram configuration (999).

Adding a telegram is adding one entry to ``TELEGRAMS``.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.signals import Signal, signal


class Direction(enum.Enum):
    """Setpoints travel PLC -> drive, actual values drive -> PLC."""

    SETPOINT = "setpoint"
    ACTUAL = "actual"


class ApplicationMode(enum.Enum):
    """What the axis does under a telegram."""

    VELOCITY = "velocity"
    POSITIONING = "positioning"
    ENCODER = "encoder"
    TRANSPARENT = "transparent"


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
    """A telegram: number (P922), application mode and both directions."""

    number: int
    mode: ApplicationMode
    setpoints: TelegramHalf
    actuals: TelegramHalf

    def half(self, direction: Direction) -> TelegramHalf:
        return self.setpoints if direction is Direction.SETPOINT else self.actuals


def _telegram(number: int, mode: ApplicationMode, setpoints: str, actuals: str) -> Telegram:
    def half(direction: Direction, names: str) -> TelegramHalf:
        return TelegramHalf(number, direction, mode, tuple(signal(name.strip()) for name in names.split(",")))

    return Telegram(number, mode, half(Direction.SETPOINT, setpoints), half(Direction.ACTUAL, actuals))


_VELOCITY = ApplicationMode.VELOCITY
_POSITIONING = ApplicationMode.POSITIONING
_ENCODER = ApplicationMode.ENCODER
_ENC_ACT = "ZSW2_ENC, G1_ZSW, G1_XIST1, G1_XIST2"

TELEGRAMS: MappingProxyType[int, Telegram] = MappingProxyType(
    {
        telegram.number: telegram
        for telegram in (
            _telegram(1, _VELOCITY, "STW1, NSOLL_A", "ZSW1, NIST_A"),
            _telegram(2, _VELOCITY, "STW1, NSOLL_B, STW2", "ZSW1, NIST_B, ZSW2"),
            _telegram(
                3,
                _VELOCITY,
                "STW1, NSOLL_B, STW2, G1_STW",
                "ZSW1, NIST_B, ZSW2, G1_ZSW, G1_XIST1, G1_XIST2",
            ),
            _telegram(7, _POSITIONING, "STW1, SATZANW", "ZSW1, AKTSATZ"),
            _telegram(
                9,
                _POSITIONING,
                "STW1, SATZANW, STW2, MDI_TARPOS, MDI_VELOCITY, MDI_ACC, MDI_DEC, MDI_MOD",
                "ZSW1, AKTSATZ, ZSW2, XIST_A",
            ),
            _telegram(
                20,
                _VELOCITY,
                "STW1, NSOLL_A",
                "ZSW1, NIST_A_GLATT, IAIST_GLATT, MIST_GLATT, PIST_GLATT, MELD_NAMUR",
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
        )
    }
)
"""Every telegram by its number."""


def telegram(number: int) -> Telegram:
    """The telegram with this number; ProfidriveError lists the known ones."""
    try:
        return TELEGRAMS[number]
    except KeyError:
        raise ProfidriveError("telegram", number, f"one of {sorted(TELEGRAMS)}") from None


def word_positions(half: TelegramHalf) -> tuple[int, ...]:
    """First word number (counted from 1, as in the standard) of every signal."""
    positions = []
    word = 1
    for item in half.signals:
        positions.append(word)
        word += item.words
    return tuple(positions)
