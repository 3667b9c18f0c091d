"""The UDP port and the task of the acyclic server, beside the cyclic exchange."""

from __future__ import annotations

from collections import deque
from functools import partial
from ipaddress import IPv4Network
from typing import TYPE_CHECKING

from pdgw.ds301.loop.loop import Event, Task
from pdgw.gateway.base.udp import Address
from pdgw.gateway.links.link import watch_calls
from pdgw.gateway.parameters.manager import ParameterManager
from pdgw.gateway.parameters.profile import MAX_BLOCK
from pdgw.gateway.parameters.records import Records
from pdgw.gateway.service.running import RunningGateway
from pdgw.profinet.rpc.records import NIL
from pdgw.profinet.rpc.server import RecordHandler, RecordServer

if TYPE_CHECKING:
    from pdgw.gateway.links.profinet.io_device import ProfinetLink

_AT_ONCE = 16
_CALL = "a call of the record port was aborted"


class AcyclicServer:
    """A daemon's service: the parameter channel and the identification records on the acyclic port."""

    def __init__(self, daemon: RunningGateway) -> None:
        transport = daemon.config.transport
        self._loop = daemon.loop
        self._link = daemon.link
        self.port = daemon.platform.open_udp(str(transport.listen), transport.acyclic_port, "acyclic port")
        self._manager = ParameterManager(daemon)
        writers = daemon.config.parameters.writers(transport.listen)
        records = Records(daemon, self._manager, NIL, writers)
        self.server: RecordServer[Address] = RecordServer(
            records.of, MAX_BLOCK, boot_time=int(daemon.loop.wall()) & 0xFFFFFFFF
        )
        self.server.on_error = partial(daemon.loop.unexpected, _CALL)
        watch_calls(self.server, daemon.loop.counters, "records")
        self._datagrams: deque[tuple[bytes, Address]] = deque()
        self._filled = Event(daemon.loop)
        self._task: Task | None = None
        daemon.loop.counters.add("records", "errors", "datagrams", "send or receive failed", lambda: self.port.errors)

    @property
    def address(self) -> Address:
        """The address that it listens on."""
        return self.port.address

    def start(self) -> None:
        self._task = self._loop.spawn(self._serve, "acyclic server")

    def stop(self) -> None:
        """Drop requests in work without an answer."""
        if self._task is not None:
            self._task.kill()
        self._manager.stop()
        self.port.close()

    def _on_readable(self) -> None:
        """Serve a limited number: further datagrams wait in the kernel, where a flood is dropped."""
        for _ in range(_AT_ONCE):
            datagram = self.port.receive()
            if datagram is None:
                break
            self._datagrams.append(datagram)
        if self._datagrams:
            self.port.pause()
            self._filled.set()

    def _serve(self) -> None:
        while True:
            if not self._datagrams:
                self._filled.clear()
                self.port.start(self._on_readable)
                self._filled.wait()
            data, source = self._datagrams.popleft()
            try:
                recorder = self._link.recorder
                if recorder is not None:
                    recorder.datagram(source, self.address, data)
                for answer in self.server.receive(data, source, self._loop.now()):
                    self.port.send(answer, source)
                    if recorder is not None:
                        recorder.datagram(self.address, source, answer)
            except Exception as error:  # an error of one datagram: serve the next one
                self._loop.unexpected(_CALL, error)
            # One datagram at a time: the exchange has priority.
            self._loop.sleep(0)


class ProfinetRecords:
    """A daemon's service: the same records by the RPC of its PROFINET device.

    The IO controller may write; others with a device access relationship only where ``write_from`` has them. An answer is for
    the relationship that asked, whatever activities its calls have.
    """

    def __init__(self, daemon: RunningGateway, link: ProfinetLink) -> None:
        self._manager = ParameterManager(daemon)
        self._records = Records(daemon, self._manager, None)
        self._write_from = daemon.config.parameters.write_from or ()
        self._link = link
        link.serve_records(self._of)

    def _of(self, host: str) -> RecordHandler:
        relation = self._link.device.relation
        controller = () if relation is None else (IPv4Network(relation.source[0]),)
        self._records.writers = (*controller, *self._write_from)
        return self._records.of((host, 0), NIL)

    def start(self) -> None:
        """The link listens already."""

    def stop(self) -> None:
        """Requests in work are dropped."""
        self._manager.stop()


def record_service(daemon: RunningGateway) -> AcyclicServer | ProfinetRecords:
    """The record service on the transport of a daemon."""
    if daemon.config.transport.type == "udp":
        return AcyclicServer(daemon)
    from pdgw.gateway.links.profinet.io_device import (  # noqa: PLC0415 (the other transport starts without)
        ProfinetLink,
    )

    assert isinstance(daemon.link, ProfinetLink)
    return ProfinetRecords(daemon, daemon.link)
