"""canopen's network and SDO client on the loop: the classes that derive from the library's, which no compiler takes."""

from __future__ import annotations

import queue
import struct
from collections.abc import Callable
from typing import Final

import canopen
from canopen.sdo.constants import (
    INITIATE_BLOCK_TRANSFER,
    REQUEST_ABORTED,
    REQUEST_BLOCK_UPLOAD,
    REQUEST_DOWNLOAD,
    REQUEST_UPLOAD,
    RESPONSE_ABORTED,
    RESPONSE_DOWNLOAD,
    RESPONSE_UPLOAD,
)

from pdgw.ds301.connection_set import ERROR_CONTROL, SDO_REQUEST, SDO_RESPONSE
from pdgw.ds301.loop.loop import Loop, Mailbox
from pdgw.ds301.sdo_transfer import SdoAbortedError, SdoCommunicationError
from pdgw.durations import SECOND

UNNAMED: Final = b"\0\0\0"
"""Index and sub-index in the aborts of devices that do not say which access it is."""
_ABORT: Final = bytes((RESPONSE_ABORTED,))
_COMMAND = 0xE0
_BLOCK_COMMAND = 0xE3
_ANSWERS: Final = {REQUEST_DOWNLOAD: RESPONSE_DOWNLOAD, REQUEST_UPLOAD: RESPONSE_UPLOAD}
"""Requests that name their object, with the answers, which name it unless it is transferred in blocks,"""
_BEGINS_BLOCK = REQUEST_BLOCK_UPLOAD | INITIATE_BLOCK_TRANSFER
"""and the one of a block transfer."""
_NAMING: Final = tuple(_ANSWERS.values())


class AcyclicNetwork(canopen.Network):  # type: ignore[misc]
    """canopen's network, sending through ours and fed by ours."""

    def __init__(self, send: Callable[[int, bytes], object], send_first: Callable[[int, bytes], object]) -> None:
        super().__init__()
        # No LSS master reads the answers to LSS, so they would stay in canopen's queue permanently.
        self.unsubscribe(self.lss.LSS_RX_COBID)
        # A PDO can have any COB-ID: only heartbeat and boot-up name their node.
        self.scanner.SERVICES = (ERROR_CONTROL,)
        self._send = send
        self.send_first = send_first
        """Send before what waits: for a stop by SDO."""

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._send(can_id, bytes(data))


class SdoClient(canopen.sdo.SdoClient):  # type: ignore[misc]
    """canopen's SDO client, waiting on the loop instead of a thread's queue."""

    def __init__(self, loop: Loop, node_id: int, dictionary: canopen.ObjectDictionary) -> None:
        self._loop = loop
        self._box: Mailbox[bytes] = Mailbox(loop)
        self.aborts = 0
        self._node_id = node_id
        self.asked = b""
        """Index and sub-index of the access that was begun last."""
        self._answer = 0
        """Command of its first answer; 0: it is a block transfer."""
        self.on_request: Callable[[bytes], object] = bytes
        """Called with each request of this client,"""
        self.on_answer: Callable[[bytes], object] = bytes
        """and with each answer of the node."""
        super().__init__(SDO_REQUEST + node_id, SDO_RESPONSE + node_id, dictionary)

    def on_response(self, can_id: int, data: bytes, timestamp: float) -> None:
        """A frame of the node."""
        if data and data[0] == REQUEST_ABORTED:
            self.aborts += 1
        self.on_answer(bytes(data))
        super().on_response(can_id, data, timestamp)

    def send_request(self, request: bytes) -> None:
        self._begin(request)
        super().send_request(request)

    def send_first(self, request: bytes) -> None:
        """As ``send_request``, before all that waits for the bus."""
        self._begin(request)
        self.network.send_first(self.rx_cobid, request)

    def _begin(self, request: bytes) -> None:
        self.on_request(bytes(request))
        by_blocks = request[0] & _BLOCK_COMMAND == _BEGINS_BLOCK
        if by_blocks or request[0] & _COMMAND in _ANSWERS:
            self.asked = bytes(request[1:4])
            self._answer = 0 if by_blocks else _ANSWERS[request[0] & _COMMAND]

    def read_response(self) -> bytes:
        """The next answer to the access that was begun last. Others are ignored."""
        deadline = self._loop.now() + int(self.RESPONSE_TIMEOUT * SECOND)
        while True:
            try:
                answer = self.responses.get(timeout=max(0, deadline - self._loop.now()) / SECOND)
            except queue.Empty as error:
                raise SdoCommunicationError(f"{self.where}: No SDO response received") from error
            if not self._belongs(answer):
                continue
            if answer[:1] == _ABORT:
                raise self.aborted(*struct.unpack_from("<L", answer, 4))
            return answer

    def _belongs(self, answer: bytes) -> bool:
        """False for the answer to another client or to an earlier request: to another object, or to the other kind of access.

        Segments and blocks name no object, so all of them belong to the access.
        """
        if answer[:1] == _ABORT:
            return answer[1:4] in (self.asked, UNNAMED)
        command = answer[0] & _COMMAND if answer else 0
        if not self._answer or command not in _NAMING:
            return True
        return command == self._answer and answer[1:4] == self.asked

    def aborted(self, code: int) -> SdoAbortedError:
        """The error of an abort by the node."""
        return SdoAbortedError(code, self.where)

    @property
    def where(self) -> str:
        """Node and object of the access that was begun last."""
        index, subindex = int.from_bytes(self.asked[:2], "little"), self.asked[2:]
        return f"node {self._node_id} object {index:04X}h/{subindex[0] if subindex else 0}"

    @property
    def responses(self) -> Mailbox[bytes]:
        """The answers of the node."""
        return self._box

    @responses.setter
    def responses(self, _: object) -> None:
        # canopen replaces the queue to clear it.
        self._box.clear()
