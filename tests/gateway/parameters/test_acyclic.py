"""The record port under a flood: served by budget, beside everything else on the loop."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from uuid import UUID

from pdgw.durations import MS
from pdgw.gateway.links.udp import Address
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.client import RecordCaller
from tests.support.gateways.daemon import axis, configuration, record_server, running, world_of

FLOOD = 200
AT_ONCE = 16
"""Datagrams the server takes from the kernel before it has served them."""


def test_a_flooded_record_port_takes_few_datagrams_and_serves_one_a_slice() -> None:
    with running(configuration(axis(1))) as daemon:
        server, loop, network = record_server(daemon), daemon.loop, world_of(daemon).network
        served: list[int] = []
        taken, slices, most = 0, 0, 0
        take: Callable[[], tuple[bytes, Address] | None] = server.port.receive
        answer = server.server.receive

        def taking() -> tuple[bytes, Address] | None:
            nonlocal taken, most
            found = take()
            taken += found is not None
            most = max(most, taken - len(served))
            return found

        def answering(data: bytes, source: Address, now: int = 0) -> list[bytes]:
            served.append(slices)
            loop.add_slice(other)
            return answer(data, source, now)

        def other() -> None:
            nonlocal slices
            slices += 1

        server.port.receive = taking  # type: ignore[method-assign]
        server.server.receive = answering  # type: ignore[method-assign]
        unknown_sender = network.open("stranger", 0, "flood")
        call = RecordCaller(UUID(int=9), dcerpc.object_uuid(1, 1, 1)).read(0, 0, 1, 0xAFF0, implicit=True)
        for _ in range(FLOOD):
            unknown_sender.send(call.packets[0], server.address)
        world_of(daemon).loop.run_for(200 * MS)
    assert len(served) == FLOOD
    assert most <= AT_ONCE
    assert all(later > earlier for earlier, later in pairwise(served)), "others go on in between"
