"""Ethernet frames of PROFINET: header with or without a priority tag, padding.

Source: IEC 61158-6-10 (DLPDU), IEEE 802.1Q. Some systems strip the tag of a received frame and some do not: both are taken.
"""

from __future__ import annotations

import struct
from typing import Final

from pdgw.profidrive.frame import ETHERTYPE

ETHERTYPE_PROFINET: Final = ETHERTYPE
ETHERTYPE_LLDP: Final = 0x88CC
ETHERTYPE_TAG: Final = 0x8100
HEADER_SIZE: Final = 14
TAG_SIZE: Final = 4
MINIMUM: Final = 60
DCP_MULTICAST: Final = bytes.fromhex("010ecf000000")
"""Destination of Identify requests."""
LLDP_MULTICAST: Final = bytes.fromhex("0180c200000e")
_TYPE = struct.Struct(">H")
_TAG = struct.Struct(">HHH")


def header(destination: bytes, source: bytes, *, tag: int | None = None, ethertype: int = ETHERTYPE_PROFINET) -> bytes:
    """Header before the payload; ``tag`` is the tag control information (priority in bits 15 to 13)."""
    if tag is None:
        return destination + source + _TYPE.pack(ethertype)
    return destination + source + _TAG.pack(ETHERTYPE_TAG, tag, ethertype)


def frame(
    destination: bytes,
    source: bytes,
    payload: bytes,
    *,
    tag: int | None = None,
    ethertype: int = ETHERTYPE_PROFINET,
) -> bytes:
    """A whole frame, padded to the shortest one."""
    return (header(destination, source, tag=tag, ethertype=ethertype) + payload).ljust(MINIMUM, b"\0")


def payload_of(data: bytes) -> tuple[int, int]:
    """EtherType and start of the payload; (0, 0) for a short frame."""
    if len(data) < HEADER_SIZE:
        return 0, 0
    (ethertype,) = _TYPE.unpack_from(data, 12)
    if ethertype != ETHERTYPE_TAG:
        return ethertype, HEADER_SIZE
    if len(data) < HEADER_SIZE + TAG_SIZE:
        return 0, 0
    return _TYPE.unpack_from(data, 16)[0], HEADER_SIZE + TAG_SIZE
