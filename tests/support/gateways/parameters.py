"""Requests to the parameter channel of a running gateway, and what they answered."""

from __future__ import annotations

from contextlib import AbstractContextManager

from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.catalogue import LIST_PNUS
from pdgw.profidrive.parameters.codec import MAX_ELEMENTS, Attribute, ParameterAddress, Values
from pdgw.profidrive.parameters.description import Description
from tests.support.gateways.daemon import configuration, serving


def gateway(axes: str) -> AbstractContextManager[tuple[Daemon, ParameterClient]]:
    return serving(configuration(axes), 1)


def value(client: ParameterClient, pnu: int, subindex: int = 0, elements: int = 0) -> Values:
    (answer,) = client.request([ParameterAddress(pnu, subindex, elements)])
    return answer


def number(client: ParameterClient, pnu: int, subindex: int = 0, elements: int = 0) -> int:
    answer = value(client, pnu, subindex, elements)
    assert not answer.failed, answer.text
    return int(answer.values[0])


def write(client: ParameterClient, pnu: int, content: Values, subindex: int = 0, elements: int = 0) -> Values:
    (answer,) = client.request([ParameterAddress(pnu, subindex, elements)], [content])
    return answer


def word(content: int) -> Values:
    return Values(DataType.WORD, (content,))


def double_word(content: int) -> Values:
    return Values(DataType.DOUBLE_WORD, (content,))


def error(answer: Values) -> int:
    assert answer.failed, answer.text
    return int(answer.values[0])


def lists(client: ParameterClient) -> list[list[int]]:
    """P980 and, where an entry is 980 to 989, the list that it names, as a tool reads them."""
    found: list[list[int]] = []
    follower = LIST_PNUS[0]
    while follower in LIST_PNUS:
        assert len(found) < len(LIST_PNUS), "a chain without an end"
        (raw,) = client.request([ParameterAddress(follower, 0, 0, Attribute.DESCRIPTION)])
        count = Description.decode(bytes(raw.values)).count  # type: ignore[arg-type]
        entries: list[int] = []
        while len(entries) < count:
            part = value(client, follower, len(entries), min(MAX_ELEMENTS, count - len(entries)))
            entries += [int(entry) for entry in part.values]
        found.append(entries[:-1])
        follower = entries[-1]
    assert follower == 0
    return found
