"""Short runs of the benchmark's tables, and bytecodes of a gateway in a cycle with telegram 1: at most 5 % more than before.

The bytecodes are counted in virtual time, without what the simulated drives and the PLC execute. Callgrind would need minutes.
"""

from __future__ import annotations

import socket
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from pdgw.durations import MS
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.identity import COMPILED, kind
from pdgw.peers.world import Plc
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.frames.engine import Decoder, Settings, given_axes
from tests.long.bench import exchange, profinet, stops
from tests.support.gateways.daemon import running, world_of
from tests.support.readers.both_buses import write_capture


@pytest.mark.parametrize("loss", stops.LOSSES, ids=lambda loss: loss.cause)
def test_every_loss_stops_the_drive_within_its_bound(loss: stops.Loss) -> None:
    assert 0 < stops.measure(loss, 0) / MS <= loss.bound_ms


@pytest.mark.e2e
def test_row_of_the_exchange_has_gateway_and_floor() -> None:
    row = exchange.measure(4, 3, 20, 2)
    assert len(row.gateway.latencies) == len(row.floor.latencies) == 3
    assert row.gateway.cpu_us > 0
    assert row.floor.cpu_us > 0


def test_late_answer_is_missed_and_does_not_answer_the_next_cycle() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        peer = exchange.Peer(server.getsockname()[1], exchange.Echo(8))
        peer.send()
        peer.send()
        data, client = server.recvfrom(8)
        server.sendto(data, client)
        peer.run_out()
        assert (peer.samples, peer.missed) == ([], 2)
        peer.send()
        for _ in range(2):
            data, client = server.recvfrom(8)
        server.sendto(data, client)
        peer.run_out()
        assert (len(peer.samples), peer.missed) == (1, 2)
        peer.socket.close()


def test_percentiles_of_a_period_are_those_of_the_gaps() -> None:
    assert profinet.period([0, 1 * MS, 2 * MS, 5 * MS]) == (1.0, 3.0, 3.0)


def test_every_packet_of_the_measured_capture_has_values(tmp_path: Path) -> None:
    write_capture(tmp_path / "both.pcapng", 40)
    decoder = Decoder(Settings(given_axes([1])))
    with open_source(str(tmp_path / "both.pcapng")) as source:
        records = [decoder.decode(packet) for packet in source.packets]
    assert len(records) == 40
    assert {type(record).__name__ for record in records} == {"CyclicRecord", "PdoRecord"}


# -- bytecodes --------------------------------------------------------------------------------------------------------


KNOWN: dict[tuple[int, int, float], dict[tuple[int, int], int]] = {
    (1, 3, 1): {(3, 11): 4329},
    (8, 3, 4): {(3, 11): 23835},
    (30, 30, 10): {(3, 11): 146213},
}
"""Bytecodes of a cycle, by axes, axes on each bus and cycle time in milliseconds, then by version of Python."""
_CYCLES = 20


@pytest.mark.skipif(kind() == COMPILED, reason="a compiled gateway executes no bytecodes")
@pytest.mark.parametrize(("axes", "per_bus", "cycle_ms"), KNOWN)
def test_gateway_executes_no_more_bytecodes_than_before(axes: int, per_bus: int, cycle_ms: float) -> None:
    text = f"[transport]\ncycle_time_ms = {cycle_ms}\ncyclic_port = 0\nacyclic_port = 0\nstatus_port = 0\n"
    for axis in range(axes):
        if axis % per_bus == 0:
            text += f'[[can]]\nname = "{axis // per_bus}"\ninterface = "virtual"\nchannel = "{axis // per_bus}"\n'
        text += f'[[axis]]\ndo_id = {axis + 1}\nnode_id = {axis % per_bus + 1}\ncan = "{axis // per_bus}"\n'
        text += "telegram = 1\nsimulate = true\n"
    with running(parse_config(text)) as daemon:
        world = world_of(daemon)
        world.loop.until(lambda: all(axis.drive.generation for axis in daemon.axes), "online", 10**11)
        plc = Plc(world, daemon)
        for word, state in ((0x047E, 0x01), (0x047F, 0x07)):
            for axis in range(axes):
                plc.set(axis, {"STW1": word})
            plc.until(lambda: all(shown and shown["ZSW1"] & 0x4F == state for shown in plc.actuals), f"{state}")  # noqa: B023
        found = 0
        for cycle in range(_CYCLES):
            for axis in range(axes):
                plc.set(axis, {"NSOLL_A": 4 * cycle})
            found += _bytecodes(plc)
    count = found // _CYCLES
    known = KNOWN[axes, per_bus, cycle_ms].get(sys.version_info[:2])
    if known is None:
        pytest.skip(f"{count} bytecodes; not known for this Python")
    assert 0.95 * known <= count <= 1.05 * known


def _bytecodes(plc: Plc) -> int:
    """Bytecodes of the gateway in the next cycle."""
    count = 0

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal count
        if event == "call":
            # Generated functions have no module: they belong to their callers.
            module = frame.f_globals.get("__name__") or (frame.f_back or frame).f_globals["__name__"]
            if not module.startswith("pdgw.") or module.startswith("pdgw.peers."):
                return None
            frame.f_trace_opcodes, frame.f_trace_lines = True, False
        elif event == "opcode":
            count += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    plc.exchange(0)
    sys.settrace(before)
    return count
