"""SDO access to one node in a task of the loop, with canopen's client.

Source: CiA DS 301 V4.02 chapter 7.2.4. Nothing here waits but inside a task; an answer that does not end is an error.
"""

from __future__ import annotations

import logging
import queue
from collections import deque
from collections.abc import Callable
from typing import Final, TypeVar

import canopen
from canopen.sdo.constants import (
    EXPEDITED,
    REQUEST_DOWNLOAD,
    REQUEST_UPLOAD,
    RESPONSE_ABORTED,
    RESPONSE_DOWNLOAD,
    RESPONSE_UPLOAD,
    SDO_STRUCT,
    SIZE_SPECIFIED,
)

from pdgw.ds301.aborts import Abort, abort_text
from pdgw.ds301.bus.on_canopen import UNNAMED, SdoClient
from pdgw.ds301.errors import CanopenError
from pdgw.ds301.loop.loop import Loop
from pdgw.ds301.node.doubles import SecondAnswers
from pdgw.ds301.objects import CanType
from pdgw.ds301.sdo_transfer import SdoAbortedError, SdoCommunicationError
from pdgw.durations import SECOND

log = logging.getLogger("gateway")

T = TypeVar("T")

SEGMENT_SIZE: Final = 7
_EXPEDITED_SIZE = 4
_LONGEST_UPLOAD = 1 << 16
LONGEST_UPLOAD_NS: Final = 10 * SECOND
_FRAME = 8
_OF_THE_SIZE = SIZE_SPECIFIED | 3 << 2
_REPEATS = 2
"""A request without an answer is sent again so often."""
_REPEAT_AFTER = 10
"""An urgent request is repeated after this fraction of its timeout."""


def _download(index: int, subindex: int, data: bytes) -> bytes:
    """The request of an expedited download of 1 to 4 bytes."""
    command = REQUEST_DOWNLOAD | EXPEDITED | SIZE_SPECIFIED | (_EXPEDITED_SIZE - len(data)) << 2
    return bytes(SDO_STRUCT.pack(command, index, subindex)) + data.ljust(_EXPEDITED_SIZE, b"\0")


