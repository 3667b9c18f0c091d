"""Parameter addresses and values as a user writes them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import Values

_ADDRESS = re.compile(
    r"""(?:[Pp](?:NU)?)?(?P<number>0[xX][0-9a-fA-F]{1,16}|[0-9a-fA-F]{1,16}[hH]|[0-9]{1,20})
        (?:[./](?P<sub>[0-9]{1,20})(?:-(?P<last>[0-9]{1,20}))?
          |\[(?P<sub2>[0-9]{1,20})(?:(?:\.\.|-)(?P<last2>[0-9]{1,20}))?\])?""",
    re.VERBOSE,
)
_INTEGER = re.compile(r"(-?)(?:0[xX]([0-9a-fA-F]{1,16})|([0-9a-fA-F]{1,16})[hH]|([0-9]{1,20}))")
_SHOWN = 40
"""Characters of a wrong text."""
_EXAMPLES = "P922, 965, 6041h, 0x1018.3, 1018h.1-4 or P947[0..7]"


@dataclass(frozen=True, slots=True)
class Target:
    """A parameter and which of its elements; ``first`` None means all it has."""

    pnu: int
    first: int | None = None
    last: int | None = None

    @property
    def elements(self) -> range | None:
        """The subindices, None for all."""
        return None if self.first is None else range(self.first, self._end + 1)

    @property
    def _end(self) -> int:
        return self.first or 0 if self.last is None else self.last


def parse_target(text: str) -> Target:
    """``P922``, ``965``, ``6041h``, ``0x1018.3``, ``1018h.1-4``, ``P947[0..7]``; GatewayError for anything else."""
    match = _ADDRESS.fullmatch(text.strip())
    if match is None:
        raise GatewayError(f"parameter {text[:_SHOWN]!r}: not understood, expected for example {_EXAMPLES}")
    pnu = parse_integer(match["number"])
    sub, last = match["sub"] or match["sub2"], match["last"] or match["last2"]
    target = Target(pnu, int(sub) if sub else None, int(last) if last else None)
    if not 1 <= pnu <= 0xFFFF:
        raise GatewayError(f"parameter {text!r}: number {pnu} is not allowed, expected 1 to 65535")
    if target.first is not None and not target.first <= target._end <= 0xFFFE:
        raise GatewayError(f"parameter {text!r}: expected subindices from low to high, 0 to 65534")
    return target


def parse_integer(text: str) -> int:
    """``1234``, ``0x4D2`` or ``2000h``, also negative; ValueError for anything else."""
    match = _INTEGER.fullmatch(text)
    if match is None:
        raise ValueError(text)
    sign, prefixed, suffixed, decimal = match.groups()
    return int(sign + (decimal or prefixed or suffixed), 10 if decimal else 16)


TYPE_NAMES: dict[str, DataType] = {
    "bool": DataType.BOOLEAN,
    "i8": DataType.INTEGER8,
    "i16": DataType.INTEGER16,
    "i32": DataType.INTEGER32,
    "u8": DataType.UNSIGNED8,
    "u16": DataType.UNSIGNED16,
    "u32": DataType.UNSIGNED32,
    "f32": DataType.FLOATING_POINT,
    "string": DataType.VISIBLE_STRING,
    "octets": DataType.OCTET_STRING,
} | {item.name.lower(): item for item in DataType if item not in {DataType.ZERO, DataType.ERROR}}
"""Types that ``--type`` accepts."""


def parse_type(text: str) -> DataType:
    """A data type by its short or full name."""
    try:
        return TYPE_NAMES[text.lower()]
    except KeyError:
        raise GatewayError(f"type {text!r}: unknown, expected one of {', '.join(TYPE_NAMES)}") from None


def parse_value(text: str, data_type: DataType) -> Values:
    """One value, or several separated by commas, of a type; GatewayError names what does not fit."""
    if data_type is DataType.VISIBLE_STRING:
        try:
            return Values(data_type, text.encode("ascii"))
        except UnicodeEncodeError as error:
            raise GatewayError(f"value {text!r}: expected ASCII characters") from error
    if not data_type.char:
        try:
            return Values(data_type, bytes.fromhex(text))
        except ValueError as error:
            raise GatewayError(f"value {text!r}: expected hexadecimal bytes for {data_type.name}") from error
    numbers: list[int | float] = []
    for part in text.split(","):
        try:
            numbers.append(float(part) if data_type.is_float else parse_integer(part.strip()))
        except ValueError as error:
            raise GatewayError(f"value {part!r}: expected a number for {data_type.name}") from error
        if not data_type.is_float:
            low, high = (0, 1) if data_type is DataType.BOOLEAN else data_type.integer_range
            if not low <= numbers[-1] <= high:
                raise GatewayError(f"value {part}: expected {low} to {high} for {data_type.name}")
    return Values(data_type, tuple(numbers))
