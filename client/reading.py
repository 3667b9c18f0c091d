"""Parameters of a device by their names, for programs."""

from __future__ import annotations

from pdgw.client.address import parse_target
from pdgw.client.session import Element, Session
from pdgw.client.udp import ParameterClient


def read_parameters(address: tuple[str, int], do_id: int, *parameters: str) -> list[Element]:
    """Elements of a drive object, in order: ``read_parameters(("127.0.0.1", 34964), 1, "P922", "6041h", "1018h.1-4")``.

    ``address``: host and UDP port of the record channel of a gateway or another PROFIdrive device. What the device refuses is
    among the elements (``failed``, ``error_text``). Raises GatewayError for a text that is no parameter, or when nobody answers.
    """
    targets = [parse_target(text) for text in parameters]
    with ParameterClient(address, do_id) as client:
        return Session(client).read(targets)
