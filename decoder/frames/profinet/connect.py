"""Cyclic frames by a PROFINET Connect: FrameIDs, directions, places of the data of each submodule.

Source: IEC 61158-6-10, by the blocks ``profinet.blocks.connect`` declares. For captures only: a Connect that a
device would refuse is decoded too, other blocks are skipped. Not here: multicast relationships, several API numbers with the
same slots.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from pdgw.decoder.frames.profinet.blocks import split
from pdgw.profidrive.telegrams import Direction
from pdgw.profinet.blocks.connect import (
    ArBlockReq,
    ArBlockRes,
    ArServerBlockRes,
    ExpectedSlot,
    ExpectedSubmoduleBlockReq,
    IocrBlockReq,
    IocrBlockRes,
    IocrType,
)
from pdgw.profinet.connection.connect import CyclicPlan, DataObject
from pdgw.profinet.model import API_PROFIDRIVE

Place = tuple[int, int]
"""Slot and subslot."""
_DIRECTIONS = {IocrType.INPUT: Direction.ACTUAL, IocrType.OUTPUT: Direction.SETPOINT}
"""Input and output relationship, seen from the controller."""


@dataclass(frozen=True)
class CyclicRelation:
    """One communication relationship. Offsets count from the first byte of the C_SDU."""

    direction: Direction
    frame_id: int
    block: IocrBlockReq
    data: Mapping[Place, int]
    """Offset of the data of each submodule; its IOPS follows."""
    iocs: Mapping[Place, int]


@dataclass(frozen=True)
class Connection:
    """A Connect: its relationships, the data lengths of the submodules by direction, and both stations."""

    relations: tuple[CyclicRelation, ...]
    lengths: Mapping[tuple[Place, Direction], int] = field(default_factory=dict)
    idents: Mapping[Place, int] = field(default_factory=dict)
    """SubmoduleIdentNumber of each submodule."""
    profidrive: frozenset[Place] = frozenset()
    """The submodules of PROFIdrive's API."""
    ar: ArBlockReq | None = None
    device_mac: bytes | None = None
    station: str = ""
    """The device's name, if known."""

    def answered(self, response: Response) -> Connection:
        """With what the device's answer says."""
        relations = tuple(
            replace(item, frame_id=response.frame_ids.get(item.block.reference, item.frame_id))
            for item in self.relations
        )
        return replace(self, relations=relations, device_mac=response.mac, station=response.station or self.station)

    @property
    def controller(self) -> str:
        """The controller's name; empty where it is not known."""
        return "" if self.ar is None else self.ar.station_name

    @property
    def places(self) -> list[Place]:
        """The submodules with data in either direction, by slot."""
        return sorted({place for (place, _), length in self.lengths.items() if length})

    def relation(self, direction: Direction) -> CyclicRelation | None:
        """The relationship of a direction."""
        return next((item for item in self.relations if item.direction is direction), None)

    def addresses(self, direction: Direction) -> bytes | None:
        """Destination and source of the frames of a direction; None where one of them is not known."""
        if self.ar is None or self.device_mac is None:
            return None
        ends = (self.device_mac, self.ar.initiator_mac)
        return b"".join(ends if direction is Direction.SETPOINT else reversed(ends))

    def is_between(self, addresses: bytes) -> bool:
        """Whether frames with this destination and source belong to it."""
        return any(self.addresses(direction) == addresses for direction in Direction)

    def plan(self, direction: Direction) -> CyclicPlan | None:
        """The cyclic plan for a protocol machine of this end; None without a relationship of this direction."""
        relation = self.relation(direction)
        if relation is None:
            return None
        data = {
            place: DataObject(offset, self.lengths.get((place, direction), 0))
            for place, offset in relation.data.items()
        }
        return CyclicPlan(relation.block, relation.frame_id, data, relation.iocs)


@dataclass(frozen=True)
class Response:
    """The values granted by a device: FrameIDs by IOCRReference, its MAC address and, in an advanced start-up, its name."""

    frame_ids: Mapping[int, int]
    mac: bytes | None = None
    station: str = ""


def read_request(arguments: bytes) -> Connection:
    """The relationships of a Connect request; ProfidriveError when a block is damaged."""
    relations = []
    lengths: dict[tuple[Place, Direction], int] = {}
    idents: dict[Place, int] = {}
    profidrive: set[Place] = set()
    ar = None
    for kind, data in split(arguments):
        if kind == ArBlockReq.TYPE:
            ar = ArBlockReq.understand(data)
        elif kind == IocrBlockReq.TYPE:
            relation = _relation(IocrBlockReq.understand(data))
            if relation is not None:
                relations.append(relation)
        elif kind == ExpectedSubmoduleBlockReq.TYPE:
            for slot in ExpectedSubmoduleBlockReq.understand(data).slots:
                _submodules(slot, lengths, idents)
                if slot.api == API_PROFIDRIVE:
                    profidrive |= {(slot.slot, item.subslot) for item in slot.submodules}
    return Connection(tuple(relations), lengths, idents, frozenset(profidrive), ar)


def read_response(arguments: bytes) -> Response:
    """Decode a Connect response; ProfidriveError when a block is damaged."""
    frame_ids = {}
    mac, station = None, ""
    for kind, data in split(arguments):
        if kind == IocrBlockRes.TYPE:
            block = IocrBlockRes.understand(data)
            frame_ids[block.reference] = block.frame_id
        elif kind == ArBlockRes.TYPE:
            mac = ArBlockRes.understand(data).responder_mac
        elif kind == ArServerBlockRes.TYPE:
            station = ArServerBlockRes.understand(data).station_name
    return Response(frame_ids, mac, station)


def _relation(block: IocrBlockReq) -> CyclicRelation | None:
    if block.iocr_type not in set(IocrType):
        return None
    data = {(item.slot, item.subslot): item.offset for api in block.apis for item in api.data}
    iocs = {(item.slot, item.subslot): item.offset for api in block.apis for item in api.iocs}
    return CyclicRelation(_DIRECTIONS[IocrType(block.iocr_type)], block.frame_id, block, data, iocs)


def _submodules(slot: ExpectedSlot, lengths: dict[tuple[Place, Direction], int], idents: dict[Place, int]) -> None:
    for item in slot.submodules:
        place = (slot.slot, item.subslot)
        idents[place] = item.ident
        for kind, direction in _DIRECTIONS.items():
            length = item.length(kind)
            if length:
                lengths[place, direction] = length
