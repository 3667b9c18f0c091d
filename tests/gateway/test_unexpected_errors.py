"""A program error in one request: its client gets an error, it is counted and logged, and the next request is served."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.parameters import manager
from pdgw.gateway.parameters.records import Records
from pdgw.profinet.rpc import dcerpc
from pdgw.tools.client.udp import ParameterClient
from tests.support.gateways.daemon import axis
from tests.support.gateways.parameters import gateway, number
from tests.support.gateways.profinet_daemon import PlantChannel, configuration, plant

STATION = ("192.168.0.2", 34964)
FAULT = "1C000012"
"""nca_s_fault_unspec of DCE 1.1, appendix E."""


@contextmanager
def over_udp(folder: Path) -> Iterator[tuple[Daemon, ParameterClient]]:
    with gateway(axis(1)) as made:
        yield made


@contextmanager
def over_profinet(folder: Path) -> Iterator[tuple[Daemon, ParameterClient]]:
    with plant(configuration(axis(1), folder / "store.json")) as site:
        site.connect()
        with ParameterClient(STATION, 1, channel=PlantChannel(site)) as client:
            client.connect()
            yield site.daemon, client


def mistaken(*_: object, **__: object) -> Any:
    raise KeyError("a mistake")


@contextmanager
def mistakes(daemon: Daemon, caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """What is asked meanwhile ends in mistakes; that they are counted is all they leave."""
    caplog.clear()
    yield
    assert daemon.loop.task_errors > 0
    tracebacks = [record for record in caplog.records if record.exc_info]
    assert len(tracebacks) == 1, "a caller who asks again and again does not fill the log"
    assert "KeyError: 'a mistake'" in caplog.text
    daemon.loop.task_errors = 0


EDGES = pytest.mark.parametrize("edge", [over_udp, over_profinet])
Edge = Callable[[Path], Any]


@EDGES
@pytest.mark.parametrize(
    ("place", "name", "told"),
    [(Records, "write", FAULT), (manager, "answer", "read error")],
    ids=["in a call: a FAULT of the RPC", "in a parameter request: a read error"],
)
def test_a_mistake_in_a_request_is_an_error_answer_for_its_caller_alone(
    edge: Edge,
    place: object,
    name: str,
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    with edge(tmp_path) as (daemon, client):
        with mistakes(daemon, caplog), monkeypatch.context() as planted:
            planted.setattr(place, name, mistaken)
            for _ in range(3):
                with pytest.raises(GatewayError, match=told):
                    number(client, 965)
            assert daemon.loop.task_errors == 3
        assert number(client, 965) == 0x0329


@EDGES
def test_a_datagram_that_even_cannot_be_answered_does_not_end_the_service(
    edge: Edge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with edge(tmp_path) as (daemon, client):
        decode = dcerpc.decode_packet
        left = [3]

        def decode_later(data: bytes) -> Any:
            left[0] -= 1
            return mistaken() if left[0] >= 0 else decode(data)

        with mistakes(daemon, caplog), monkeypatch.context() as planted:
            planted.setattr(dcerpc, "decode_packet", decode_later)
            assert number(client, 965) == 0x0329, "it asks again"
