"""Many axes on an interface with a short queue: setpoints of every axis are sent in every cycle, and a stop at once."""

from __future__ import annotations

from collections import Counter

import pytest

from pdgw.ds301.bus.load import frame_bits
from pdgw.dsp402.states import Command
from pdgw.durations import MS, SECOND
from pdgw.gateway.daemon import Daemon
from pdgw.peers.world import Member, World
from tests.support.gateways.daemon import OFF, ON, Plc, axis, configuration, running, until, world_of

AXES = 20
CYCLE_MS = 20
FRAME = frame_bits(8) * SECOND // 1_000_000
STOP = Command.QUICK_STOP.word.to_bytes(2, "little")
OFF3 = ON & ~0x0004


class Wire:
    """The RPDOs on the bus."""

    def __init__(self, world: World) -> None:
        self.counts: Counter[int] = Counter()
        self.stops: dict[int, int] = {}
        """By COB-ID: when Quick Stop was sent first."""
        world.bus("world").taps.append(self._see)

    def _see(self, now: int, _sender: Member, can_id: int, data: bytes) -> None:
        self.counts[can_id] += 1
        if data[-2:] == STOP:
            self.stops.setdefault(can_id, now)


def _in_operation(daemon: Daemon) -> Plc:
    plc = Plc(daemon, [1] * AXES)
    until(daemon, lambda: all(client.generation for client in daemon.clients), "online")
    for word, state in ((OFF, 0x01), (ON, 0x07)):
        for index in range(AXES):
            plc.endpoint.set(index, {"STW1": word})
        plc.until(lambda state=state: all(plc.state(i) == state for i in range(AXES)), f"state {state}")  # type: ignore[misc]
    return plc


def _move_all(plc: Plc, cycle: int, axes: range) -> None:
    for index in axes:
        plc.endpoint.set(index, {"STW1": ON, "NSOLL_A": 64 * (cycle + 1)})


@pytest.mark.parametrize("places", [1, 2, 10, 16])
def test_setpoints_of_twenty_axes_are_sent_in_every_cycle(places: int) -> None:
    config = configuration("".join(map(axis, range(1, AXES + 1))), transport=f"cycle_time_ms = {CYCLE_MS}\n")

    def before(daemon: Daemon) -> None:
        world_of(daemon).gateway_port("world").places = places

    with running(config, before) as daemon:
        plc = _in_operation(daemon)
        wire = Wire(world_of(daemon))
        for cycle in range(25):
            _move_all(plc, cycle, range(AXES))
            plc.exchange()
        assert {wire.counts[0x200 + node] for node in range(1, AXES + 1)} == {25}
        assert daemon.networks["can"].send_errors == 0
        begin = daemon.loop.now()
        plc.endpoint.set(AXES - 1, {"STW1": OFF3})
        _move_all(plc, 25, range(AXES - 1))
        plc.exchange()
        # The frames the interface has already, and one of another node that is on the wire.
        assert wire.stops[0x200 + AXES] - begin <= MS + (places + 2) * FRAME
        for index in range(AXES - 1):
            plc.endpoint.set(index, {"STW1": OFF3})
        begin = daemon.loop.now()
        plc.exchange()
        assert len(wire.stops) == AXES
        assert max(wire.stops.values()) - begin <= CYCLE_MS * MS
