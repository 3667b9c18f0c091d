"""Many nodes are switched on together: each comes online at its first attempt, and none is reported as missing."""

from __future__ import annotations

import pytest

from pdgw.ds301.communication import SDO_REQUEST
from pdgw.durations import SECOND
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon import Daemon
from pdgw.peers.world import Member, World
from tests.support.gateways.daemon import configuration, running, until, world_of

ABORT = 0x80
TIMED_OUT = (0x0504_0000).to_bytes(4, "little")
QUIET = "tpdo_event_ms = 1000\nheartbeat_ms = 1000\n"
"""Few frames beside the SDOs: what takes long here is to simulate that every node hears every frame."""


def _plant(buses: int, nodes: int, bitrate: int) -> GatewayConfig:
    can = "".join(
        f'[[can]]\nname = "{bus}"\ninterface = "virtual"\nchannel = "{bus}"\nbitrate = {bitrate}\n'
        for bus in range(buses)
    )
    axes = "".join(
        f'[[axis]]\ndo_id = {bus * nodes + node}\nnode_id = {node}\ntelegram = 1\ncan = "{bus}"\nsimulate = true\n{QUIET}'
        for bus in range(buses)
        for node in range(1, nodes + 1)
    )
    return configuration(axes, can=can, transport="cycle_time_ms = 200\nwatchdog_factor = 30\n")


@pytest.mark.parametrize(
    ("buses", "nodes", "bitrate", "limit_s"), [(1, 40, 1_000_000, 6), (8, 4, 1_000_000, 5), (1, 16, 125_000, 20)]
)
def test_every_node_is_online_at_its_first_attempt(buses: int, nodes: int, bitrate: int, limit_s: int) -> None:
    timed_out: list[int] = []

    def hear(_now: int, _member: Member, can_id: int, data: bytes) -> None:
        if can_id & ~0x7F == SDO_REQUEST and data[0] == ABORT and data[4:] == TIMED_OUT:
            timed_out.append(can_id - SDO_REQUEST)

    def before(daemon: Daemon) -> None:
        world: World = world_of(daemon)
        for bus in range(buses):
            world.bus(str(bus)).taps.append(hear)

    with running(_plant(buses, nodes, bitrate), before) as daemon:
        until(daemon, lambda: all(client.generation for client in daemon.clients), "all online", limit_s * SECOND)
        world_of(daemon).loop.run_for(SECOND)
        assert timed_out == []
        assert {client.generation for client in daemon.clients} == {1}
        assert [record.text for item in daemon.objects for record in item.faults] == []
