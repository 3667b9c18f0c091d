"""PROFINET IO record services inside DCE/RPC: NDR arguments, IODRead/IODWrite blocks, PNIO status.

Source: IEC 61158-6-10 as scapy's ``pnio_rpc`` and the tshark dissector read it (docs/plc.md "Acyclic channel"). Blocks are
big-endian whatever the data representation of the RPC packet. Left out: Connect, Control, Release.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass
from uuid import UUID

from pdgw.profidrive.errors import ProfidriveError

RECORD_LOCAL = 0xB02E
"""Parameter access point, local: the slot chooses the axis."""
RECORD_GLOBAL = 0xB02F
"""Parameter access point, global: the DO-ID of the request chooses the axis."""
RECORD_DRIVE = 0x2F
"""As RECORD_GLOBAL; what SINAMICS drives also serve, and older function blocks of S7 use."""
PARAMETER_RECORDS = frozenset({RECORD_LOCAL, RECORD_GLOBAL, RECORD_DRIVE})
"""Requests and responses of the parameter channel."""
RECORD_MULTIPLE = 0xE040
"""Several writes in one."""
NIL = UUID(int=0)


class Operation(enum.IntEnum):
    """RPC operation numbers of the device interface."""

    CONNECT = 0
    RELEASE = 1
    READ = 2
    WRITE = 3
    CONTROL = 4
    READ_IMPLICIT = 5


class BlockType(enum.IntEnum):
    """Blocks of the record services."""

    WRITE_REQUEST = 0x0008
    READ_REQUEST = 0x0009
    WRITE_RESPONSE = 0x8008
    READ_RESPONSE = 0x8009


@dataclass(frozen=True, slots=True)
class PnioStatus:
    """ErrorCode, ErrorDecode, ErrorCode1, ErrorCode2; all 0 is success."""

    code: int = 0
    decode: int = 0
    code1: int = 0
    code2: int = 0

    @property
    def value(self) -> int:
        """As one UNSIGNED32."""
        return self.code << 24 | self.decode << 16 | self.code1 << 8 | self.code2

    @classmethod
    def of(cls, value: int) -> PnioStatus:
        return cls(value >> 24 & 0xFF, value >> 16 & 0xFF, value >> 8 & 0xFF, value & 0xFF)

    @property
    def text(self) -> str:
        """For the reader."""
        if not self.value:
            return "OK"
        known = _CODE1_TEXTS.get(self.code1) if self.decode == PNIORW else None
        if (self.decode, self.code1) == (PNIO, CMRPC):
            known = _CALL_TEXTS.get(self.code2)
        return f"{known or 'error'} ({self.codes})"

    @property
    def codes(self) -> str:
        """The four bytes."""
        return f"{self.code:02X} {self.decode:02X} {self.code1:02X} {self.code2:02X}"


READ_ERROR = 0xDE
WRITE_ERROR = 0xDF
PNIORW = 0x80
PNIO = 0x81
CMRPC = 0x40


class CallError(enum.IntEnum):
    """ErrorCode2 of a call refused as a whole (decode PNIO, ErrorCode1 CMRPC)."""

    ARGS_LENGTH = 0
    UNKNOWN_BLOCK = 1
    IOCR_MISSING = 2
    BLOCK_COUNT = 3
    NO_AR_FREE = 4
    AR_UNKNOWN = 5
    WRONG_STATE = 6


_CALL_TEXTS: dict[int, str] = {
    CallError.ARGS_LENGTH: "length of the arguments",
    CallError.UNKNOWN_BLOCK: "unknown block",
    CallError.IOCR_MISSING: "IOCR missing",
    CallError.BLOCK_COUNT: "wrong number of blocks",
    CallError.NO_AR_FREE: "no AR free",
    CallError.AR_UNKNOWN: "AR UUID unknown",
    CallError.WRONG_STATE: "wrong state",
}


class AccessError(enum.IntEnum):
    """ErrorCode1 of a refused record access (decode PNIORW)."""

    READ_ERROR = 0xA0
    WRITE_ERROR = 0xA1
    INVALID_INDEX = 0xB0
    WRITE_LENGTH = 0xB1
    INVALID_SLOT = 0xB2
    TYPE_CONFLICT = 0xB3
    INVALID_AREA = 0xB4
    STATE_CONFLICT = 0xB5
    ACCESS_DENIED = 0xB6
    INVALID_RANGE = 0xB7
    INVALID_PARAMETER = 0xB8
    RESOURCE_UNAVAILABLE = 0xC3


_CODE1_TEXTS: dict[int, str] = {
    item: item.name.lower().replace("_", " ").replace("invalid slot", "invalid slot or subslot") for item in AccessError
}


class RecordRefused(ProfidriveError):  # noqa: N818 (an answer, not a fault of the program)
    """A record access that is refused; the service makes it a status DE (read) or DF (write)."""

    def __init__(self, error: AccessError, code2: int = 0, *, decode: int = PNIORW) -> None:
        self.code1 = int(error)
        self.code2 = code2
        self.decode = decode
        super().__init__("record access", f"{self.code1:02X}h", error.name.lower().replace("_", " "))

    def status(self, operation: Operation) -> PnioStatus:
        code = WRITE_ERROR if operation is Operation.WRITE else READ_ERROR
        return PnioStatus(code, self.decode, self.code1, self.code2)


class UnknownArUuid(RecordRefused):
    """The AR of the request is not one of this device."""

    def __init__(self) -> None:
        super().__init__(AccessError.READ_ERROR, CallError.AR_UNKNOWN, decode=PNIO)
        self.code1 = CMRPC


@dataclass(frozen=True, slots=True)
class RecordBlock:
    """An IODRead/IODWrite header. ``length`` is RecordDataLength: of the data, or the maximum in a read request."""

    type: BlockType
    sequence: int
    ar_uuid: UUID
    api: int
    slot: int
    subslot: int
    index: int
    length: int
    target_ar_uuid: UUID = NIL
    """Read Implicit only."""
    status: PnioStatus = PnioStatus()
    """Write response only."""

    def answer(self, length: int, status: PnioStatus) -> RecordBlock:
        """The header of the response."""
        kind = BlockType.WRITE_RESPONSE if self.type is BlockType.WRITE_REQUEST else BlockType.READ_RESPONSE
        shown = status if kind is BlockType.WRITE_RESPONSE else PnioStatus()
        return RecordBlock(
            kind, self.sequence, self.ar_uuid, self.api, self.slot, self.subslot, self.index, length, status=shown
        )


_COMMON = struct.Struct(">HHBBH16sIHH2xHI")
_TAIL = struct.Struct(">16s8x")
_WRITE_RESPONSE_TAIL = struct.Struct(">HHI16x")
_LENGTH = struct.Struct(">I")
BLOCK_SIZE = _COMMON.size + _TAIL.size
_BLOCK_LENGTH = BLOCK_SIZE - 4


def encode_block(block: RecordBlock) -> bytes:
    """The 64 bytes of the header."""
    common = _COMMON.pack(
        block.type,
        _BLOCK_LENGTH,
        1,
        0,
        block.sequence,
        block.ar_uuid.bytes,
        block.api,
        block.slot,
        block.subslot,
        block.index,
        block.length,
    )
    if block.type is BlockType.WRITE_RESPONSE:
        return common + _WRITE_RESPONSE_TAIL.pack(0, 0, block.status.value)
    return common + _TAIL.pack(block.target_ar_uuid.bytes)


def decode_block(data: bytes) -> tuple[RecordBlock, bytes]:
    """The header at the start of NDR arguments and the record data after it; ProfidriveError names the error.

    The answers to the writes of a RECORD_MULTIPLE follow its own answer (``split_answers``).
    """
    if len(data) < BLOCK_SIZE:
        raise ProfidriveError("record block", f"{len(data)} bytes", f"at least {BLOCK_SIZE}")
    kind, length, major, minor, sequence, ar_uuid, api, slot, subslot, index, record_length = _COMMON.unpack_from(data)
    if kind not in set(BlockType):
        raise ProfidriveError("BlockType", f"{kind:04X}h", "0008h, 0009h, 8008h or 8009h")
    if length != _BLOCK_LENGTH:
        raise ProfidriveError("BlockLength", length, f"{_BLOCK_LENGTH}")
    if (major, minor) != (1, 0):
        raise ProfidriveError("BlockVersion", f"{major}.{minor}", "1.0")
    block_type = BlockType(kind)
    target, status = NIL, PnioStatus()
    if block_type is BlockType.WRITE_RESPONSE:
        status = PnioStatus.of(_WRITE_RESPONSE_TAIL.unpack_from(data, _COMMON.size)[2])
    elif block_type is BlockType.READ_REQUEST:
        target = UUID(bytes=_TAIL.unpack_from(data, _COMMON.size)[0])
    block = RecordBlock(
        block_type, sequence, UUID(bytes=ar_uuid), api, slot, subslot, index, record_length, target, status
    )
    record = data[BLOCK_SIZE:]
    carries = block_type in {BlockType.WRITE_REQUEST, BlockType.READ_RESPONSE}
    if carries and record_length != len(record):
        raise ProfidriveError("RecordDataLength", record_length, f"the {len(record)} bytes after the block")
    answers_multiple = block_type is BlockType.WRITE_RESPONSE and index == RECORD_MULTIPLE
    if not carries and record and not answers_multiple:
        raise ProfidriveError("data after the block", f"{len(record)} bytes", "none")
    return block, record


def split_multiple(data: bytes) -> list[tuple[RecordBlock, bytes]]:
    """The writes inside a RECORD_MULTIPLE, each padded to a multiple of 4; ProfidriveError names what is wrong."""
    writes = []
    at = 0
    while at < len(data):
        if len(data) - at < BLOCK_SIZE:
            raise ProfidriveError("write inside E040h", f"{len(data) - at} bytes", f"at least {BLOCK_SIZE}")
        (length,) = _LENGTH.unpack_from(data, at + _COMMON.size - _LENGTH.size)
        end = at + BLOCK_SIZE + length
        block, record = decode_block(data[at:end])
        if block.type is not BlockType.WRITE_REQUEST:
            raise ProfidriveError("BlockType inside E040h", f"{block.type:04X}h", f"{BlockType.WRITE_REQUEST:04X}h")
        writes.append((block, record))
        at = end + -end % 4
    return writes


def split_answers(data: bytes) -> list[RecordBlock]:
    """What an answer to a RECORD_MULTIPLE carries: a header with its status for each write; ProfidriveError for a damaged one."""
    return [decode_block(data[at : at + BLOCK_SIZE])[0] for at in range(0, len(data), BLOCK_SIZE)]


# -- NDR --------------------------------------------------------------------------------------------------------------

_NDR = {True: struct.Struct("<5I"), False: struct.Struct(">5I")}
NDR_SIZE = 20


def encode_arguments(first: int, arguments: bytes, maximum: int, *, little: bool) -> bytes:
    """NDR of a request or response: ``first`` is ArgsMaximum of a request, the PNIO status of a response."""
    return _NDR[little].pack(first, len(arguments), maximum, 0, len(arguments)) + arguments


def decode_arguments(body: bytes, *, little: bool) -> tuple[int, bytes]:
    """ArgsMaximum or PNIO status, and the arguments; ProfidriveError when the counts do not agree."""
    if len(body) < NDR_SIZE:
        raise ProfidriveError("NDR header", f"{len(body)} bytes", f"at least {NDR_SIZE}")
    first, length, maximum, offset, actual = _NDR[little].unpack_from(body)
    arguments = body[NDR_SIZE:]
    if offset != 0 or length != actual or length > maximum:
        raise ProfidriveError(
            "NDR array", f"length {length}, maximum {maximum}, offset {offset}, count {actual}", "counts that agree"
        )
    if length > len(arguments):
        raise ProfidriveError("ArgsLength", length, f"at most the {len(arguments)} received bytes")
    return first, arguments[:length]
