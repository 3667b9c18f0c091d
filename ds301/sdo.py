"""SDO access to one node in a task of the loop, with canopen's client.

Source: CiA DS 301 V4.02 chapter 7.2.4. Nothing here waits but inside a task; an answer that does not end is an error.
"""

from __future__ import annotations

import logging
from typing import ClassVar

import canopen
from canopen.sdo import SdoAbortedError, SdoCommunicationError
from canopen.sdo.constants import (
    EXPEDITED,
    REQUEST_DOWNLOAD,
    RESPONSE_DOWNLOAD,
    SDO_STRUCT,
    SIZE_SPECIFIED,
)

from pdgw.ds301.aborts import Abort, abort_text
from pdgw.ds301.errors import CanopenError
from pdgw.ds301.loop import SECOND, Loop
from pdgw.ds301.objects import CanType
from pdgw.ds301.on_canopen import SdoClient

log = logging.getLogger("gateway")

_SEGMENT = 7
_EXPEDITED_SIZE = 4
_LONGEST_UPLOAD = 1 << 16
_LONGEST_UPLOAD_NS = 10 * SECOND


class SdoAccess:
    """Reads and writes the objects of a node; every method is for a task.

    ``error_type`` is the package's error for an abort that is told with the object's name.
    """

    error_type: ClassVar[type[CanopenError]] = CanopenError

    def __init__(self, loop: Loop, node_id: int, dictionary: canopen.ObjectDictionary) -> None:
        self.loop = loop
        self.dictionary = dictionary
        self._node_id = node_id
        self._node = canopen.RemoteNode(node_id, dictionary)
        self._sdo = SdoClient(loop, node_id, dictionary)
        self._node.sdo_channels[:] = [self._sdo]
        self._node.sdo = self._sdo

    @property
    def sdo_aborts(self) -> int:
        """Accesses the node refused."""
        return self._sdo.aborts

    @property
    def _answers_late(self) -> bool:
        """An answer has come that was given up."""
        return not self._sdo.responses.empty()

    def read(self, index: int, subindex: int = 0) -> bytes:
        """SDO upload, in the node's task only; raises canopen's SdoAbortedError / SdoCommunicationError.

        An answer that does not end is one of the latter: the task has to watch the node.
        """
        declared = self.dictionary.get_variable(index, subindex)
        if declared is not None and declared.data_type == CanType.DOMAIN.code:
            try:
                return self._upload(index, subindex, block=True)[0]
            except SdoCommunicationError as error:
                # A server may go on with a segmented transfer, which canopen's block transfer does not take.
                log.debug("node %d: no block transfer: %s", self._node_id, error)
            except SdoAbortedError as error:
                if error.code != Abort.INVALID_COMMAND:
                    raise
        data, size = self._upload(index, subindex, block=False)
        # Some devices send 32 bits for every number: the EDS knows better.
        if declared is not None and declared.fixed_size and (size is None or len(declared) // 8 < size):
            data = data[: len(declared) // 8]
        return data

    def _upload(self, index: int, subindex: int, *, block: bool) -> tuple[bytes, int | None]:
        """The bytes of an upload and the size the node told before."""
        sdo = self._sdo
        deadline = self.loop.now() + _LONGEST_UPLOAD_NS
        data = b""
        with sdo.open(index, subindex, "rb", buffering=0, block_transfer=block) as stream:
            while segment := stream.read(_SEGMENT):
                data += segment
                if len(data) > _LONGEST_UPLOAD or self.loop.now() > deadline:
                    sdo.abort()
                    raise SdoCommunicationError(f"{index:04X}h/{subindex} does not end")
            return data, stream.size

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """SDO download, in the node's task only; raises canopen's SdoAbortedError / SdoCommunicationError.

        The late answer to another write, which was given up, does not confirm this one (canopen would take it).
        """
        sdo = self._sdo
        if not 1 <= len(data) <= _EXPEDITED_SIZE:
            sdo.download(index, subindex, data)
            return
        command = REQUEST_DOWNLOAD | EXPEDITED | SIZE_SPECIFIED | (_EXPEDITED_SIZE - len(data)) << 2
        address = SDO_STRUCT.pack(RESPONSE_DOWNLOAD, index, subindex)
        deadline = self.loop.now() + int(sdo.RESPONSE_TIMEOUT * SECOND)
        answer = sdo.request_response(SDO_STRUCT.pack(command, index, subindex) + data.ljust(_EXPEDITED_SIZE, b"\0"))
        while answer[: len(address)] != address:
            if self.loop.now() > deadline:
                raise SdoCommunicationError(f"no answer to the write of {index:04X}h/{subindex}")
            answer = sdo.read_response()

    def read_number(self, index: int, subindex: int = 0, *, signed: bool = False) -> int:
        """An integer object, in the node's task only."""
        return int.from_bytes(self.read(index, subindex), "little", signed=signed)

    def _fetch(self, index: int, subindex: int = 0, *, signed: bool = False) -> int:
        """As ``read_number``, with an abort that names the object."""
        try:
            return self.read_number(index, subindex, signed=signed)
        except SdoAbortedError as error:
            raise self.error_type(
                f"node {self._node_id} object {index:04X}h/{subindex}",
                abort_text(error.code),
                "an object that can be read, as the EDS says",
            ) from error
