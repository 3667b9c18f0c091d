"""PROFINET blocks as plain data: every block that ``profinet.blocks`` declares, by its fields.

Source: IEC 61158-6-10; the device uses the same declarations. Values are shown unchanged, valid or not. An undeclared block
has its type and its bytes.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator
from typing import Any, Final, TypeVar
from uuid import UUID

from pdgw.profinet.blocks import alarm, connect_blocks, control, port, record_blocks
from pdgw.profinet.blocks.alarm import (
    MESSAGE_CLASS_TEXTS,
    SPECIFIER_SHIFT,
    USI_CHANNEL_DIAGNOSIS,
    USI_EXTENDED_DIAGNOSIS,
    ChannelDiagnosis,
    DiagnosisBlock,
    ExtendedDiagnosis,
    MessageClass,
    Specifier,
)
from pdgw.profinet.blocks.connect_blocks import REFUSED_BLOCKS, REQUESTS
from pdgw.profinet.blocks.control import ControlBlock, ReleaseReq
from pdgw.profinet.blocks.port import PortData
from pdgw.profinet.blocks.record_blocks import MultipleBlock
from pdgw.profinet.model import INTERFACE_SUBSLOT
from pdgw.profinet.records import io_data
from pdgw.profinet.records.io_data import OutputData
from pdgw.profinet.rpc.identification import INDEX as IM_INDEX
from pdgw.profinet.rpc.identification import TEXT_FIELDS
from pdgw.profinet.rpc.records import PNIO, PnioStatus
from pdgw.profinet.wire import HEADER, VERSION_SIZE, Block, Cursor, Structure, WireError
from pdgw.tools.decoder.frames.fields import Document, name_in

Known = TypeVar("Known", bound=Block)
_MODULES = (alarm, connect_blocks, control, record_blocks, port, io_data)
BLOCKS: Final[dict[int, type[Block]]] = {
    cls.TYPE: cls
    for module in _MODULES
    for cls in vars(module).values()
    if isinstance(cls, type) and issubclass(cls, Block) and hasattr(cls, "TYPE")
}
"""Declared blocks by their type."""
_REQUESTS: Final[list[type[Block]]] = [*REQUESTS.values(), ControlBlock, ReleaseReq]
_REFUSABLE: Final = {cls.ERROR_CODE1: cls for cls in _REQUESTS}
"""Blocks of Connect, Control and Release by the ErrorCode1 that names them in a refusal."""
_UNDECLARED: Final = {code1: kind for kind, code1 in REFUSED_BLOCKS.items()}
_IM_TYPE: Final = 0x0020
_IM_NAMES: Final = {_IM_TYPE + number: f"I&M{number}" for number in range(len(TEXT_FIELDS) + 1)}
IM_INDEXES: Final = range(IM_INDEX, IM_INDEX + 16)
_TYPE_AND_LENGTH = struct.Struct(">HH")
_ALIGNMENT: Final = 4
_MAC_SIZE: Final = 6
_SPECIFIER_MASK: Final = 3


def split(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Type and whole bytes of blocks, with or without the padding records have between them; WireError at a damaged length."""
    at = 0
    while len(data) - at >= HEADER.size:
        kind, length = _TYPE_AND_LENGTH.unpack_from(data, at)
        padding = -at % _ALIGNMENT
        if padding and kind not in BLOCKS and not any(data[at : at + padding]):
            at += padding
            continue
        end = at + HEADER.size - VERSION_SIZE + length
        if length < VERSION_SIZE or end > len(data):
            raise WireError(f"BlockLength at offset {at}", length, f"{VERSION_SIZE}..{len(data) - at - 4}", number=1)
        yield kind, data[at:end]
        at = end


def read_blocks(data: bytes, cls: type[Known]) -> list[Known]:
    """The blocks of one type; WireError at a damaged one."""
    return [cls.understand(block) for kind, block in split(data) if kind == cls.TYPE]


