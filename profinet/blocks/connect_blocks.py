"""Blocks of the Connect service: relationships asked for and granted.

Source: IEC 61158-6-10 (ARBlockReq ... ModuleDiffBlock), as scapy and tshark read them. Checks here see one field; those that
compare fields or ask the device are in ``connect``.
"""

from __future__ import annotations

import enum
import re
from dataclasses import dataclass
from typing import Any, ClassVar, Final
from uuid import UUID

from pdgw.base.durations import MS
from pdgw.profinet.rpc.dcerpc import OBJECT_PREFIX
from pdgw.profinet.wire import (
    Block,
    Check,
    Structure,
    align,
    array,
    between,
    octets,
    one_of,
    padding,
    rest,
    text,
    u8,
    u16,
    u32,
    uuid,
)


class ArType(enum.IntEnum):
    """Kinds of application relationship served."""

    IO = 0x0001
    DEVICE_ACCESS = 0x0006


class IocrType(enum.IntEnum):
    """Direction of cyclic data, seen from the controller."""

    INPUT = 1
    OUTPUT = 2


class RtClass(enum.IntEnum):
    """IOCRProperties.RTClass: the field's value 1 is the old identification of RT_CLASS_1, 2 the present one."""

    LEGACY = 1
    RT_CLASS_1 = 2


CYCLIC_FRAME_IDS: Final[dict[int, range]] = {
    RtClass.LEGACY: range(0xC000, 0xF800),
    RtClass.RT_CLASS_1: range(0x8000, 0xC000),
}
"""FrameIDs of each class."""
FRAME_ID_BY_DEVICE: Final = 0xFFFF
"""The controller leaves the FrameID of the output relationship to the device."""
LT_RT: Final = 0x8892
BEST_EFFORT: Final = 0xFFFFFFFF
"""FrameSendOffset."""
TICK_NS: Final = 31_250
"""Unit of SendClockFactor and of the cycle counter."""
HOLD_MAX_NS: Final = 1920 * MS
ADVANCED_STARTUP: Final = 1 << 30
"""ARProperties.StartupMode."""
DEVICE_ACCESS: Final = 1 << 8
_STATE, _STATE_ACTIVE = 0x7, 1
_PARAMETERISATION_BY_INITIATOR = 1 << 4
ACTIVE_BY_INITIATOR: Final = _STATE_ACTIVE | _PARAMETERISATION_BY_INITIATOR
"""ARProperties of every relationship a controller asks for."""
_COMPANION, _COMPANION_RESERVED = 0x600, 0x600
PRIORITY_SHIFT: Final = 13
TAG_RT: Final = 0xC000
TAG_HIGH: Final = 0xC000
TAG_LOW: Final = 0xA000


def _properties_allowed(value: int) -> bool:
    return (
        value & _STATE == _STATE_ACTIVE
        and bool(value & _PARAMETERISATION_BY_INITIATOR)
        and value & _COMPANION != _COMPANION_RESERVED
    )


_UNICAST = Check(lambda mac: not mac[0] & 1 and any(mac), "a unicast address")
_NOT_NIL = Check(lambda value: value.int != 0, "not the nil UUID")
_INITIATOR = Check(lambda value: value.bytes[:10] == OBJECT_PREFIX, "DEA00000-6C97-11D1-8271-...")
_NAME = Check(re.compile(r"[A-Za-z0-9.-]+", re.ASCII).fullmatch, "letters, digits, hyphens and dots")  # type: ignore[arg-type]


def _priority(number: int) -> Check:
    return Check(lambda tag: tag >> PRIORITY_SHIFT == number, f"priority {number} in bits 15 to 13")


@dataclass(frozen=True, kw_only=True)
class ArBlockReq(Block):
    """The application relationship: who asks, and how long it may be silent before PrmEnd."""

    TYPE: ClassVar[int] = 0x0101
    ERROR_CODE1: ClassVar[int] = 0x01
    ar_type: int = u16(one_of(*ArType))
    ar_uuid: UUID = uuid(_NOT_NIL)
    session_key: int = u16()
    initiator_mac: bytes = octets(6, _UNICAST)
    initiator_object: UUID = uuid(_INITIATOR)
    properties: int = u32(Check(_properties_allowed, "active, parameterised by the initiator, companion AR 0..2"))
    activity_timeout: int = u16(between(1, 1000))
    """In 100 ms."""
    rt_port: int = u16()
    station_name: str = text(between(1, 240), _NAME)


@dataclass(frozen=True, kw_only=True)
class Place(Structure):
    """Place of the data object or the IOCS of a submodule in the C_SDU."""

    slot: int = u16()
    subslot: int = u16()
    offset: int = u16()


