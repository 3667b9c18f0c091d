"""The parameter channel as the page of ``pdgw web`` reads it: blocking calls, one connection for each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from pdgw.client.address import parse_target
from pdgw.client.dump import read_all
from pdgw.client.session import Element, Session, address_text, meaning
from pdgw.client.udp import ParameterClient
from pdgw.gateway.errors import GatewayError
from pdgw.web.errors import RequestError


class PageParameters:
    """Parameters of the gateway with the record channel at ``address``; None: no channel for this machine."""

    def __init__(self, address: tuple[str, int] | None) -> None:
        self._address = address

    def read(self, do_id: int, text: str) -> list[dict[str, Any]]:
        """The elements of ``P922``, ``6041h``, ``1018h.1-4``, with the device's refusals; RequestError for another text."""
        try:
            target = parse_target(text)
        except GatewayError as error:
            raise RequestError("pnu", str(error)) from error
        with self._session(do_id) as session:
            return [_document(session, element) for element in session.read([target])]

    def dump(self, do_id: int) -> dict[str, Any]:
        """As ``pdgw param dump`` writes it."""
        with self._session(do_id) as session:
            return read_all(session)[0].model_dump(mode="json")

    def names(self, do_id: int) -> list[dict[str, Any]]:
        """Parameters of the drive object, by number and name."""
        with self._session(do_id) as session:
            return [{"pnu": address_text(pnu), "name": session.name_and_unit(pnu, 0)[0]} for pnu in session.pnus()]

    @contextmanager
    def _session(self, do_id: int) -> Iterator[Session]:
        if self._address is None:
            raise GatewayError('transport type = "profinet": only the controller can read parameters, the page cannot')
        with ParameterClient(self._address, do_id) as client:
            yield Session(client)


def _document(session: Session, element: Element) -> dict[str, Any]:
    name, unit = session.name_and_unit(element.pnu, element.subindex)
    said = {
        "parameter": address_text(element.pnu, element.subindex or None),
        "name": name,
        "unit": unit,
        "meaning": meaning(element, encoder=session.is_encoder),
    }
    return element.document() | said
