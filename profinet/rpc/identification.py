"""Identification and maintenance records I&M0 to I&M4 (AFF0h to AFF4h).

Source: PROFIBUS/PROFINET identification and maintenance functions V1.2, as scapy's IMxBlock and tshark read them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.wire import HEADER, VERSION_SIZE

INDEX = 0xAFF0
"""Record index of I&M0; I&Mn follows at INDEX + n."""
INDEXES = range(INDEX, INDEX + 5)
"""I&M0 to I&M4."""
PROFILE_ID = 0x3A00
"""PROFIdrive."""
_BLOCK_TYPE = 0x0020
_IM0 = struct.Struct(">H20s16sHc3BHHHBBH")
SUPPORTED = 0b11110
"""Bit n of IM_Supported is I&Mn: 1 to 4."""

TEXT_FIELDS: dict[int, tuple[tuple[str, int], ...]] = {
    1: (("IM_Tag_Function", 32), ("IM_Tag_Location", 22)),
    2: (("IM_Date", 16),),
    3: (("IM_Descriptor", 54),),
    4: (("IM_Signature", 54),),
}
"""Fields of the writable records with their sizes; the signature is octets, the others visible characters."""
SIGNATURE = 4


@dataclass(frozen=True, slots=True)
class Im0:
    """Identification of the device. ``software``: prefix letter and three numbers 0..255."""

    vendor_id: int
    order_id: str
    serial_number: str
    hardware_revision: int
    software: tuple[str, int, int, int]
    revision_counter: int = 0
    profile_id: int = PROFILE_ID
    profile_type: int = 0
    supported: int = SUPPORTED


def size_of(number: int) -> int:
    """Bytes of the record I&M1 to I&M4 with its block header."""
    return HEADER.size + sum(length for _, length in TEXT_FIELDS[number])


def _text(value: str, size: int, field: str) -> bytes:
    try:
        data = value.encode("ascii")
    except UnicodeEncodeError as error:
        raise ProfidriveError(field, value, "visible ASCII characters") from error
    if len(data) > size:
        raise ProfidriveError(field, value, f"at most {size} characters")
    return data.ljust(size)


def _block(number: int, content: bytes) -> bytes:
    return HEADER.pack(_BLOCK_TYPE + number, len(content) + VERSION_SIZE, 1, 0) + content


def encode_im0(item: Im0) -> bytes:
    """The record AFF0h."""
    prefix, *version = item.software
    return _block(
        0,
        _IM0.pack(
            item.vendor_id,
            _text(item.order_id, 20, "OrderID"),
            _text(item.serial_number, 16, "IM_Serial_Number"),
            item.hardware_revision,
            _text(prefix, 1, "IM_SWRevision_Functional_Prefix"),
            *version,
            item.revision_counter,
            item.profile_id,
            item.profile_type,
            1,
            1,
            item.supported,
        ),
    )


def decode_im0(record: bytes) -> Im0:
    """What a device says it is in its record AFF0h; ProfidriveError names what is wrong."""
    _check_block(0, record, _IM0.size)
    vendor, order, serial, hardware, prefix, *numbers = _IM0.unpack_from(record, HEADER.size)
    first, second, third, counter, profile, specific, _, _, supported = numbers
    return Im0(
        vendor,
        _shown(order),
        _shown(serial),
        hardware,
        (_shown(prefix), first, second, third),
        counter,
        profile,
        specific,
        supported,
    )


def _shown(text: bytes) -> str:
    return text.rstrip(b" \0").decode("ascii", "backslashreplace")


def encode_im(number: int, values: tuple[bytes, ...]) -> bytes:
    """The record I&M1 to I&M4; texts are padded with spaces, the signature with zeros."""
    pad = b"\0" if number == SIGNATURE else b" "
    parts = [value.ljust(size, pad) for value, (_, size) in zip(values, TEXT_FIELDS[number], strict=True)]
    return _block(number, b"".join(parts))


def _check_block(number: int, record: bytes, size: int) -> None:
    if len(record) != HEADER.size + size:
        raise ProfidriveError(f"I&M{number}", f"{len(record)} bytes", f"{HEADER.size + size} bytes")
    kind, length, major, minor = HEADER.unpack_from(record)
    if (kind, length, major, minor) != (_BLOCK_TYPE + number, size + VERSION_SIZE, 1, 0):
        raise ProfidriveError(
            f"block header of I&M{number}",
            record[: HEADER.size].hex(" "),
            HEADER.pack(_BLOCK_TYPE + number, size + VERSION_SIZE, 1, 0).hex(" "),
        )


def decode_im(number: int, record: bytes) -> tuple[bytes, ...]:
    """The fields of a written I&M1 to I&M4; ProfidriveError names what is wrong."""
    fields = TEXT_FIELDS[number]
    _check_block(number, record, sum(length for _, length in fields))
    values = []
    offset = HEADER.size
    for name, length in fields:
        value = record[offset : offset + length]
        offset += length
        if number != SIGNATURE and any(not 0x20 <= byte < 0x7F for byte in value):
            raise ProfidriveError(name, value, "visible ASCII characters")
        values.append(value)
    return tuple(values)
