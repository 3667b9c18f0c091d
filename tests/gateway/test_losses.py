"""One loss of a node is one fault, whatever its task still reports, and a restart that the PLC asked for is none."""

from __future__ import annotations

import pytest

from pdgw import Gateway, parse_config
from pdgw.ds301.node.node import NodeStatus
from pdgw.gateway.base.fault_numbers import FaultNumber

CONFIG = """
[can]
interface = "virtual"
channel = "bus"
[[axis]]
do_id = 1
node_id = 1
telegram = 100
sdo_timeout_ms = 50
simulate = {}
"""
"""Telegram 100 with two PDOs: objects are written and read by SDO."""


def run(gateway: Gateway, cycles: int) -> None:
    """With another value of an object without PDO in each cycle."""
    for cycle in range(cycles):
        gateway.plc.exchange(0.004, 1, **{"Profile Velocity": 1000 + cycle, "Profile Acceleration": 1000 + cycle})


def online(gateway: Gateway) -> list[FaultNumber]:
    """Wait until the drive is online; return the faults until then."""
    axis = gateway.daemon.axes[0]
    for _ in range(20):
        if axis.client.status is NodeStatus.ONLINE:
            break
        gateway.plc.exchange(1.0, 1)
    return [record.number for record in axis.faults]


@pytest.mark.parametrize("cycles", range(2, 8))
def test_a_loss_while_a_write_is_open_is_one_fault(cycles: int) -> None:
    with Gateway(parse_config(CONFIG.format('["two-pdos", "slow-sdo delay_ms=20"]'))) as gateway:
        before = online(gateway)
        axis = gateway.daemon.axes[0]
        run(gateway, cycles)
        gateway.device(1).node.start_fault("bus-off", recovery_ms=0)
        run(gateway, 200)
        assert [record.number for record in axis.faults] == [*before, FaultNumber.NODE_LOST]
        assert axis.origins.present is not None
        assert axis.origins.present.times == 1


@pytest.mark.parametrize("cycles", range(20, 26))
def test_a_restart_that_was_asked_for_is_not_a_fault(cycles: int) -> None:
    """Also if a write is open, whose error comes after the restart began."""
    with Gateway(parse_config(CONFIG.format('["two-pdos", "boot-up-late boot_ms=1000"]'))) as gateway:
        before = online(gateway)
        axis = gateway.daemon.axes[0]
        run(gateway, cycles)
        axis.reset_node()
        run(gateway, 400)
        assert axis.client.generation == 2
        assert [record.number for record in axis.faults] == before
