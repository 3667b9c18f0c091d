"""Blocks of the records a device serves of itself: identification, interface, port, relationships.

Source: IEC 61158-6-10, as tshark reads them. Inside a record fields align to 4 bytes from the start of the block.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar
from uuid import UUID

from pdgw.profinet.wire import Block, Structure, align, array, octets, padding, rest, text, u8, u16, u32, uuid


@dataclass(frozen=True, kw_only=True)
class IdentSubmodule(Structure):
    """Submodule in a subslot."""

    subslot: int = u16()
    ident: int = u32()


@dataclass(frozen=True, kw_only=True)
class IdentSlot(Structure):
    """Module in a slot."""

    slot: int = u16()
    ident: int = u32()
    submodules: tuple[IdentSubmodule, ...] = array(IdentSubmodule)


@dataclass(frozen=True, kw_only=True)
class IdentApi(Structure):
    """Contents of an API."""

    api: int = u32()
    slots: tuple[IdentSlot, ...] = array(IdentSlot)


@dataclass(frozen=True, kw_only=True)
class IdentificationData(Block):
    """Modules and submodules; several records have this content."""

    apis: tuple[IdentApi, ...] = array(IdentApi)


@dataclass(frozen=True, kw_only=True)
class ExpectedIdentification(IdentificationData):
    """Identification in the project."""

    TYPE: ClassVar[int] = 0x0012
    VERSION: ClassVar[tuple[int, int]] = (1, 1)


@dataclass(frozen=True, kw_only=True)
class RealIdentification(IdentificationData):
    """Identification of the plugged modules."""

    TYPE: ClassVar[int] = 0x0013
    VERSION: ClassVar[tuple[int, int]] = (1, 1)


@dataclass(frozen=True, kw_only=True)
class ImFilterSubmodules(IdentificationData):
    """Submodules with I&M of their own."""

    TYPE: ClassVar[int] = 0x0030


@dataclass(frozen=True, kw_only=True)
class ImFilterModules(IdentificationData):
    """Modules with I&M of their own."""

    TYPE: ClassVar[int] = 0x0031


@dataclass(frozen=True, kw_only=True)
class ImFilterDevice(IdentificationData):
    """The submodule whose I&M is that of the device."""

    TYPE: ClassVar[int] = 0x0032


@dataclass(frozen=True, kw_only=True)
class Peer(Structure):
    """The neighbour of a port."""

    port_id: str = text(size="B")
    chassis_id: str = text(size="B")
    pad: None = align()
    line_delay: int = u32(default=0)
    mac: bytes = octets(6)
    end: None = align()


@dataclass(frozen=True, kw_only=True)
class PortDataReal(Block):
    """State of a port; without a neighbour ``peers`` is empty."""

    TYPE: ClassVar[int] = 0x020F
    reserved: None = padding(2)
    slot: int = u16()
    subslot: int = u16()
    port_id: str = text(size="B")
    number_of_peers: int = u8()
    pad: None = align()
    peers: tuple[Peer, ...] = array(Peer, count=lambda before: int(before["number_of_peers"]))
    mau_type: int = u16()
    pad_2: None = padding(2)
    domain_boundary: int = u32(default=0)
    multicast_boundary: int = u32(default=0)
    link_state_port: int = u8(default=0)
    link_state: int = u8()
    pad_3: None = padding(2)
    media_type: int = u32()


@dataclass(frozen=True, kw_only=True)
class InterfaceDataReal(Block):
    """State of the interface."""

    TYPE: ClassVar[int] = 0x0240
    chassis_id: str = text(size="B")
    pad: None = align()
    mac: bytes = octets(6)
    pad_2: None = align()
    ip: bytes = octets(4)
    mask: bytes = octets(4)
    gateway: bytes = octets(4)


@dataclass(frozen=True, kw_only=True)
class PortStatistic(Block):
    """Counters of the interface or the port."""

    TYPE: ClassVar[int] = 0x0251
    reserved: None = padding(2)
    in_octets: int = u32()
    out_octets: int = u32()
    in_discards: int = u32(default=0)
    out_discards: int = u32(default=0)
    in_errors: int = u32(default=0)
    out_errors: int = u32(default=0)


@dataclass(frozen=True, kw_only=True)
class MultipleBlock(Block):
    """Blocks of one submodule in a record of the whole device."""

    TYPE: ClassVar[int] = 0x0400
    reserved: None = padding(2)
    api: int = u32()
    slot: int = u16()
    subslot: int = u16()
    blocks: bytes = rest()


@dataclass(frozen=True, kw_only=True)
class Api(Structure):
    """One API."""

    api: int = u32()


@dataclass(frozen=True, kw_only=True)
class ApiData(Block):
    """The APIs of the device."""

    TYPE: ClassVar[int] = 0x001A
    apis: tuple[Api, ...] = array(Api)


@dataclass(frozen=True, kw_only=True)
class ArIocr(Structure):
    """A cyclic relationship with the status of its last frame."""

    iocr_type: int = u16()
    properties: int = u32()
    frame_id: int = u16()
    cycle_counter: int = u16()
    data_status: int = u8()
    transfer_status: int = u8()
    initiator_port: int = u16()
    responder_port: int = u16()


@dataclass(frozen=True, kw_only=True)
class ArEntry(Structure):
    """An application relationship; there is no parameter server."""

    ar_uuid: UUID = uuid()
    ar_type: int = u16()
    properties: int = u32()
    initiator_object: UUID = uuid()
    station_name: str = text()
    iocrs: tuple[ArIocr, ...] = array(ArIocr)
    alarm_type: int = u16(default=0)
    local_reference: int = u16(default=0)
    remote_reference: int = u16(default=0)
    server_object: UUID = uuid(default=UUID(int=0))
    server_name: str = text()
    apis: tuple[Api, ...] = array(Api)


@dataclass(frozen=True, kw_only=True)
class ArData(Block):
    """All relationships of the device."""

    TYPE: ClassVar[int] = 0x0018
    ars: tuple[ArEntry, ...] = array(ArEntry)


@dataclass(frozen=True, kw_only=True)
class LogEntry(Structure):
    """The end of a relationship in the log."""

    time: bytes = octets(8)
    ar_uuid: UUID = uuid()
    status: int = u32()
    detail: int = u32()


@dataclass(frozen=True, kw_only=True)
class LogData(Block):
    """The last relationships' ends; times are nanoseconds since start."""

    TYPE: ClassVar[int] = 0x0019
    time: bytes = octets(8)
    entries: tuple[LogEntry, ...] = array(LogEntry)
