"""The gateway that tests share which change nothing."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from pdgw.gateway.daemon import Daemon
from pdgw.tools.client.udp import ParameterClient
from tests.support.gateways.daemon import axis
from tests.support.gateways.parameters import gateway


@pytest.fixture(scope="module")
def shared() -> Iterator[tuple[Daemon, ParameterClient]]:
    """One axis, no PLC on the cyclic side; for tests that change nothing."""
    with gateway(axis(1)) as pair:
        yield pair
