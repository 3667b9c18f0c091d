"""A drive whose RPDOs are all due in each cycle, on a bus that has room for one frame at a time."""

from __future__ import annotations

from pdgw.ds301.node.node import NodeStatus
from pdgw.durations import MS, SECOND
from tests.support.axis.limit_cycle import Site


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
