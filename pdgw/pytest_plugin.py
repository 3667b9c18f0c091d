"""Fixtures for pytest: ``pytest_plugins = "pdgw.pytest_plugin"`` in a test module gives it a gateway in virtual time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import pdgw


@pytest.fixture
def gateway_config(request: pytest.FixtureRequest) -> pdgw.GatewayConfig:
    """The configuration: ``gateway.toml`` beside the test. Override this fixture for another one."""
    return pdgw.load_config(request.path.parent / "gateway.toml")


@pytest.fixture
def gateway(gateway_config: pdgw.GatewayConfig) -> Iterator[pdgw.Gateway]:
    """A running gateway with its simulated devices."""
    with pdgw.Gateway(gateway_config) as running:
        yield running


@pytest.fixture
def world(gateway: pdgw.Gateway) -> pdgw.World:
    """Clock, buses and network of ``gateway``."""
    return gateway.world


@pytest.fixture
def plc(gateway: pdgw.Gateway) -> pdgw.Plc:
    """The PLC of ``gateway``."""
    return gateway.plc
