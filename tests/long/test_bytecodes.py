"""Bytecodes of a whole gateway in a cycle with telegram 1: at most 5 % more than before.

In virtual time, without what the simulated drives and the PLC execute. Callgrind would need minutes for these rows.
"""

from __future__ import annotations

import sys
from types import FrameType
from typing import Any

import pytest

from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.service.build import COMPILED, kind
from pdgw.peers.world import Plc
from tests.support.gateways.daemon import running, world_of

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
