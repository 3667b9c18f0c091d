"""The parameter manager: serves parameter requests beside the cyclic exchange, one task per drive object.

A slow or dead drive delays only the requests of its own DO. Each request has a time limit, and is always answered.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future

from pdgw.base.durations import MS
from pdgw.ds301.loop.loop import Event, Loop
from pdgw.gateway.parameters.bound_object import BoundObject, RequestedObject
from pdgw.gateway.parameters.objects import RequestContext
from pdgw.gateway.parameters.profile import MAX_BLOCK, AxisObject, DeviceObject, EncoderChannelObject, NodeObject
from pdgw.gateway.service.running import RunningGateway
from pdgw.profidrive.parameters.codec import is_negative
from pdgw.profidrive.parameters.model import answer

_DO_ID_OFFSET = 2


class ParameterManager:
    """All drive objects of a daemon."""

    def __init__(self, daemon: RunningGateway) -> None:
        nodes: list[NodeObject] = [AxisObject(daemon, axis) for axis in daemon.axes]
        nodes += [EncoderChannelObject(daemon, encoder) for encoder in daemon.encoders]
        self._objects: dict[int, BoundObject] = {node.do_id: node for node in nodes}
        self._objects[0] = DeviceObject(daemon, nodes)
        self.slots: tuple[int, ...] = (0, *(node.do_id for node in nodes))
        """The DO of each slot."""
        timeout = daemon.config.parameter_timeout_ms * MS
        self._workers = {do_id: _Worker(daemon.loop, do_id, timeout) for do_id in self._objects}

    def submit(self, data: bytes, slot_do: int | None = None, host: str | None = None) -> Future[bytes | None]:
        """Serve a request (at least its header must be there).

        ``slot_do`` is the DO of the slot for a local access: it is meant by its own DO-ID and by 0. ``host``: who asks.
        """
        requested = data[_DO_ID_OFFSET]
        meant: int | None = requested
        if slot_do is not None:
            meant = slot_do if requested in {0, slot_do} else None
        drive_object = self._objects.get(meant) if meant is not None else None
        worker = self._workers[drive_object.do_id if drive_object is not None else 0]
        return worker.submit(data, drive_object, host)

    def stop(self) -> None:
        """Requests that wait are dropped; one in work ends where it waits."""
        for worker in self._workers.values():
            worker.stop()


class _Worker:
    """The requests of one drive object, one after the other."""

    def __init__(self, loop: Loop, do_id: int, timeout: int) -> None:
        self._loop = loop
        self._timeout = timeout
        self._requests: deque[tuple[Future[bytes | None], bytes, BoundObject | None, str | None]] = deque()
        self._filled = Event(loop)
        self.answered = 0
        self.refused = 0
        part = f"parameters of DO {do_id}"
        self._ended = f"a request for {part} was aborted"
        loop.counters.add(part, "answered", "requests", "answered with all values", lambda: self.answered)
        loop.counters.add(part, "refused", "requests", "answered, at least one value rejected", lambda: self.refused)
        self._task = loop.spawn(self._run, part)

    def submit(self, data: bytes, drive_object: BoundObject | None, host: str | None) -> Future[bytes | None]:
        future: Future[bytes | None] = Future()
        self._requests.append((future, data, drive_object, host))
        self._filled.set()
        return future

    def stop(self) -> None:
        self._task.kill()
        for future, *_ in self._requests:
            future.cancel()
        self._requests.clear()

    def _run(self) -> None:
        while True:
            self._filled.wait()
            self._filled.clear()
            while self._requests:
                self._serve(*self._requests.popleft())

    def _serve(
        self, future: Future[bytes | None], data: bytes, drive_object: BoundObject | None, host: str | None
    ) -> None:
        if not future.set_running_or_notify_cancel():
            return
        context = RequestContext(host, self._loop.now() + self._timeout)
        asked = None if drive_object is None else RequestedObject(drive_object, context)
        try:
            response = answer(data, lambda _: asked, MAX_BLOCK)
        except Exception as error:  # an error of one request: its client gets a rejection, the next one is served
            self._loop.unexpected(self._ended, error)
            future.set_exception(error)
        else:
            if response is None or is_negative(response):
                self.refused += 1
            else:
                self.answered += 1
            future.set_result(response)
