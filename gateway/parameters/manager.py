"""The parameter manager: serves parameter requests beside the cyclic exchange, one worker per drive object.

A slow or dead drive delays only the requests of its own DO. Each request has a time limit, and is always answered.
"""

from __future__ import annotations

import contextvars
import time
from concurrent.futures import Future, ThreadPoolExecutor

from pdgw.gateway.daemon import Daemon
from pdgw.gateway.parameters.objects import request_deadline
from pdgw.gateway.parameters.profile import (
    MAX_BLOCK,
    AxisObject,
    BoundObject,
    DeviceObject,
    EncoderParameters,
    NodeObject,
)
from pdgw.profidrive.parameters.model import answer

_DO_ID_OFFSET = 2


class ParameterManager:
    """All drive objects of a daemon."""

    def __init__(self, daemon: Daemon) -> None:
        nodes: list[NodeObject] = [AxisObject(daemon, axis) for axis in daemon.axes]
        nodes += [EncoderParameters(daemon, encoder) for encoder in daemon.encoders]
        self._objects: dict[int, BoundObject] = {node.do_id: node for node in nodes}
        self._objects[0] = DeviceObject(daemon, nodes)
        self.slots: tuple[int, ...] = (0, *(node.do_id for node in nodes))
        """The DO of each slot."""
        self._timeout_s = daemon.config.transport.parameter_timeout_ms / 1000
        self._workers = {
            do_id: ThreadPoolExecutor(1, thread_name_prefix=f"parameters of DO {do_id}") for do_id in self._objects
        }

    def submit(self, data: bytes, slot_do: int | None = None) -> Future[bytes | None]:
        """Serve a request (at least its header must be there).

        ``slot_do`` is the DO of the slot for a local access: it is meant by its own DO-ID and by 0.
        """
        wanted = data[_DO_ID_OFFSET]
        meant: int | None = wanted
        if slot_do is not None:
            meant = slot_do if wanted in {0, slot_do} else None
        drive_object = self._objects.get(meant) if meant is not None else None
        worker = self._workers[drive_object.do_id if drive_object is not None else 0]
        return worker.submit(self._serve, data, drive_object)

    def _serve(self, data: bytes, drive_object: BoundObject | None) -> bytes | None:
        def serve() -> bytes | None:
            request_deadline.set(time.monotonic() + self._timeout_s)
            return answer(data, lambda _: drive_object, MAX_BLOCK)

        return contextvars.copy_context().run(serve)

    def stop(self) -> None:
        """Requests that wait are dropped; one in work ends by its time limit."""
        for worker in self._workers.values():
            worker.shutdown(wait=False, cancel_futures=True)