@dataclass(frozen=True, kw_only=True)
class IocrApi(Structure):
    """Data objects and IOCS of one API."""

    api: int = u32()
    data: tuple[Place, ...] = array(Place)
    iocs: tuple[Place, ...] = array(Place)


@dataclass(frozen=True, kw_only=True)
class IocrBlockReq(Block):
    """One cyclic relationship."""

    TYPE: ClassVar[int] = 0x0102
    ERROR_CODE1: ClassVar[int] = 0x02
    iocr_type: int = u16(one_of(*IocrType))
    reference: int = u16()
    lt: int = u16(one_of(LT_RT))
    properties: int = u32(one_of(*RtClass))
    data_length: int = u16(between(40, 1440))
    frame_id: int = u16()
    send_clock: int = u16(one_of(*(1 << power for power in range(8))))
    """In 31.25 us."""
    reduction_ratio: int = u16(between(1, 512))
    phase: int = u16()
    sequence: int = u16()
    frame_send_offset: int = u32()
    watchdog: int = u16(between(1, 0xFFFF))
    data_hold: int = u16(between(1, 0xFFFF))
    tag: int = u16(one_of(TAG_RT))
    multicast_mac: bytes = octets(6)
    apis: tuple[IocrApi, ...] = array(IocrApi, minimum=1)

    @property
    def cycle_ns(self) -> int:
        """Time between two frames."""
        return self.send_clock * self.reduction_ratio * TICK_NS

    @property
    def hold_ns(self) -> int:
        """Time without an accepted frame after which the relationship is lost."""
        return self.cycle_ns * self.data_hold


@dataclass(frozen=True, kw_only=True)
class AlarmCrBlockReq(Block):
    """The alarm relationship."""

    TYPE: ClassVar[int] = 0x0103
    ERROR_CODE1: ClassVar[int] = 0x04
    cr_type: int = u16(one_of(1))
    lt: int = u16(one_of(LT_RT))
    properties: int = u32()
    rta_timeout: int = u16(between(1, 100))
    """In 100 ms."""
    rta_retries: int = u16(between(3, 15))
    reference: int = u16()
    max_length: int = u16(between(200, 1432))
    tag_high: int = u16(_priority(6))
    tag_low: int = u16(_priority(5))


class SubmoduleDirection(enum.IntEnum):
    """SubmoduleProperties.Type."""

    NO_IO = 0
    INPUT = 1
    OUTPUT = 2
    INPUT_OUTPUT = 3


SUBMODULE_TYPE_MASK: Final = 0x0003
DISCARD_IOXS: Final = 0x0020
"""SubmoduleProperties: the frames have no IOPS and no IOCS of this submodule, whatever offsets the relationships name."""


def _descriptions(before: dict[str, Any]) -> int:
    return 2 if before["properties"] & SUBMODULE_TYPE_MASK == SubmoduleDirection.INPUT_OUTPUT else 1


@dataclass(frozen=True, kw_only=True)
class DataDescription(Structure):
    """Data of a submodule in one direction. Both status lengths are 1; a submodule without data has an input of length 0."""

    direction: int = u16(one_of(*IocrType))
    length: int = u16(between(0, 1439))
    length_iocs: int = u8(one_of(1), shift=1)
    """The codes of the two status lengths are in the reverse order of the fields."""
    length_iops: int = u8(one_of(1), shift=-1)


@dataclass(frozen=True, kw_only=True)
class ExpectedSubmodule(Structure):
    """The project's submodule in a subslot."""

    subslot: int = u16(between(1, 0x9FFF))
    ident: int = u32()
    properties: int = u16(between(0, 0x3F))
    descriptions: tuple[DataDescription, ...] = array(DataDescription, count=_descriptions)

    def length(self, direction: IocrType) -> int:
        """Bytes of data in a direction."""
        return sum(item.length for item in self.descriptions if item.direction == direction)

    @property
    def direction(self) -> SubmoduleDirection:
        return SubmoduleDirection(self.properties & SUBMODULE_TYPE_MASK)

    @property
    def without_status(self) -> bool:
        """Neither IOPS nor IOCS, as some controllers ask for with submodules without data."""
        return bool(self.properties & DISCARD_IOXS)


@dataclass(frozen=True, kw_only=True)
class ExpectedSlot(Structure):
    """The project's module in a slot."""

    api: int = u32()
    slot: int = u16(between(0, 0x7FFF))
    ident: int = u32(between(1, 0xFFFFFFFF))
    properties: int = u16()
    submodules: tuple[ExpectedSubmodule, ...] = array(ExpectedSubmodule, minimum=1)


@dataclass(frozen=True, kw_only=True)
class ExpectedSubmoduleBlockReq(Block):
    """The project's modules; a Connect may carry several."""

    TYPE: ClassVar[int] = 0x0104
    ERROR_CODE1: ClassVar[int] = 0x03
    slots: tuple[ExpectedSlot, ...] = array(ExpectedSlot, minimum=1)


