"""Parameter accesses of the PLC simulator, served while the cyclic exchange continues."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from uuid import UUID

from pdgw.client.address import Target
from pdgw.client.session import Element, Session
from pdgw.client.udp import ParameterClient
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.udp import Address
from pdgw.profinet.rpc.records import NIL

log = logging.getLogger("peers")


@dataclass(slots=True)
class ParameterAccess:
    """One request to a drive object: one element of each target is read, or written with ``values``.

    ``done`` is set last. Then ``answers`` has an element for each target, or ``error`` says why there are none.
    """

    do_id: int
    targets: tuple[Target, ...]
    values: tuple[str, ...] = ()
    answers: tuple[Element, ...] = ()
    error: str = ""
    done: bool = False

    def serve(self, client: ParameterClient) -> None:
        """Send the request; a failure is stored in ``error``."""
        client.do_id = self.do_id
        session = Session(client)
        try:
            writes = list(zip(self.targets, self.values, strict=False))
            self.answers = tuple(session.write_texts(writes) if writes else session.read_first(self.targets))
        except GatewayError as error:
            self.error = str(error)
        except Exception as error:  # an error of this access only: serve the next one
            log.exception("a parameter access failed")
            self.error = repr(error)
        self.done = True


class ParameterWorker:
    """Serves accesses on its own thread, one after the other."""

    def __init__(
        self,
        address: Address,
        capture: Callable[[Address], Callable[[bool, bytes], None]] | None = None,
        *,
        ar_uuid: UUID = NIL,
        device: UUID | None = None,
    ) -> None:
        """``capture`` gets the client's own address and returns a function for every datagram (sent, data).

        ``ar_uuid`` and ``device``: the relationship and the object UUID of a PROFINET device.
        """
        self._client = ParameterClient(address, 1, ar_uuid=ar_uuid, device=device)
        if capture is not None:
            self._client.tap = capture(self._client.local_address)
        self._waiting: queue.SimpleQueue[ParameterAccess | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._serve, name="parameters", daemon=True)
        self._thread.start()

    def submit(self, access: ParameterAccess) -> None:
        self._waiting.put(access)

    def close(self) -> None:
        """Close after the present access, which has a timeout."""
        self._waiting.put(None)
        self._thread.join()
        self._client.close()

    def _serve(self) -> None:
        while (access := self._waiting.get()) is not None:
            access.serve(self._client)
