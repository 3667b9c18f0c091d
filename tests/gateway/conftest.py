"""The gateway that tests share which change nothing."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.daemon.daemon import Daemon
from tests.support.gateways.daemon import axis
from tests.support.gateways.parameters import gateway


@pytest.fixture(scope="module")
def shared() -> Iterator[tuple[Daemon, ParameterClient]]:
    """One axis, no PLC on the cyclic side; for tests that change nothing."""
    with gateway(axis(1)) as pair:
        yield pair
