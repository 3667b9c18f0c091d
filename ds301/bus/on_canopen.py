"""canopen's network on the loop: a class that derives from the library's, which no compiler takes."""

from __future__ import annotations

from collections.abc import Callable

import canopen

from pdgw.ds301.connection_set import ERROR_CONTROL


class AcyclicNetwork(canopen.Network):  # type: ignore[misc]
    """canopen's network, sending through ours and fed by ours."""

    def __init__(self, send: Callable[[int, bytes], object]) -> None:
        super().__init__()
        # No LSS master reads the answers to LSS, so they would stay in canopen's queue permanently.
        self.unsubscribe(self.lss.LSS_RX_COBID)
        # A PDO can have any COB-ID: only heartbeat and boot-up name their node.
        self.scanner.SERVICES = (ERROR_CONTROL,)
        self._send = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._send(can_id, bytes(data))
