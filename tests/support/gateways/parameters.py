"""Requests to the parameter channel of a running gateway, and what they answered."""

from __future__ import annotations

from contextlib import AbstractContextManager

from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import ParameterAddress, Values
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


def error(answer: Values) -> int:
    assert answer.failed, answer.text
    return int(answer.values[0])