def name_of(kind: int) -> str:
    """Name of a block."""
    if kind in BLOCKS:
        return BLOCKS[kind].__name__
    return _IM_NAMES.get(kind, f"block {kind:04X}h")


def status_text(status: PnioStatus) -> str:
    """A PNIO status for the reader: of a refused block the block and its field."""
    if status.decode == PNIO and status.code1 in _REFUSABLE:
        return f"faulty {_REFUSABLE[status.code1].field_at(status.code2)} ({status.codes})"
    if status.decode == PNIO and status.code1 in _UNDECLARED:
        return f"faulty {name_of(_UNDECLARED[status.code1])}, field {status.code2} ({status.codes})"
    return status.text


def documents(data: bytes) -> list[Document]:
    """All blocks; a damaged one ends the list with its error."""
    found: list[Document] = []
    try:
        found.extend(_block(kind, block) for kind, block in split(data))
    except WireError as error:
        found.append({"error": str(error)})
    return found


def named(blocks: list[Document]) -> str:
    """The names of the blocks in one line."""
    return ", ".join(block.get("name", "damaged block") for block in blocks)


def _block(kind: int, data: bytes) -> Document:
    document: Document = {"type": kind, "name": name_of(kind)}
    cls = BLOCKS.get(kind)
    if cls is None:
        return document | {"data": data[HEADER.size :].hex()}
    try:
        block = cls.understand(data)
    except WireError as error:
        return document | {"error": str(error), "data": data[HEADER.size :].hex()}
    document |= fields_of(block)
    if isinstance(block, MultipleBlock | PortData | connect_blocks.ArFsuBlock):
        document["blocks"] = documents(block.blocks)
    elif isinstance(block, OutputData):
        document["blocks"] = documents(block.content[block.length + block.length_iocs + block.length_iops :])
    elif isinstance(block, DiagnosisBlock) and block.usi in DIAGNOSES:
        document["entries"] = diagnoses(block.entries, block.usi)
    return document


def fields_of(structure: Structure) -> Document:
    """The fields of a structure by their names; UUIDs and bytes as text, reserved ones left out."""
    values = ((item.name, getattr(structure, item.name)) for item in dataclasses.fields(structure))  # type: ignore[arg-type]
    return {name: _plain(value) for name, value in values if value is not None}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Structure):
        return fields_of(value)
    if isinstance(value, bytes):
        return value.hex(":") if len(value) == _MAC_SIZE else value.hex()
    return str(value) if isinstance(value, UUID) else value


def place_text(slot: int, subslot: int) -> str:
    """Text for a submodule's place. Interface and port have hexadecimal numbers."""
    return f"slot {slot}.{subslot:04X}h" if subslot >= INTERFACE_SUBSLOT else f"slot {slot}.{subslot}"


DIAGNOSES: Final = {USI_CHANNEL_DIAGNOSIS: ChannelDiagnosis, USI_EXTENDED_DIAGNOSIS: ExtendedDiagnosis}
"""Entries of diagnosis by their UserStructureIdentifier."""


def diagnoses(entries: bytes, usi: int) -> list[Document]:
    """Channel diagnosis, each entry with its text; what is cut short is left out. ``usi``: one of DIAGNOSES."""
    found: list[Document] = []
    cursor = Cursor(entries, checked=False)
    while cursor.left:
        try:
            entry = DIAGNOSES[usi].read(cursor)
        except WireError:
            break
        found.append(fields_of(entry) | {"text": diagnosis_text(entry)})
    return found


def diagnosis_text(entry: ChannelDiagnosis) -> str:
    """Text of an entry."""
    specifier = entry.properties >> SPECIFIER_SHIFT & _SPECIFIER_MASK
    subtype = f", {entry.ext_error_type:04X}h" if isinstance(entry, ExtendedDiagnosis) else ""
    what = f"channel error {entry.error_type:04X}h{subtype}"
    if entry.error_type in set(MessageClass):
        what = MESSAGE_CLASS_TEXTS[MessageClass(entry.error_type)]
    return f"{what} {name_in(Specifier, specifier)}".rstrip()
