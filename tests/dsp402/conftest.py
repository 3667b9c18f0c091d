"""The bus of the tests of the drive client."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.drives.plant import Plant
from tests.support.gateways import site


@pytest.fixture
def plant() -> Iterator[Plant]:
    with site.guarded_network() as network:
        plant = Plant(network)
        yield plant
        plant.close()
