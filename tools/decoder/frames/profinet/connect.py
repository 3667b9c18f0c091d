"""Relationships of PROFINET: stations, cyclic frames by a Connect, and their records.

MAC addresses of stations are from DCP and Connect; FrameIDs, directions and places of the data of each submodule from a
Connect. Also records beside cyclic frames and parameters: relationships that come and go, DCP, LLDP, alarms. Source: IEC
61158-6-10, by the blocks that ``profinet.blocks.connect_blocks`` declares. For captures only: a Connect that a device would
refuse is decoded too, other blocks are skipped. Not here: multicast relationships, several API numbers with the same slots.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final

from pdgw.profidrive.telegrams import Direction
from pdgw.profinet.blocks.connect_blocks import (
    ArBlockReq,
    ArBlockRes,
    ArServerBlockRes,
    ExpectedSubmodule,
    ExpectedSubmoduleBlockReq,
    IocrBlockReq,
    IocrBlockRes,
    IocrType,
)
from pdgw.profinet.connection.connect import CyclicPlan, DataObject
from pdgw.profinet.model import API_PROFIDRIVE, Subslot
from pdgw.tools.decoder.frames.profinet.blocks import read_blocks
from pdgw.tools.decoder.frames.records import AcyclicRecord

_STATIONS_MAX: Final = 4096


class StationNames:
    """Names of station by MAC address."""

    def __init__(self) -> None:
        self._names: dict[bytes, str] = {}

    def learn(self, mac: bytes, name: str) -> None:
        """A station has reported its name, or has received one."""
        if mac in self._names or len(self._names) < _STATIONS_MAX:
            self._names[mac] = name

    def of(self, mac: bytes) -> str:
        """The name; empty where it is not known."""
        return self._names.get(mac, "")

    def shown(self, mac: bytes) -> str:
        """Name or MAC address, for the reader."""
        return self.of(mac) or mac.hex(":")


_TYPES: Final = {Direction.ACTUAL: IocrType.INPUT, Direction.SETPOINT: IocrType.OUTPUT}
"""Input and output relationship, seen from the controller."""


@dataclass(frozen=True)
class Connection:
    """A Connect: its relationships with the data of the submodules, and both stations."""

    relations: tuple[tuple[Direction, CyclicPlan], ...]
    submodules: Mapping[Subslot, ExpectedSubmodule] = field(default_factory=dict)
    profidrive: frozenset[Subslot] = frozenset()
    """The submodules of PROFIdrive's API."""
    ar: ArBlockReq | None = None
    device_mac: bytes | None = None
    station: str = ""
    """The device's name, if known."""

    def answered(self, arguments: bytes) -> Connection:
        """With the device's answer: FrameIDs, its MAC address and, in an advanced start-up, its name.

        ProfidriveError when a block is damaged.
        """
        frame_ids = {block.reference: block.frame_id for block in read_blocks(arguments, IocrBlockRes)}
        mac = next((block.responder_mac for block in read_blocks(arguments, ArBlockRes)), None)
        station = next((block.station_name for block in read_blocks(arguments, ArServerBlockRes)), self.station)
        relations = tuple(
            (direction, replace(plan, frame_id=frame_ids.get(plan.block.reference, plan.frame_id)))
            for direction, plan in self.relations
        )
        return replace(self, relations=relations, device_mac=mac, station=station)

    @property
    def controller(self) -> str:
        """The controller's name; empty where it is not known."""
        return "" if self.ar is None else self.ar.station_name

    @property
    def places(self) -> list[Subslot]:
        """The submodules with data in either direction, by slot."""
        return sorted(place for place in self.submodules if any(self.sizes(place)))

    def sizes(self, place: Subslot) -> list[int]:
        """Bytes of data of a submodule in each direction."""
        return [self.submodules[place].length(_TYPES[direction]) for direction in Direction]

    def plan(self, direction: Direction) -> CyclicPlan | None:
        """The relationship of a direction, for a protocol machine of this end."""
        return next((plan for found, plan in self.relations if found is direction), None)

    def addresses(self, direction: Direction) -> bytes | None:
        """Destination and source of the frames of a direction; None where one of them is not known."""
        if self.ar is None or self.device_mac is None:
            return None
        ends = (self.device_mac, self.ar.initiator_mac)
        return b"".join(ends if direction is Direction.SETPOINT else reversed(ends))

    def is_between(self, addresses: bytes) -> bool:
        """Whether frames with this destination and source belong to it."""
        return any(self.addresses(direction) == addresses for direction in Direction)


def read_request(arguments: bytes) -> Connection:
    """The relationships of a Connect request; ProfidriveError when a block is damaged."""
    ar = next(iter(read_blocks(arguments, ArBlockReq)), None)
    slots = [slot for block in read_blocks(arguments, ExpectedSubmoduleBlockReq) for slot in block.slots]
    submodules = {(slot.slot, item.subslot): item for slot in slots for item in slot.submodules}
    profidrive = {(slot.slot, item.subslot) for slot in slots if slot.api == API_PROFIDRIVE for item in slot.submodules}
    relations = [
        (direction, _plan(block, submodules))
        for block in read_blocks(arguments, IocrBlockReq)
        for direction, kind in _TYPES.items()
        if block.iocr_type == kind
    ]
    return Connection(tuple(relations), submodules, frozenset(profidrive), ar)


def _plan(block: IocrBlockReq, submodules: Mapping[Subslot, ExpectedSubmodule]) -> CyclicPlan:
    """The relationship with the data of the submodules that were asked for."""
    data = {}
    for item in (item for api in block.apis for item in api.data):
        submodule = submodules.get((item.slot, item.subslot))
        length = 0 if submodule is None else submodule.length(IocrType(block.iocr_type))
        data[item.slot, item.subslot] = DataObject(item.offset, length)
    iocs = {(item.slot, item.subslot): item.offset for api in block.apis for item in api.iocs}
    return CyclicPlan(block, block.frame_id, data, iocs)


class Change(enum.Enum):
    """Changes of a relationship."""

    REQUESTED = "requested"
    GRANTED = "granted"
    READY = "confirmed: cyclic data is valid"
    PAUSED = "parameterised again: cyclic data is not valid"
    ENDED = "ended"


@dataclass(slots=True)
class RelationRecord(AcyclicRecord):
    """A call that changes a relationship of the station that is read, where its Connect was seen."""

    change: Change = field(kw_only=True)
    connection: Connection = field(kw_only=True)


@dataclass(slots=True)
class StationRecord(AcyclicRecord):
    """A frame of the station itself, no call. ``kind`` is that of the protocol."""


@dataclass(slots=True)
class DcpRecord(StationRecord):
    """Discovery and configuration: stations, names and addresses."""

    kind: ClassVar[str] = "dcp"


@dataclass(slots=True)
class LldpRecord(StationRecord):
    """Name of the LLDP neighbour."""

    kind: ClassVar[str] = "lldp"


@dataclass(slots=True)
class AlarmRecord(StationRecord):
    """A PDU of an alarm relationship."""

    kind: ClassVar[str] = "alarm"

    slot: int = field(kw_only=True, default=0)
    """Slot of the submodule in a notification; 0 in others and for the device itself."""
    is_notification: bool = field(kw_only=True, default=False)
    """Whether it is a notification and not an acknowledgement."""
    ended: Connection | None = field(kw_only=True, default=None)
    """The relationship an ERR ends, where its Connect was seen."""
