"""Linux's ``struct can_frame``: a classic CAN frame as the 16 bytes that go over a SocketCAN socket.

Source: linux/can.h. The identifier has the flags in its upper bits; the data is padded to 8 bytes.
"""

from __future__ import annotations

import struct
from typing import Final

CAN_FRAME: Final = struct.Struct("=IB3x8s")
"""Identifier with flags, length 0..8, data."""
FD_FRAME_SIZE: Final = 72
"""``struct canfd_frame``: the read buffer has its length, so that a CAN FD frame does not look like a classic one."""
STANDARD_ID: Final = 0x7FF
EXTENDED_ID: Final = 0x1FFF_FFFF
"""Identifiers of 11 and of 29 bits, without flags."""
EXTENDED: Final = 0x8000_0000
REMOTE: Final = 0x4000_0000
ERROR: Final = 0x2000_0000
"""Flags of the identifier: 29 bit, remote request, message of the driver about an error."""
ERROR_CONTROLLER: Final = 0x04
ERROR_BUS_OFF: Final = 0x40
"""Classes of such a message, in its identifier (linux/can/error.h): controller problem, bus-off."""


def pack_frame(can_id: int, data: bytes) -> bytes:
    """A frame of at most 8 bytes; flags are part of ``can_id``."""
    return CAN_FRAME.pack(can_id, len(data), data)


def unpack_frame(frame: bytes) -> tuple[int, bytes]:
    """Identifier with flags, and the data; struct.error when ``frame`` has not its 16 bytes."""
    can_id, length, data = CAN_FRAME.unpack(frame)
    return can_id, data[: min(length, 8)]
