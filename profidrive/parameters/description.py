"""Numbers of the profile's parameters, and the parameter description.

Numbers of the profile's parameters by name; ``profidrive.parameters.catalogue`` describes them. Source: PROFIdrive profile 4.1
chapter 6.2 and 6.3.9, encoder profile 4.2. The parameter description (attribute 20h): 46 bytes, or one of its 12 elements.
Source: PROFIdrive profile 4.1 chapter 6.2.1.4; bits of the identifier as public drive manuals print them.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.codec import Values
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber, ParameterRefused


class Pnu(enum.IntEnum):
    """A parameter of the profile."""

    SETPOINT_SIGNALS = 915
    ACTUAL_SIGNALS = 916
    NODE_ADDRESS = 918
    DEVICE_NAME = 919
    TELEGRAM = 922
    SIGNAL_LIST = 923
    SIGN_OF_LIFE_BIT = 924
    SIGN_OF_LIFE_TOLERANCE = 925
    OPERATION_PRIORITY = 927
    CONTROL_PRIORITY = 928
    OPERATING_MODE = 930
    FAULT_COUNTER = 944
    FAULT_CODE = 945
    FAULT_CODE_LIST = 946
    FAULT_NUMBER = 947
    FAULT_TIME = 948
    FAULT_VALUE = 949
    FAULT_NUMBER_LIST = 951
    FAULT_SITUATIONS = 952
    WARNING_WORD = 953
    BAUD_RATE = 963
    DRIVE_UNIT = 964
    PROFILE = 965
    STW1 = 967
    ZSW1 = 968
    LOAD = 970
    SAVE = 971
    RESET = 972
    PARAMETER_ACCESS = 974
    DRIVE_OBJECT = 975
    LOAD_DEVICE = 976
    SAVE_DEVICE = 977
    DRIVE_OBJECTS = 978
    SENSOR_FORMAT = 979
    REFERENCE_SPEED = 60000
    STATION_NAME = 61000
    STATION_IP = 61001
    STATION_MAC = 61002
    STATION_GATEWAY = 61003
    STATION_MASK = 61004
    PRESET_VALUE = 65000
    OPERATING_STATUS = 65001


NAME_LENGTH = 16
"""Characters of a name."""
_LAYOUT = struct.Struct(f">HHf2s4s{NAME_LENGTH}s4s4s2sHHH")
SIZE = _LAYOUT.size
_ELEMENT_TYPES = (
    DataType.V2,
    DataType.UNSIGNED16,
    DataType.FLOATING_POINT,
    *(DataType.OCTET_STRING,) * 2,
    DataType.VISIBLE_STRING,
    *(DataType.OCTET_STRING,) * 3,
    DataType.V2,
    DataType.UNSIGNED16,
    DataType.V2,
)
UNITS: Final[Mapping[str, tuple[int, int]]] = MappingProxyType({"rpm": (11, 67), "ms": (4, -3)})
"""Variable index (physical quantity) and conversion index (its unit) of the variable attribute, by the unit's name."""


class Identifier(enum.IntFlag):
    """Upper byte of the identifier; the lower one is the data type code."""

    NOT_STANDARDISED = 1 << 8
    """Standardisation factor and variable attribute have no meaning."""
    READ_ONLY = 1 << 9
    TEXT = 1 << 10
    """Has a text array."""
    RESET_ONLY = 1 << 13
    """Only 0 can be written."""
    ARRAY = 1 << 14


@dataclass(frozen=True, slots=True)
class Description:
    """Description of a parameter. ``count``: elements of an array, length of a string, else 0."""

    type: DataType
    name: str
    array: bool = False
    count: int = 0
    writable: bool = False
    has_texts: bool = False
    low: int = 0
    high: int = 0
    """Limits are 0 if the type's own range applies or the type is not an integer."""
    reset_only: bool = False
    unit: tuple[int, int] | None = None
    """Variable and conversion index; None: the value has no unit that is described."""

    def _fields(self) -> tuple[int | float | bytes, ...]:
        flags = Identifier.NOT_STANDARDISED if self.unit is None else Identifier(0)
        flags |= Identifier.RESET_ONLY if self.reset_only else Identifier(0)
        flags |= Identifier(0) if self.writable else Identifier.READ_ONLY
        flags |= Identifier.TEXT if self.has_texts else Identifier(0)
        flags |= Identifier.ARRAY if self.array else Identifier(0)
        name = self.name.encode("ascii", "replace")[:NAME_LENGTH].ljust(NAME_LENGTH)
        limits = [(value & 0xFFFFFFFF).to_bytes(4, "big") for value in (self.low, self.high)]
        variable, conversion = self.unit or (0, 0)
        attribute = bytes((variable, conversion & 0xFF))
        return flags | self.type.code, self.count, 1.0, attribute, bytes(4), name, *limits, bytes(2), 0, 0, 0

    def values(self, element: int) -> Values:
        """Element 1 to 12 of the description, all of it for 0; ParameterRefused for others."""
        if element == 0:
            return Values(DataType.OCTET_STRING, _LAYOUT.pack(*self._fields()))
        if not 1 <= element <= len(_ELEMENT_TYPES):
            raise ParameterRefused(ParameterErrorNumber.FAULTY_SUBINDEX)
        value = self._fields()[element - 1]
        return Values(_ELEMENT_TYPES[element - 1], value if isinstance(value, bytes) else (value,))

    @classmethod
    def decode(cls, data: bytes) -> Description:
        """A description from its 46 bytes; ProfidriveError when it is none."""
        if len(data) != SIZE:
            raise ProfidriveError("parameter description", f"{len(data)} bytes", f"{SIZE} bytes")
        identifier, count, _, attribute, _, name, low, high, _, _, _, _ = _LAYOUT.unpack(data)
        data_type = DataType.from_code(identifier & 0xFF)
        signed = data_type.char.islower()
        return cls(
            data_type,
            name.decode("ascii", "replace").rstrip(),
            bool(identifier & Identifier.ARRAY),
            count,
            not identifier & Identifier.READ_ONLY,
            bool(identifier & Identifier.TEXT),
            int.from_bytes(low, "big", signed=signed),
            int.from_bytes(high, "big", signed=signed),
            bool(identifier & Identifier.RESET_ONLY),
            None if identifier & Identifier.NOT_STANDARDISED else struct.unpack("Bb", attribute),
        )
