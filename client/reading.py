"""Parameters of a device by their names, for programs."""

from __future__ import annotations

from pdgw.client.address import parse_target
from pdgw.client.session import Element, Session
from pdgw.client.udp import ParameterClient


def read_parameters(address: tuple[str, int], do_id: int, *parameters: str) -> list[Element]:
    """Read elements of a drive object, in order: ``read_parameters(("127.0.0.1", 34964), 1, "P922", "6041h", "1018h.1-4")``.

    ``address``: host and UDP port of the record channel of a gateway or another PROFIdrive device. Refused elements are in the
    result (``failed``, ``error_text``). Raises GatewayError for an invalid text, or without an answer.
    """
    targets = [parse_target(text) for text in parameters]
    with ParameterClient(address, do_id) as client:
        return Session(client).read(targets)