class SdoAccess:
    """Read and write the objects of a node; every method is for a task. ``error_type`` is the package's error for an abort,
    with the object's name."""

    def __init__(
        self,
        loop: Loop,
        node_id: int,
        dictionary: canopen.ObjectDictionary,
        error_type: type[CanopenError] = CanopenError,
    ) -> None:
        self.error_type = error_type
        self.loop = loop
        self.dictionary = dictionary
        self._node_id = node_id
        self.node = canopen.RemoteNode(node_id, dictionary)
        self._sdo = SdoClient(loop, node_id, dictionary)
        self.second_answers = SecondAnswers()
        self._sdo.on_request = self.second_answers.requested
        self._sdo.on_answer = self.second_answers.answered
        self.node.sdo_channels[:] = [self._sdo]
        self.node.sdo = self._sdo
        self._repeats = _REPEATS
        self.patient = False
        """Repeat accesses without an answer: nothing has to be monitored meanwhile."""
        self.accesses = 0
        """Number of reads and writes."""
        self.longest_upload_ns = LONGEST_UPLOAD_NS
        """An upload that takes longer is aborted."""
        self._open = 0
        """Urgent requests that were sent and not answered: their answers may still come."""
        self._open_until = 0
        self._kept: deque[bytes] = deque(maxlen=1)
        """The answer that came last before another access began: it may be that to ``ask``."""
        self._unconfirmed: dict[bytes, bytes] = {}
        """Data of writes that timed out, by their confirmation: it may still come."""

    def set_timeout(self, nanoseconds: int, *, slow: bool) -> None:
        """Set the timeout of each answer. ``slow``: the node needs it, so no request is repeated."""
        self._sdo.RESPONSE_TIMEOUT = nanoseconds / SECOND
        self._repeats = 0 if slow else _REPEATS

    @property
    def asked(self) -> int:
        """Index of the object of the access that was begun last."""
        return int.from_bytes(self._sdo.asked[:2], "little")

    @property
    def aborts(self) -> int:
        """Accesses the node refused."""
        return self._sdo.aborts

    @property
    def answers_late(self) -> bool:
        """The answer to the last request, which was aborted, has arrived. Those to another client do not count."""
        answers = self._sdo.responses
        while not answers.empty():
            if answers.get()[1:_EXPEDITED_SIZE] == self._sdo.asked:
                return True
        return False

    def read(self, index: int, subindex: int = 0) -> bytes:
        """SDO upload, in the node's task only; raises canopen's SdoAbortedError / SdoCommunicationError.

        An answer that does not end is one of the latter: the task has to watch the node.
        """
        return self._repeat(lambda: self._read(index, subindex))

    def write_repeatedly(self, index: int, subindex: int, data: bytes) -> None:
        """As ``write``, for a value that the node may take twice."""
        self._repeat(lambda: self.write(index, subindex, data))

    def _repeat(self, access: Callable[[], T]) -> T:
        """Carry out an access. While ``patient``, one without an answer is repeated after the time for a late one."""
        deadline = self.loop.now() + LONGEST_UPLOAD_NS
        for _ in range(_REPEATS if self.patient else 0):
            try:
                return access()
            except SdoCommunicationError as error:
                if self.loop.now() > deadline:
                    raise
                log.debug("node %d: %s: sent again", self._node_id, error)
                self._open += 1
                self._open_until = self.loop.now() + int(self._sdo.RESPONSE_TIMEOUT * SECOND)
        return access()

    def _read(self, index: int, subindex: int) -> bytes:
        self._settle()
        self.accesses += 1
        declared = self.dictionary.get_variable(index, subindex)
        if declared is not None and declared.data_type == CanType.DOMAIN.code:
            try:
                return self._upload(index, subindex, block=True)[0]
            except SdoCommunicationError as error:
                # A server may continue with a segmented transfer, which canopen's block transfer does not support.
                log.debug("node %d: no block transfer: %s", self._node_id, error)
            except SdoAbortedError as error:
                if error.code != Abort.INVALID_COMMAND:
                    raise
        data, size = self._upload(index, subindex, block=False)
        # Some devices send 32 bits for every number: use the type of the EDS.
        if declared is not None and declared.fixed_size and (size is None or len(declared) // 8 < size):
            data = data[: len(declared) // 8]
        return data

    def _upload(self, index: int, subindex: int, *, block: bool) -> tuple[bytes, int | None]:
        """The bytes of an upload and the size that the node announced."""
        sdo = self._sdo
        deadline = self.loop.now() + self.longest_upload_ns
        data = b""
        with sdo.open(index, subindex, "rb", buffering=0, block_transfer=block) as stream:
            while segment := stream.read(SEGMENT_SIZE):
                data += segment
                if len(data) > _LONGEST_UPLOAD or self.loop.now() > deadline:
                    sdo.abort()
                    raise SdoCommunicationError(f"{index:04X}h/{subindex} is too long to be read")
            return data, stream.size

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """SDO download, in the node's task only; raises canopen's SdoAbortedError / SdoCommunicationError.

        The late answer to an aborted write does not confirm this one (canopen would accept it). If both are for the same object,
        with other data, the object is read back.
        """
        self._settle()
        self.accesses += 1
        sdo = self._sdo
        if not 1 <= len(data) <= _EXPEDITED_SIZE:
            sdo.download(index, subindex, data)
            return
        address = SDO_STRUCT.pack(RESPONSE_DOWNLOAD, index, subindex)
        unconfirmed = self._unconfirmed.get(address)
        self._unconfirmed[address] = data
        deadline = self.loop.now() + int(sdo.RESPONSE_TIMEOUT * SECOND)
        try:
            answer = sdo.request_response(_download(index, subindex, data))
            while answer[: len(address)] != address:
                if self.loop.now() > deadline:
                    raise SdoCommunicationError(f"no answer to the write of {index:04X}h/{subindex}")
                answer = sdo.read_response()
        except SdoAbortedError:
            del self._unconfirmed[address]
            raise
        if unconfirmed == data:
            return  # this may be the late confirmation: the other one may still come
        del self._unconfirmed[address]
        if unconfirmed is not None and (found := self.read(index, subindex)[: len(data)]) != data:
            raise SdoCommunicationError(f"{index:04X}h/{subindex} is {found.hex()} after the write of {data.hex()}")

    def read_urgently(self, index: int, subindex: int = 0) -> int:
        """An unsigned integer of 32 bits at most, as ``read_number``; a lost frame costs a tenth of the time for answers."""
        try:
            request = SDO_STRUCT.pack(REQUEST_UPLOAD, index, subindex) + bytes(_EXPEDITED_SIZE)
            answer = self._urge(request, self._sdo.send_request)
        except SdoAbortedError as error:
            raise self._unreadable(index, subindex, error) from error
        if answer[0] & ~_OF_THE_SIZE != RESPONSE_UPLOAD | EXPEDITED:
            return self.require(index, subindex)
        unused = answer[0] >> 2 & 3 if answer[0] & SIZE_SPECIFIED else 0
        return int.from_bytes(answer[_EXPEDITED_SIZE : _FRAME - unused], "little")

    def write_urgently(self, index: int, subindex: int, data: bytes) -> None:
        """As ``write``, 1 to 4 bytes, before all that waits for the bus.

        A lost frame costs a tenth of the time for answers. The object takes the value twice then.
        """
        answer = self._urge(_download(index, subindex, data), self._sdo.send_first)
        if answer[0] != RESPONSE_DOWNLOAD:
            raise SdoCommunicationError(f"no confirmation of the write of {index:04X}h/{subindex}")

    def _urge(self, request: bytes, send: Callable[[bytes], object]) -> bytes:
        """The answer to an expedited request that is repeated while none arrives; an abort is raised as canopen does.
        ValueError if only frames other than SDO arrived."""
        sdo = self._sdo
        asked = request[1:_EXPEDITED_SIZE]
        timeout = int(sdo.RESPONSE_TIMEOUT * SECOND)
        begin = self.loop.now()
        while not sdo.responses.empty():
            self._next(begin)
        broken = ""
        for repeat in range(self._repeats, -1, -1):
            send(request)
            self._open += 1
            self._open_until = self.loop.now() + timeout
            deadline = self.loop.now() + timeout // _REPEAT_AFTER if repeat else begin + timeout
            while (answer := self._next(deadline)) is not None:
                if len(answer) != _FRAME:
                    broken = f"{len(answer)} bytes, {_FRAME} expected"
                    continue
                told = answer[1:_EXPEDITED_SIZE]
                if answer[0] == RESPONSE_ABORTED and told in (asked, UNNAMED):
                    raise self._sdo.aborted(int.from_bytes(answer[_EXPEDITED_SIZE:], "little"))
                if told == asked:
                    return answer
        self._open = 0
        sdo.abort(Abort.TIMEOUT)
        if broken:
            raise ValueError(broken)
        raise SdoCommunicationError(f"{self._sdo.where}: No SDO response received")

    def _next(self, deadline: int) -> bytes | None:
        """The next answer of the node until the deadline."""
        try:
            answer: bytes = self._sdo.responses.get(timeout=max(0, deadline - self.loop.now()) / SECOND)
        except queue.Empty:
            return None
        self._open = max(0, self._open - 1)
        return answer

    def _settle(self) -> None:
        """A second answer to a repeated request must not count as the answer to the next one; that to ``ask`` is kept.

        No access continues if two devices answer: their answers would be mixed.
        """
        if self.second_answers.found:
            raise self.two_devices("SDO requests are answered twice")
        while self._open and (answer := self._next(self._open_until)) is not None:
            self._kept.append(answer)
        self._open = 0

    def ask(self, index: int, subindex: int = 0) -> None:
        """Send the request to read an object without waiting; ``answered`` has the answer later."""
        now = self.loop.now()
        self._kept.clear()
        while not self._sdo.responses.empty():
            self._next(now)
        self._sdo.send_request(SDO_STRUCT.pack(REQUEST_UPLOAD, index, subindex) + bytes(_EXPEDITED_SIZE))
        self._open += 1
        self._open_until = now + int(self._sdo.RESPONSE_TIMEOUT * SECOND)

    def answered(self, index: int, subindex: int = 0, *, signed: bool = False) -> int | None:
        """The integer requested by ``ask``; None while no answer has arrived. An abort is raised as canopen does."""
        asked = SDO_STRUCT.pack(0, index, subindex)[1:]
        while self._kept or not self._sdo.responses.empty():
            answer = self._kept.pop() if self._kept else self._next(self.loop.now())
            if answer is None or len(answer) != _FRAME or answer[1:_EXPEDITED_SIZE] not in (asked, UNNAMED):
                continue
            if answer[0] == RESPONSE_ABORTED:
                raise self._sdo.aborted(int.from_bytes(answer[_EXPEDITED_SIZE:], "little"))
            if answer[0] & ~_OF_THE_SIZE == RESPONSE_UPLOAD | EXPEDITED:
                unused = answer[0] >> 2 & 3 if answer[0] & SIZE_SPECIFIED else 0
                data = answer[_EXPEDITED_SIZE : _FRAME - unused]
                declared = self.dictionary.get_variable(index, subindex)
                if declared is not None and declared.fixed_size:
                    data = data[: max(1, len(declared) // 8)]
                return int.from_bytes(data, "little", signed=signed)
        return None

    def read_number(self, index: int, subindex: int = 0, *, signed: bool = False) -> int:
        """An integer object, in the node's task only."""
        return int.from_bytes(self.read(index, subindex), "little", signed=signed)

    def require(self, index: int, subindex: int = 0, *, signed: bool = False) -> int:
        """As ``read_number``, with an abort that names the object."""
        try:
            return self.read_number(index, subindex, signed=signed)
        except SdoAbortedError as error:
            raise self._unreadable(index, subindex, error) from error

    def two_devices(self, sign: str) -> CanopenError:
        """The package's error for a node-ID that two devices have; ``sign``: what shows it."""
        return self.error_type(
            f"node-ID {self._node_id}",
            f"two devices? {sign}",
            f"one device with node-ID {self._node_id} on the bus: disconnect the other one, or set another node-ID there",
        )

    def _unreadable(self, index: int, subindex: int, error: SdoAbortedError) -> CanopenError:
        return self.error_type(
            f"node {self._node_id} object {index:04X}h/{subindex}",
            abort_text(error.code),
            "an object that can be read",
        )
