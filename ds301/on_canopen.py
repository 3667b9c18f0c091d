"""canopen's network and SDO client on the loop: the classes that derive from the library's, which no compiler takes."""

from __future__ import annotations

from collections.abc import Callable

import canopen
from canopen.sdo.constants import REQUEST_ABORTED

from pdgw.ds301.connection_set import SDO_REQUEST, SDO_RESPONSE
from pdgw.ds301.loop import Loop, Mailbox


class AcyclicNetwork(canopen.Network):  # type: ignore[misc]
    """canopen's network, sending through ours and fed by ours."""

    def __init__(self, send: Callable[[int, bytes], object], send_first: Callable[[int, bytes], object]) -> None:
        super().__init__()
        # Answers to LSS, which nobody asks here, would wait in canopen for ever.
        self.unsubscribe(self.lss.LSS_RX_COBID)
        self._send = send
        self.send_first = send_first
        """Send before what waits: for a stop by SDO."""

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._send(can_id, bytes(data))


class SdoClient(canopen.sdo.SdoClient):  # type: ignore[misc]
    """canopen's SDO client, waiting on the loop instead of a thread's queue."""

    def __init__(self, loop: Loop, node_id: int, dictionary: canopen.ObjectDictionary) -> None:
        self._box: Mailbox[bytes] = Mailbox(loop)
        self.aborts = 0
        super().__init__(SDO_REQUEST + node_id, SDO_RESPONSE + node_id, dictionary)

    def on_response(self, can_id: int, data: bytes, timestamp: float) -> None:
        """A frame of the node."""
        if data and data[0] == REQUEST_ABORTED:
            self.aborts += 1
        super().on_response(can_id, data, timestamp)

    @property
    def responses(self) -> Mailbox[bytes]:
        """What the node answered."""
        return self._box

    @responses.setter
    def responses(self, _: object) -> None:
        # canopen makes a new queue where it wants an empty one.
        self._box.clear()
