"""SDO access to one node: reads and writes in a task of the loop, and questions that need no task.

Source: CiA DS 301 V4.02 chapter 7.2.4. Nothing here waits but inside a task; an answer that does not end is an error. A node
is also identified here by SDO uploads alone, without NMT commands and PDOs, while no gateway runs on its bus (commissioning).
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Final, Self, TypeVar

import canopen

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import NOT_THERE, Abort, CanopenError, SdoAbortedError, SdoCommunicationError, abort_text
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import SDO_RESPONSE
from pdgw.ds301.loop.loop import Event
from pdgw.ds301.node.doubles import Doubles
from pdgw.ds301.objects import CanType
from pdgw.ds301.sdo_frames import ABORT, EXPEDITED_SIZE, address_in
from pdgw.ds301.sdo_transfer import Download, Transfer, Upload

log = logging.getLogger("gateway")

T = TypeVar("T")

_LONGEST_UPLOAD: Final = 1 << 16
LONGEST_UPLOAD_NS: Final = 10 * SECOND
_TIMEOUT_NS: Final = 300 * MS
_LONGEST_TIMEOUT_NS: Final = 4 * SECOND
"""A node that answers late gets no more time than twice this."""
_REPEATS: Final = 2
"""A request without an answer is sent again so often."""
_REPEAT_AFTER: Final = 10
"""An urgent request is repeated after this fraction of its timeout."""

DISCONNECT: Final = "disconnect the other one, or set another node-ID there"
"""What to do with two devices that have one node-ID."""


class _Request:
    """A transfer from its begin to that of the next one: of an access, or of a question."""

    def __init__(self, transfer: Transfer, begun_ns: int, then: Callable[[], None] | None) -> None:
        self.transfer = transfer
        self.begun_ns = begun_ns
        self.then = then
        """Called at its end, if it is a question."""
        self.answers_late = False
        """It was aborted, and its answer has arrived. Those to another client do not count."""


class SdoAccess:
    """Read and write the objects of a node, between ``open`` and ``close``. ``error_type`` is the package's error for an abort,
    with the object's name."""

    def __init__(
        self,
        network: CanNetwork,
        node_id: int,
        dictionary: canopen.ObjectDictionary,
        error_type: type[CanopenError] = CanopenError,
    ) -> None:
        self.error_type = error_type
        self.loop = network.loop
        self.dictionary = dictionary
        self._network = network
        self._node_id = node_id
        self.doubles = Doubles()
        """Whether two devices have its node-ID."""
        self.timeout_ns = _TIMEOUT_NS
        """For each answer."""
        self.slow_ns = 0
        """The timeout of a node that was found to need more than it is given; 0: it does not."""
        self._repeats = _REPEATS
        self.patient = False
        """Repeat accesses without an answer: nothing has to be monitored meanwhile."""
        self.accesses = 0
        """Number of reads and writes."""
        self.aborts = 0
        """Aborts that the node has sent."""
        self.longest_upload_ns = LONGEST_UPLOAD_NS
        """An upload that takes longer is aborted."""
        self._request: _Request | None = None
        """The last one."""
        self._ended = Event(self.loop)
        """It has ended, or the last late answer has arrived."""
        self._open = 0
        """Requests that were sent again and not answered: their answers may still arrive,"""
        self._open_until = 0
        """until this time. The next access waits for them, or for the answer to a question."""
        self._interrupted = False
        """The node is lost: what it answers does not count."""
        self._is_short = False
        """The log has a line on its short confirmations."""
        self._unconfirmed: dict[tuple[int, int], bytes] = {}
        """Data of writes that timed out, by their object: the confirmation may still arrive."""

    def open(self) -> None:
        """Receive the answers of the node."""
        self._network.subscribe(SDO_RESPONSE + self._node_id, self._receive)

    def close(self) -> None:
        """The end of ``open``."""
        self._network.unsubscribe(SDO_RESPONSE + self._node_id, self._receive)

    def interrupt(self) -> None:
        """The node is lost: its task does not wait for an answer any more. Accesses fail until ``resume``."""
        self._interrupted = True
        if self._request is not None:
            self._request.transfer.expire()
        self._ended.set()

    def resume(self) -> None:
        """Forget everything: another device may be connected."""
        self._interrupted = False
        self._open = self._open_until = 0
        self.doubles.begin()

    def set_timeout(self, nanoseconds: int, *, slow: bool) -> None:
        """Set the timeout of each answer, at least ``slow_ns``. ``slow``: the node needs it, so no request is repeated."""
        self.timeout_ns = max(nanoseconds, self.slow_ns)
        self._repeats = 0 if slow or self.slow_ns else _REPEATS

    def double_timeout(self) -> bool:
        """Double the timeout if the answer to the last request came late; False if it did not, or the timeout is long enough."""
        if not self.answers_late or self.timeout_ns >= _LONGEST_TIMEOUT_NS:
            return False
        self.slow_ns = 2 * self.timeout_ns
        self.set_timeout(self.slow_ns, slow=True)
        return True

    # -- accesses of a task -----------------------------------------------------------------------------------------

    def read(self, index: int, subindex: int = 0) -> bytes:
        """SDO upload, in the node's task only; raises SdoAbortedError or SdoCommunicationError."""
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
                self._expect_answer()
        return access()

    def _expect_answer(self) -> None:
        """A request was sent that may be answered when another one is sent."""
        now = self.loop.now()
        self._open = self._open + 1 if now < self._open_until else 1
        self._open_until = now + self.timeout_ns

    def _read(self, index: int, subindex: int) -> bytes:
        self._begin_access()
        declared = self.dictionary.get_variable(index, subindex)
        if declared is not None and declared.data_type == CanType.DOMAIN.code:
            try:
                return self._upload(index, subindex, by_blocks=True)
            except SdoCommunicationError as error:
                log.debug("node %d: no block transfer: %s", self._node_id, error)
            except SdoAbortedError as error:
                if error.code != Abort.INVALID_COMMAND:
                    raise
        return self._upload(index, subindex)

    def _upload(self, index: int, subindex: int, *, by_blocks: bool = False) -> bytes:
        timeout, limit = self.timeout_ns, self.longest_upload_ns
        upload = Upload(index, subindex, timeout, by_blocks=by_blocks, limit=_LONGEST_UPLOAD, limit_ns=limit)
        self._run(upload)
        return self._value(upload)

    def _value(self, upload: Upload) -> bytes:
        """The data of an upload. Some devices send 32 bits for every number: in the length of the EDS."""
        declared = self.dictionary.get_variable(upload.index, upload.subindex)
        data = bytes(upload.sink.data)
        return data if declared is None or not declared.fixed_size else data[: max(1, len(declared) // 8)]

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """SDO download, in the node's task only; raises SdoAbortedError or SdoCommunicationError.

        The late answer to an aborted write of another object does not confirm this one. If both are for the same object, with
        other data, the object is read back.
        """
        self._begin_access()
        download = Download(index, subindex, data, self.timeout_ns)
        if not 1 <= len(data) <= EXPEDITED_SIZE:
            self._run(download)
            return
        address = index, subindex
        unconfirmed = self._unconfirmed.get(address)
        self._unconfirmed[address] = data
        try:
            self._run(download)
        except SdoAbortedError:
            del self._unconfirmed[address]
            raise
        if unconfirmed == data:
            return  # this may be the late confirmation: the other one may still come
        del self._unconfirmed[address]
        if unconfirmed is not None and (found := self.read(index, subindex)[: len(data)]) != data:
            raise SdoCommunicationError(f"{index:04X}h/{subindex} is {found.hex()} after the write of {data.hex()}")

    def read_urgently(self, index: int, subindex: int = 0) -> int:
        """An unsigned integer, as ``read_number``; a lost frame costs a tenth of the time for answers.

        ValueError if only frames other than SDO arrived.
        """
        upload = Upload(index, subindex, self.timeout_ns)
        try:
            self._run(upload, self._repeats)
        except SdoAbortedError as error:
            raise self._unreadable(index, subindex, error) from error
        except SdoCommunicationError as error:
            if upload.broken:
                raise ValueError(upload.broken) from error
            raise
        return self.integer(upload)

    def write_urgently(self, index: int, subindex: int, data: bytes) -> None:
        """As ``write``, 1 to 4 bytes, before all that waits for the bus.

        A lost frame costs a tenth of the time for answers. The object takes the value twice then.
        """
        self._run(Download(index, subindex, data, self.timeout_ns), self._repeats, first=True)

    def _begin_access(self) -> None:
        """Begin an access. A second answer to a repeated request, or that to a question, must not count as its answer.

        No access continues if two devices answer: their answers would be mixed.
        """
        if self.doubles.proof:
            raise self.two_devices()
        while not self._interrupted and (left := self._open_until - self.loop.now()) > 0:
            self._ended.clear()
            self._ended.wait(left)
        if self._interrupted:
            raise SdoCommunicationError(f"node {self._node_id} is lost")
        self._open = 0
        self.accesses += 1

    def _run(self, transfer: Transfer, repeats: int = 0, *, first: bool = False) -> None:
        """Carry out a transfer. Its request is sent again ``repeats`` times; ``first``: before all that waits for the bus."""
        loop = self.loop
        self._begin(transfer, first=first)
        again = loop.now() + self.timeout_ns // _REPEAT_AFTER
        while not transfer.ended:
            now = loop.now()
            if repeats and now >= again:
                repeats -= 1
                again = now + self.timeout_ns // _REPEAT_AFTER
                self._expect_answer()
                self._send([transfer.request], first=first)
            self._send(transfer.check(now))
            if not transfer.ended:
                self._ended.clear()
                self._ended.wait((min(transfer.due, again) if repeats else transfer.due) - now)
        if transfer.broken and not self._is_short and not transfer.failure:
            self._is_short = True
            log.info("node %d: an SDO confirmation has %s: accepted", self._node_id, transfer.broken)
        if transfer.code is not None:
            raise SdoAbortedError(transfer.code, self._where(transfer.index, transfer.subindex))
        if transfer.failure:
            self._open_until = 0
            raise SdoCommunicationError(self._where(transfer.index, transfer.subindex) + transfer.failure)

    # -- frames -----------------------------------------------------------------------------------------------------

    def _begin(self, transfer: Transfer, then: Callable[[], None] | None = None, *, first: bool = False) -> None:
        now = self.loop.now()
        self._request = _Request(transfer, now, then)
        transfer.begin(now)
        self._send([transfer.request], first=first)

    def _send(self, frames: list[bytes], *, first: bool = False) -> None:
        for frame in frames:
            self.doubles.requested(frame)
            self._network.request_sdo(self._node_id, frame, first=first)

    def _receive(self, frame: bytes, now: int) -> None:
        """A frame of the node."""
        request = self._request
        if frame and frame[0] == ABORT:
            self.aborts += 1
        self.doubles.answered(frame)
        if request is None:
            return
        transfer = request.transfer
        if transfer.ended:
            request.answers_late = request.answers_late or address_in(frame) == transfer.address
            self._has_answered()
            return
        self._send(transfer.take(frame, now))
        if transfer.ended:
            self._ended.set()
            if request.then is not None:
                self._has_answered()
                request.then()

    def _has_answered(self) -> None:
        """An answer has arrived for which the next access waits."""
        self._open = max(0, self._open - 1)
        if not self._open:
            self._open_until = 0
            self._ended.set()

    def ask(self, index: int, subindex: int, then: Callable[[Upload], None]) -> None:
        """Request an object without waiting, while no task has an access. ``then`` is called with the answer."""
        upload = Upload(index, subindex, self.timeout_ns)
        self._begin(upload, lambda: then(upload))
        self._expect_answer()

    @property
    def answers_late(self) -> bool:
        """The answer to the last request, which was aborted, has arrived."""
        return self._request is not None and self._request.answers_late

    @property
    def begun_ns(self) -> int:
        """When the last request was sent, monotonic nanoseconds; 0: never."""
        return 0 if self._request is None else self._request.begun_ns

    @property
    def awaits_answer(self) -> bool:
        """An answer to a question may still arrive."""
        return self.loop.now() < self._open_until

    @property
    def asked(self) -> int:
        """Index of the object of the access that was begun last."""
        return 0 if self._request is None else self._request.transfer.index

    # -- numbers ----------------------------------------------------------------------------------------------------

    def integer(self, upload: Upload, *, signed: bool = False) -> int:
        """The integer that was read."""
        return int.from_bytes(self._value(upload), "little", signed=signed)

    def read_number(self, index: int, subindex: int = 0, *, signed: bool = False) -> int:
        """An integer object, in the node's task only."""
        return int.from_bytes(self.read(index, subindex), "little", signed=signed)

    def require(self, index: int, subindex: int = 0, *, signed: bool = False) -> int:
        """As ``read_number``, with an abort that names the object."""
        try:
            return self.read_number(index, subindex, signed=signed)
        except SdoAbortedError as error:
            raise self._unreadable(index, subindex, error) from error

    def two_devices(self) -> CanopenError:
        """The package's error for a node-ID that two devices have."""
        return self.error_type(
            f"node-ID {self._node_id}",
            f"two devices? {self.doubles.proof}",
            f"one device with node-ID {self._node_id} on the bus",
            DISCONNECT,
        )

    def _where(self, index: int, subindex: int) -> str:
        return f"node {self._node_id} object {index:04X}h/{subindex}"

    def _unreadable(self, index: int, subindex: int, error: SdoAbortedError) -> CanopenError:
        return self.error_type(
            self._where(index, subindex),
            abort_text(error.code),
            "an object that can be read",
        )


class Inquiry(SdoAccess):
    """Queries a node until the end of the ``with`` block, inside a task. ``timeout_s``: for each answer."""

    def __init__(self, network: CanNetwork, node_id: int, timeout_s: float) -> None:
        super().__init__(network, node_id, canopen.ObjectDictionary())
        self.node_id = node_id
        self.set_timeout(int(timeout_s * SECOND), slow=False)

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def fetch(self, index: int, subindex: int = 0) -> bytes | None:
        """What an object holds: None where the node does not have it, nothing where it cannot be read now.

        Raises SdoCommunicationError when the node does not answer.
        """
        try:
            return self.read(index, subindex)
        except SdoAbortedError as error:
            return None if error.code in NOT_THERE else b""

    def number(self, index: int, subindex: int = 0) -> int | None:
        """An unsigned number; None where there is none."""
        data = self.fetch(index, subindex)
        return int.from_bytes(data, "little") if data else None

    def text(self, index: int) -> str:
        """A visible string; empty where there is none."""
        return (self.fetch(index) or b"").decode("latin-1").rstrip("\0 ").strip()
