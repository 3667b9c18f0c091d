"""What a PROFINET Connect says about cyclic frames: FrameIDs, directions, where the data of each submodule lies.

Source: IEC 61158-6-10 (IOCRBlockReq, IOCRBlockRes, ExpectedSubmoduleBlockReq) as scapy's ``pnio_rpc`` and the tshark dissector
read it. Read only, to understand a capture; other blocks are skipped. Left out: multicast relationships, several API numbers
with the same slots.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.telegrams import Direction

_HEADER = struct.Struct(">HHxx")
_IOCR_REQUEST = struct.Struct(">HHHIHHHHHHIHHH6s")
_IOCR_RESPONSE = struct.Struct(">HHH")
_SUBMODULE_API = struct.Struct(">IHIHH")
_SUBMODULE = struct.Struct(">HIH")
_DESCRIPTION = struct.Struct(">HHBB")
_PLACE = struct.Struct(">HHH")
_INPUT_OUTPUT = 3

Place = tuple[int, int]
"""Slot and subslot."""
_DIRECTIONS = {1: Direction.ACTUAL, 2: Direction.SETPOINT}
"""Input and output relationship, seen from the controller."""


class _Block(enum.IntEnum):
    IOCR_REQUEST = 0x0102
    EXPECTED_SUBMODULE = 0x0104
    IOCR_RESPONSE = 0x8102


@dataclass(frozen=True)
class CyclicRelation:
    """One communication relationship. Offsets count from the first byte of the C_SDU."""

    reference: int
    direction: Direction
    frame_id: int
    data: Mapping[Place, int]
    """Where the data of each submodule begins; its IOPS follows."""
    iocs: Mapping[Place, int]


@dataclass(frozen=True)
class Connection:
    """A Connect request: relationships, and the data lengths of the submodules by direction."""

    relations: tuple[CyclicRelation, ...]
    lengths: Mapping[tuple[Place, Direction], int] = field(default_factory=dict)
    idents: Mapping[Place, int] = field(default_factory=dict)
    """SubmoduleIdentNumber of each submodule."""

    def answered(self, frame_ids: Mapping[int, int]) -> Connection:
        """With the FrameIDs the device chose, by IOCRReference."""
        relations = (replace(item, frame_id=frame_ids.get(item.reference, item.frame_id)) for item in self.relations)
        return replace(self, relations=tuple(relations))

    @property
    def places(self) -> list[Place]:
        """The submodules with data in either direction, by slot."""
        return sorted({place for (place, _), length in self.lengths.items() if length})


class _Fields:
    """Structures one behind the other; ProfidriveError at the end of the data."""

    def __init__(self, data: bytes, what: str) -> None:
        self._data = data
        self._at = 0
        self._what = what

    def take(self, layout: struct.Struct) -> tuple[int, ...]:
        if self._at + layout.size > len(self._data):
            missing = self._at + layout.size - len(self._data)
            raise ProfidriveError(self._what, f"{len(self._data)} bytes", f"{missing} more bytes")
        values = layout.unpack_from(self._data, self._at)
        self._at += layout.size
        return values

    def number(self) -> int:
        return self.take(_WORD)[0]


_WORD = struct.Struct(">H")
_DOUBLE_WORD = struct.Struct(">I")


def _blocks(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + _HEADER.size <= len(data):
        kind, length = _HEADER.unpack_from(data, at)
        end = at + 4 + length
        if length < 2 or end > len(data):
            raise ProfidriveError(f"BlockLength at offset {at}", length, f"2..{len(data) - at - 4}")
        yield kind, data[at + _HEADER.size : end]
        at = end


def read_request(arguments: bytes) -> Connection:
    """The relationships of a Connect request; ProfidriveError when a block is damaged."""
    relations = []
    lengths: dict[tuple[Place, Direction], int] = {}
    idents: dict[Place, int] = {}
    for kind, body in _blocks(arguments):
        if kind == _Block.IOCR_REQUEST:
            relation = _relation(_Fields(body, "IOCRBlockReq"))
            if relation is not None:
                relations.append(relation)
        elif kind == _Block.EXPECTED_SUBMODULE:
            _submodules(_Fields(body, "ExpectedSubmoduleBlockReq"), lengths, idents)
    return Connection(tuple(relations), lengths, idents)


def read_response(arguments: bytes) -> dict[int, int]:
    """FrameID by IOCRReference of a Connect response; ProfidriveError when a block is damaged."""
    frame_ids = {}
    for kind, body in _blocks(arguments):
        if kind == _Block.IOCR_RESPONSE:
            _, reference, frame_id = _Fields(body, "IOCRBlockRes").take(_IOCR_RESPONSE)
            frame_ids[reference] = frame_id
    return frame_ids


def _relation(fields: _Fields) -> CyclicRelation | None:
    kind, reference, _, _, _, frame_id, *_ = fields.take(_IOCR_REQUEST)
    data: dict[Place, int] = {}
    iocs: dict[Place, int] = {}
    for _ in range(fields.number()):
        fields.take(_DOUBLE_WORD)
        for places in (data, iocs):
            for _ in range(fields.number()):
                slot, subslot, offset = fields.take(_PLACE)
                places[slot, subslot] = offset
    direction = _DIRECTIONS.get(kind)
    return None if direction is None else CyclicRelation(reference, direction, frame_id, data, iocs)


def _submodules(fields: _Fields, lengths: dict[tuple[Place, Direction], int], idents: dict[Place, int]) -> None:
    for _ in range(fields.number()):
        _, slot, _, _, count = fields.take(_SUBMODULE_API)
        for _ in range(count):
            subslot, ident, properties = fields.take(_SUBMODULE)
            idents[slot, subslot] = ident
            for _ in range(2 if properties & 3 == _INPUT_OUTPUT else 1):
                kind, length, _, _ = fields.take(_DESCRIPTION)
                if kind in _DIRECTIONS and length:
                    lengths[(slot, subslot), _DIRECTIONS[kind]] = length
