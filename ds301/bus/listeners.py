"""Who takes a copy of every frame of a bus: listeners for people and tools, and a tap for recordings."""

from __future__ import annotations

from collections.abc import Callable

import can

from pdgw.ds301.bus.can_frame import REMOTE

FrameListener = Callable[[can.Message], None]
"""Called with every frame sent and received (``is_rx``). It must only queue."""


class FrameTap:
    """Takes every frame; a class as ``PdoReceiver``."""

    def frame(self, can_id: int, data: bytes, time_ns: int) -> None:
        """A frame that was sent or received; ``can_id`` with the flags of SocketCAN."""
        raise NotImplementedError


def message_of(
    can_id: int, data: bytes, wall_s: float, *, is_rx: bool, extended: bool = False, remote: bool = False
) -> can.Message:
    """The message for listeners. ``can_id`` may have the flag of a remote request."""
    requests = remote or bool(can_id & REMOTE)
    return can.Message(
        timestamp=wall_s,
        arbitration_id=can_id & ~REMOTE,
        data=None if requests else data,
        dlc=len(data),
        is_extended_id=extended,
        is_remote_frame=requests,
        is_rx=is_rx,
    )
