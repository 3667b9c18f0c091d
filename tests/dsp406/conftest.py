"""The client and the encoder of the tests in this folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.dsp406.plant import Plant
from tests.support.gateways import site


@pytest.fixture
def plant() -> Iterator[Plant]:
    with site.guarded_network() as network:
        plant = Plant(network)
        yield plant
        plant.close()
