"""Parameter accesses of the PLC simulator, served while the cyclic exchange continues."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from pdgw.client.address import Target
from pdgw.client.session import Element, Session
from pdgw.client.udp import ParameterClient
from pdgw.gateway.errors import GatewayError

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
