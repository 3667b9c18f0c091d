"""A gateway ends, as commanded or killed, and the next one starts in the same world, beside the same devices and the same PLC."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.links.profinet.io_device import ProfinetLink
from tests.support.gateways.daemon import Plc, world_of
from tests.support.gateways.profinet_daemon import ControllerPlc

COMMANDED = "the last one ended on 2026-03-01 at 04:11:02: stopped as commanded"
KILLED = "the last one was killed or has crashed, its last sign of life was on 2026-03-01 at 04:11:02"


@contextmanager
def restarted(plc: Plc, daemon: Daemon, *, killed: bool = False) -> Iterator[Daemon]:
    """The next gateway, until the end of the block. CanopenError if it does not start."""
    world, ended = world_of(daemon), COMMANDED
    before = world.gateway_port("world")
    kept = daemon.origins()
    if killed:
        ended = KILLED
        for timer in (daemon._due, daemon._beat):
            assert timer is not None
            timer.cancel()
        daemon.release()
        daemon.stopped.set()
    else:
        daemon.stop()
        plc.until(daemon.stopped.is_set, "the end of the gateway")
        kept = daemon.origins()
        _pass(plc, 50 * MS)  # the interface sends what is in its queue
    if before in world.bus("world").members:
        world.bus("world").members.remove(before)
    _pass(plc, SECOND)  # a heartbeat consumer notices it
    site = plc.site if isinstance(plc, ControllerPlc) else None
    following = build_gateway(daemon.config, world, None if site is None else site.port)
    port = world.gateway_port("world")  # the same controller, in its state
    port.restart_ns, port.bus_off = before.restart_ns, before.bus_off
    vars(port).update((name, value) for name, value in vars(before).items() if name == "send")
    following.recall(ended, kept)
    plc.daemon, plc.gateway = following, following.address
    if site is not None:
        assert isinstance(following.link, ProfinetLink)
        site.daemon, site.link = following, following.link
    following.start()
    yield following
    following.stop()
    plc.until(following.stopped.is_set, "the end of the next gateway")


def _pass(plc: Plc, ns: int) -> None:
    plc.exchange(ns // plc.cycle_ns)
