"""Tests on CAN interfaces of a real kernel: ``make test-can`` runs them, ``make test`` does not.

They make and remove interfaces, so they have a network of their own, or a virtual machine: see ``run``. Its Python may be eight
times slower than outside: cycles are long, waiting is patient, and nearly everything happens in the one process of the tests.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.can.interfaces import Wire, vcan, wire

HERE = Path(__file__).parent
ELSEWHERE = pytest.mark.skipif("PDGW_TEST_CAN" not in os.environ, reason="make test-can runs them")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """``make test`` imports these tests, and runs none of them."""
    for item in items:
        if item.path.is_relative_to(HERE):
            item.add_marker(ELSEWHERE)


@pytest.fixture
def line() -> Iterator[Wire]:
    """Two interfaces on one wire, up."""
    with wire() as made:
        yield made


@pytest.fixture
def virtual() -> Iterator[str]:
    """A vcan, up: every socket on it hears the others. It takes CAN FD."""
    with vcan("vcan0") as name:
        yield name
