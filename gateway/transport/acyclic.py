"""The acyclic server's edge: a UDP socket and a thread, beside the cyclic exchange."""

from __future__ import annotations

import threading
import time

from pdgw.gateway.daemon import Daemon
from pdgw.gateway.parameters.manager import ParameterManager
from pdgw.gateway.parameters.profile import MAX_BLOCK
from pdgw.gateway.records import Records
from pdgw.gateway.transport.cyclic import Address
from pdgw.gateway.transport.udp import UdpSocket
from pdgw.profinet.rpc.server import RecordServer

_WAIT_NS = 100_000_000


class AcyclicServer:
    """A daemon's service: the parameter channel and the identification records on the acyclic port."""

    def __init__(self, daemon: Daemon) -> None:
        transport = daemon.config.transport
        self.socket = UdpSocket(str(transport.listen), transport.acyclic_port, "acyclic port")
        self._manager = ParameterManager(daemon)
        serial = transport.station_name[:16]
        records = Records(self._manager, daemon.store, transport.ar_uuid, serial)
        self.server = RecordServer(records, MAX_BLOCK, boot_time=int(time.time()) & 0xFFFFFFFF)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="acyclic server", daemon=True)

    @property
    def address(self) -> Address:
        """Where it listens."""
        return self.socket.address

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Requests in work end by their time limit; nobody is answered any more."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self._manager.stop()
        self.socket.close()

    def _serve(self) -> None:
        while not self._stopping.is_set():
            if not self.socket.wait(_WAIT_NS):
                continue
            datagram = self.socket.receive()
            if datagram is None:
                continue
            data, source = datagram
            for answer in self.server.receive(data, source):
                self.socket.send(answer, source)