@dataclass(frozen=True, kw_only=True)
class IrIocr(Structure):
    """Subframe of an IOCR of IRT."""

    reference: int = u16()
    subframe_offset: int = u16()
    subframe_data: int = u32()


@dataclass(frozen=True, kw_only=True)
class IrInfoBlock(Block):
    """The data of IRT for a relationship."""

    TYPE: ClassVar[int] = 0x0109
    pad: None = padding(2)
    ir_data_uuid: UUID = uuid()
    pad_2: None = padding(2)
    iocrs: tuple[IrIocr, ...] = array(IrIocr)


@dataclass(frozen=True, kw_only=True)
class SrInfoBlock(Block):
    """System redundancy."""

    TYPE: ClassVar[int] = 0x010A
    redundancy_data_hold_factor: int = u16()
    properties: int = u32()


@dataclass(frozen=True, kw_only=True)
class ArFsuBlock(Block):
    """Fast start-up: its parameters as a block."""

    TYPE: ClassVar[int] = 0x010B
    pad: None = padding(2)
    blocks: bytes = rest()


@dataclass(frozen=True, kw_only=True)
class ArBlockRes(Block):
    """The relationship is granted."""

    TYPE: ClassVar[int] = 0x8101
    ar_type: int = u16()
    ar_uuid: UUID = uuid()
    session_key: int = u16()
    responder_mac: bytes = octets(6)
    rt_port: int = u16()


@dataclass(frozen=True, kw_only=True)
class IocrBlockRes(Block):
    """A cyclic relationship is granted, with this FrameID."""

    TYPE: ClassVar[int] = 0x8102
    iocr_type: int = u16()
    reference: int = u16()
    frame_id: int = u16()


@dataclass(frozen=True, kw_only=True)
class AlarmCrBlockRes(Block):
    """The alarm relationship is granted; ``reference`` is the device's."""

    TYPE: ClassVar[int] = 0x8103
    cr_type: int = u16()
    reference: int = u16()
    max_length: int = u16()


@dataclass(frozen=True, kw_only=True)
class DiffSubmodule(Structure):
    """State of a subslot that differs from the project."""

    subslot: int = u16()
    ident: int = u32()
    state: int = u16()


@dataclass(frozen=True, kw_only=True)
class DiffModule(Structure):
    """State of a slot that differs from the project."""

    slot: int = u16()
    ident: int = u32()
    state: int = u16()
    submodules: tuple[DiffSubmodule, ...] = array(DiffSubmodule)


@dataclass(frozen=True, kw_only=True)
class DiffApi(Structure):
    """Differences in one API."""

    api: int = u32()
    modules: tuple[DiffModule, ...] = array(DiffModule)


@dataclass(frozen=True, kw_only=True)
class ModuleDiffBlock(Block):
    """Differences from the project."""

    TYPE: ClassVar[int] = 0x8104
    apis: tuple[DiffApi, ...] = array(DiffApi)


@dataclass(frozen=True, kw_only=True)
class ArServerBlockRes(Block):
    """The device's name, of an advanced start-up."""

    TYPE: ClassVar[int] = 0x8106
    station_name: str = text()
    pad: None = align()


class ModuleState(enum.IntEnum):
    """ModuleState of a ModuleDiffBlock."""

    NO_MODULE = 0
    WRONG = 1
    PROPER = 2
    SUBSTITUTE = 3


SUBMODULE_STATE: Final = 0x8000
"""SubmoduleState has the present format."""
IDENT_SHIFT: Final = 11
AR_INFO_SHIFT: Final = 7


class IdentInfo(enum.IntEnum):
    """SubmoduleState.IdentInfo."""

    OK = 0
    SUBSTITUTE = 1
    WRONG = 2
    NO_SUBMODULE = 3


class ArInfo(enum.IntEnum):
    """SubmoduleState.ARInfo."""

    OWN = 0
    APPLICATION_READY_PENDING = 1
    LOCKED = 3


REQUESTS: Final[dict[int, type[Block]]] = {
    block.TYPE: block for block in (ArBlockReq, IocrBlockReq, AlarmCrBlockReq, ExpectedSubmoduleBlockReq)
}
REFUSED_BLOCKS: Final[dict[int, int]] = {0x0105: 0x05, 0x0106: 0x06}
"""PrmServer and MCR are not served: ErrorCode1 of each; ErrorCode2 is 4, its first field."""
IGNORED_BLOCKS: Final = frozenset({0x0107, 0x0108, IrInfoBlock.TYPE, ArFsuBlock.TYPE})
"""ARRPC, ARVendor, IRInfo and FSU change nothing here."""
