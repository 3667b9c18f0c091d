"""The room of a bus: for the RPDOs of a cycle, and for the SDOs of the parameter channel beside them."""

from __future__ import annotations

from itertools import pairwise

from pdgw.ds301.bus.load import DEFAULT_BITRATE, bus_load, sdo_gap_ns
from pdgw.ds301.communication import SDO_REQUEST
from pdgw.ds301.node.node import NodeStatus
from pdgw.durations import MS, SECOND
from pdgw.gateway.configuration.bus_load import cyclic_frames
from pdgw.profidrive.parameters.codec import ParameterAddress
from tests.support.axis.limit_cycle import Site
from tests.support.gateways.daemon import axis, configuration, serving, until


def test_drive_on_sync_sends_each_rpdo_once_per_turn_after_an_outage() -> None:
    """The gateway's queue is full when its wire is joined again: each frame that leaves makes room for one."""
    site = Site(6, 25)
    site.loop.run_for(2 * SECOND)
    axis = site.daemon.axes[0]
    assert axis.drive.status is NodeStatus.ONLINE
    port = site.world.gateway_port("limit cycle")
    port.connect(False)
    site.loop.run_for(600 * MS)
    port.connect(True)
    before = site.world.bus("limit cycle").frames
    site.loop.run_for(SECOND)
    assert site.world.bus("limit cycle").frames - before < 1000, "a frame was sent again for each one that left"
    site.loop.run_for(SECOND)
    assert axis.drive.status is NodeStatus.ONLINE
    site.close()


def test_sdos_of_parameters_follow_each_other_as_fast_as_the_plan_of_the_bus_allows() -> None:
    config = configuration(axis(1))
    frames = cyclic_frames(config.axes_of(config.can[0]), {}, config.transport.cycle_time_ms)
    gap = sdo_gap_ns(bus_load(frames, DEFAULT_BITRATE), DEFAULT_BITRATE)
    requests: list[int] = []

    def listen(can_id: int, _data: bytes, sent: int, now: int) -> None:
        if sent and can_id == SDO_REQUEST + 1:
            requests.append(now)

    with serving(config) as (daemon, client):
        daemon.networks[config.can[0].name].tap = listen
        client.request([ParameterAddress(0x6080, 0, 1), ParameterAddress(0x6081, 0, 1)] * 4)
    found = [after - before for before, after in pairwise(requests)]
    assert len(found) == 7
    assert all(gap <= item < gap + 3 * MS for item in found)


def test_sdos_leave_room_for_the_pdos_of_the_telegram_that_p922_selects() -> None:
    can = '[can]\ninterface = "virtual"\nchannel = "world"\nbitrate = 250000\n'
    config = configuration(axis(1, telegram_number=100), can=can)
    gap = sdo_gap_ns(bus_load(cyclic_frames(config.axis, {}, config.transport.cycle_time_ms), 250_000), 250_000)
    requests: list[int] = []

    def listen(can_id: int, _data: bytes, sent: int, now: int) -> None:
        if sent and can_id == SDO_REQUEST + 1:
            requests.append(now)

    with serving(configuration(axis(1), can=can)) as (daemon, client):
        daemon.change_telegram(daemon.axes[0], 100)
        until(daemon, lambda: daemon.clients[0].generation == 2, "mapped again")
        daemon.networks["can"].tap = listen
        client.request([ParameterAddress(0x6080, 0, 1), ParameterAddress(0x6081, 0, 1)] * 4)
    assert min(after - before for before, after in pairwise(requests)) >= gap
