"""canopen's network and SDO client on the loop: the classes that derive from the library's, which no compiler takes."""

from __future__ import annotations

from collections.abc import Callable

import canopen
from canopen.sdo import SdoAbortedError, SdoCommunicationError
from canopen.sdo.constants import (
    REQUEST_ABORTED,
    REQUEST_DOWNLOAD,
    REQUEST_UPLOAD,
)

from pdgw.ds301.aborts import abort_text
from pdgw.ds301.connection_set import SDO_REQUEST, SDO_RESPONSE
from pdgw.ds301.loop.loop import Loop, Mailbox

_COMMAND = 0xE0
_BEGINS = (REQUEST_DOWNLOAD, REQUEST_UPLOAD)
"""Requests that name their object."""


class AcyclicNetwork(canopen.Network):  # type: ignore[misc]
    """canopen's network, sending through ours and fed by ours."""

    def __init__(self, send: Callable[[int, bytes], object], send_first: Callable[[int, bytes], object]) -> None:
        super().__init__()
        # No LSS master reads the answers to LSS, so they would stay in canopen's queue permanently.
        self.unsubscribe(self.lss.LSS_RX_COBID)
        self._send = send
        self.send_first = send_first
        """Send before what waits: for a stop by SDO."""

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._send(can_id, bytes(data))


class ObjectAbortedError(SdoAbortedError):  # type: ignore[misc]
    """A node has aborted the access to one of its objects: with node, object and the text of the code."""

    def __init__(self, where: str, code: int) -> None:
        super().__init__(code)
        self.where = where

    def __str__(self) -> str:
        return f"{self.where}: {abort_text(self.code)}"


class SdoClient(canopen.sdo.SdoClient):  # type: ignore[misc]
    """canopen's SDO client, waiting on the loop instead of a thread's queue."""

    def __init__(self, loop: Loop, node_id: int, dictionary: canopen.ObjectDictionary) -> None:
        self._box: Mailbox[bytes] = Mailbox(loop)
        self.aborts = 0
        self._node_id = node_id
        self._asked = b""
        """Index and sub-index of the access that was begun last."""
        super().__init__(SDO_REQUEST + node_id, SDO_RESPONSE + node_id, dictionary)

    def on_response(self, can_id: int, data: bytes, timestamp: float) -> None:
        """A frame of the node."""
        if data and data[0] == REQUEST_ABORTED:
            self.aborts += 1
        super().on_response(can_id, data, timestamp)

    def send_request(self, request: bytes) -> None:
        if request[0] & _COMMAND in _BEGINS:
            self._asked = bytes(request[1:4])
        super().send_request(request)

    def read_response(self) -> bytes:
        try:
            answer: bytes = super().read_response()
        except SdoAbortedError as error:
            raise self.aborted(error.code) from error
        except SdoCommunicationError as error:
            raise SdoCommunicationError(f"{self.where}: {error}") from error
        return answer

    def aborted(self, code: int) -> ObjectAbortedError:
        """The error of an abort by the node."""
        return ObjectAbortedError(self.where, code)

    @property
    def where(self) -> str:
        """Node and object of the access that was begun last."""
        index, subindex = int.from_bytes(self._asked[:2], "little"), self._asked[2:]
        return f"node {self._node_id} object {index:04X}h/{subindex[0] if subindex else 0}"

    @property
    def responses(self) -> Mailbox[bytes]:
        """The answers of the node."""
        return self._box

    @responses.setter
    def responses(self, _: object) -> None:
        # canopen replaces the queue to clear it.
        self._box.clear()
