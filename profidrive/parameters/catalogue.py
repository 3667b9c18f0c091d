"""The parameters of the profile, declared once: PNU, name, type, access, elements, texts.

Source: PROFIdrive profile 4.1 chapter 6.2 and 6.3.9, encoder profile 4.2 (docs/parameter-channel.md). The device binds the
values. CANopen objects 03E8h..EA5Fh, which are also parameters, have their own dictionary.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.description import Pnu
from pdgw.profidrive.signals import signal

OBJECT_PNUS = range(0x03E8, 0xEA5F + 1)
"""PNUs that are CANopen object indices, one to one."""
NAME_SIZE = 16


class Scope(enum.Enum):
    """Which drive objects have the parameter."""

    DEVICE = "device"
    """Global: every DO gives the same answer."""
    DRIVE_OBJECT = "drive object"
    """Each DO with an axis or encoder has its own."""
    AXIS = "axis"
    ENCODER = "encoder"


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """One parameter.

    ``low`` and ``high`` bound what may be written; ``texts`` are the text array (of a V2: two for each bit, see ``bit_texts``);
    ``elements`` names the elements of an array whose places have a meaning.
    """

    pnu: int
    name: str
    meaning: str
    type: DataType
    scope: Scope
    array: bool = False
    writable: bool = False
    low: int | None = None
    high: int | None = None
    unit: str = ""
    texts: tuple[str, ...] = ()
    elements: tuple[str, ...] = ()
    reset_only: bool = False
    """Only 0 can be written."""

    def __post_init__(self) -> None:
        if len(self.name) > NAME_SIZE:
            raise ProfidriveError(f"name of P{self.pnu}", self.name, f"at most {NAME_SIZE} characters")


def bit_texts(names: Iterable[str], zeros: Mapping[int, str] = MappingProxyType({})) -> tuple[str, ...]:
    """Text array of a V2: the texts of 0 and of 1 for each bit from 0; ``zeros``: those of 0 that are not "no", by bit."""
    return tuple(text[:NAME_SIZE] for place, name in enumerate(names) for text in (zeros.get(place, "no"), name))


def _word_texts(name: str) -> tuple[str, ...]:
    bits = signal(name).bits
    zeros = {bit.position: bit.zero for bit in bits if bit.zero}
    return bit_texts((bit.name.replace("_", " ").lower() for bit in bits), zeros)


_U8, _U16, _U32, _I32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32, DataType.INTEGER32
_V2, _TEXT, _OCTETS = DataType.V2, DataType.VISIBLE_STRING, DataType.OCTET_STRING
_DEVICE, _DO, _AXIS, _ENCODER = Scope.DEVICE, Scope.DRIVE_OBJECT, Scope.AXIS, Scope.ENCODER

LIST_PNUS = range(980, 990)
"""Lists of all parameters, chained."""

_SPECS = (
    ParameterSpec(
        Pnu.SETPOINT_SIGNALS, "PZD setpoints", "signal numbers of the setpoint telegram", _U16, _DO, array=True
    ),
    ParameterSpec(
        Pnu.ACTUAL_SIGNALS, "PZD actual value", "signal numbers of the actual value telegram", _U16, _DO, array=True
    ),
    ParameterSpec(Pnu.NODE_ADDRESS, "Node address", "CANopen node-ID", _U16, _DO),
    ParameterSpec(Pnu.DEVICE_NAME, "Device name", "name of the device of the DO", _TEXT, _DO),
    ParameterSpec(Pnu.TELEGRAM, "Telegram", "telegram selection", _U16, _DO, writable=True, low=1, high=0xFFFF),
    ParameterSpec(
        Pnu.SIGNAL_LIST,
        "Signal list",
        "element n: PNU or object that carries signal n, 0 = not supported",
        _U16,
        _DO,
        array=True,
    ),
    ParameterSpec(
        Pnu.SIGN_OF_LIFE_BIT,
        "Sign of life bit",
        "masks of the sign of life",
        _U16,
        _DO,
        array=True,
        elements=("ZSW2", "STW2"),
    ),
    ParameterSpec(
        Pnu.SIGN_OF_LIFE_TOLERANCE,
        "Sign of life tol",
        "tolerated sign-of-life failures, 65535 = not supervised",
        _U16,
        _DO,
        writable=True,
        low=0,
        high=0xFFFF,
    ),
    ParameterSpec(
        Pnu.OPERATION_PRIORITY,
        "Operation prio",
        "1: the parameter channel may write",
        _U16,
        _DO,
        writable=True,
        low=0,
        high=1,
    ),
    ParameterSpec(
        Pnu.CONTROL_PRIORITY,
        "Control priority",
        "1: the PZD control the drive",
        _U16,
        _DO,
        writable=True,
        low=1,
        high=1,
    ),
    ParameterSpec(
        Pnu.OPERATING_MODE, "Operating mode", "1 speed control, 2 positioning, 8064h telegram 100", _U16, _AXIS
    ),
    ParameterSpec(Pnu.FAULT_COUNTER, "Fault counter", "counts every change of the fault buffer", _U16, _DO),
    ParameterSpec(Pnu.FAULT_CODE, "Fault code", "EMCY error code, 603Fh", _U16, _DO, array=True),
    ParameterSpec(
        Pnu.FAULT_CODE_LIST, "Fault code list", "element n: fault code of fault number n", _U16, _DO, array=True
    ),
    ParameterSpec(Pnu.FAULT_NUMBER, "Fault number", "the drive's own number, or the gateway's", _U16, _DO, array=True),
    ParameterSpec(
        Pnu.FAULT_TIME, "Fault time", "time since start", DataType.TIME_DIFFERENCE, _DO, array=True, unit="ms"
    ),
    ParameterSpec(Pnu.FAULT_VALUE, "Fault value", "manufacturer's bytes of the EMCY", _U32, _DO, array=True),
    ParameterSpec(
        Pnu.FAULT_NUMBER_LIST,
        "Fault numbers",
        "element n: n where there is a fault of this number, with its text",
        _U16,
        _DO,
        array=True,
    ),
    ParameterSpec(
        Pnu.FAULT_SITUATIONS,
        "Fault situations",
        "situations in the buffer, 0 clears it",
        _U16,
        _DO,
        writable=True,
        low=0,
        high=0xFFFF,
        reset_only=True,
    ),
    ParameterSpec(
        Pnu.WARNING_WORD,
        "Warning word",
        "present warnings",
        _V2,
        _DO,
    ),
    ParameterSpec(Pnu.BAUD_RATE, "Baud rate", "actual bit rate of the CAN bus", _U16, _DO, unit="kbit/s"),
    ParameterSpec(
        Pnu.DRIVE_UNIT,
        "Drive unit ident",
        "drive unit identification",
        _U16,
        _DEVICE,
        array=True,
        elements=("manufacturer", "type", "version", "year", "day and month", "axes"),
    ),
    ParameterSpec(Pnu.PROFILE, "Profile ident", "profile identification number", _U16, _DO),
    ParameterSpec(Pnu.STW1, "STW1", "control word as last exchanged", _V2, _AXIS, texts=_word_texts("STW1")),
    ParameterSpec(Pnu.ZSW1, "ZSW1", "status word as last exchanged", _V2, _AXIS, texts=_word_texts("ZSW1")),
    ParameterSpec(
        Pnu.LOAD, "Load parameters", "1 loads the stored parameters", _U16, _DO, writable=True, low=0, high=1
    ),
    ParameterSpec(Pnu.SAVE, "Save parameters", "1 stores the parameters", _U16, _DO, writable=True, low=0, high=1),
    ParameterSpec(Pnu.RESET, "Drive reset", "1 power-on reset, 2 prepares it", _U16, _DO, writable=True, low=0, high=2),
    ParameterSpec(
        Pnu.PARAMETER_ACCESS,
        "BMP access",
        "base mode parameter access service identification",
        _U16,
        _DEVICE,
        array=True,
        elements=("max block length", "max parameters", "max latency"),
    ),
    ParameterSpec(
        Pnu.DRIVE_OBJECT,
        "DO ident",
        "DO identification",
        _U16,
        _DO,
        array=True,
        elements=("manufacturer", "type", "version", "year", "day and month", "class", "subclass", "DO-ID"),
    ),
    ParameterSpec(Pnu.LOAD_DEVICE, "Load device set", "1 loads all DOs", _U16, _DEVICE, writable=True, low=0, high=1),
    ParameterSpec(Pnu.SAVE_DEVICE, "Save device set", "1 stores all DOs", _U16, _DEVICE, writable=True, low=0, high=1),
    ParameterSpec(Pnu.DRIVE_OBJECTS, "DO list", "all DO-IDs", _U8, _DEVICE, array=True),
    ParameterSpec(Pnu.SENSOR_FORMAT, "Sensor format", "format of the sensor values", _U32, _DO, array=True),
    *(
        ParameterSpec(pnu, f"Parameters {pnu - 979}", "defined parameters, chained", _U16, _DO, array=True)
        for pnu in LIST_PNUS
    ),
    ParameterSpec(
        Pnu.REFERENCE_SPEED, "Reference speed", "velocity reference value", DataType.FLOATING_POINT, _DO, unit="rpm"
    ),
    ParameterSpec(Pnu.STATION_NAME, "Name of station", "name of station", _TEXT, _DEVICE),
    ParameterSpec(Pnu.STATION_IP, "IP of station", "IP address", _OCTETS, _DEVICE),
    ParameterSpec(Pnu.STATION_MAC, "MAC of station", "MAC address", _OCTETS, _DEVICE),
    ParameterSpec(Pnu.STATION_GATEWAY, "Default gateway", "default gateway", _OCTETS, _DEVICE),
    ParameterSpec(Pnu.STATION_MASK, "Subnet mask", "subnet mask", _OCTETS, _DEVICE),
    ParameterSpec(
        Pnu.PRESET_VALUE,
        "Preset value",
        "encoder preset",
        _I32,
        _ENCODER,
        writable=True,
        low=-(1 << 31),
        high=(1 << 31) - 1,
        unit="increments",
    ),
    ParameterSpec(
        Pnu.OPERATING_STATUS,
        "Operating status",
        "operating status of the encoder",
        _I32,
        _ENCODER,
        array=True,
        elements=(
            "header",
            "status",
            "faults",
            "supported faults",
            "warnings",
            "supported warnings",
            "profile version",
            "operating time",
            "offset",
            "units per revolution",
            "total range",
            "speed unit",
        ),
    ),
)

PARAMETERS: MappingProxyType[int, ParameterSpec] = MappingProxyType({spec.pnu: spec for spec in _SPECS})
"""Every profile parameter by its PNU."""

PROFILE_IDENTIFICATION = 0x0329
"""P965 of a drive: profile 3 (PROFIdrive), version 41."""
ENCODER_IDENTIFICATION = 0x3D2A
"""P965 of an encoder: profile 61, version 42."""
AXIS_CLASS = 1
ENCODER_CLASS = 5
"""P975: type class of the DO."""
