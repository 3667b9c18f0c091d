"""Mutated frames against everything that takes bytes from a wire: short in the tests, long with ``make fuzz``."""

from __future__ import annotations

import contextlib

from hypothesis import given, settings
from hypothesis import strategies as st

from pdgw.ds301.communication import EMCY, ERROR_CONTROL, SDO_RESPONSE
from pdgw.dsp402.states import state_of
from pdgw.durations import MS
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.new_frames import Verdict
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import RtFrame
from pdgw.profidrive.telegrams import Direction, Telegram
from tests.support.axis.strategies import axes_values
from tests.support.gateways import daemon as plant

CYCLE = 4_000_000
PEER = ("127.0.0.1", 40000)
ENCODER = "[[encoder]]\ndo_id = 2\nnode_id = 2\ntelegram = 81\nsimulate = true\n"
FROM_NODES = (EMCY, 0x180, 0x280, 0x380, 0x480, SDO_RESPONSE, ERROR_CONTROL)
"""Bases of what a node sends."""


@st.composite
def mutated(draw: st.DrawFn, original: bytes) -> bytes:
    """A frame with bytes flipped, cut off, repeated or added."""
    data = bytearray(original)
    for _ in range(draw(st.integers(0, 4))):
        kind = draw(st.sampled_from(["flip", "cut", "grow", "copy"]))
        if kind == "flip" and data:
            data[draw(st.integers(0, len(data) - 1))] ^= draw(st.integers(1, 255))
        elif kind == "cut":
            del data[draw(st.integers(0, len(data))) :]
        elif kind == "grow":
            data += draw(st.binary(max_size=40))
        else:
            data += data[: draw(st.integers(0, len(data)))]
    return bytes(data)


@given(drawn=axes_values(Direction.SETPOINT), data=st.data())
def test_gateway_endpoint_takes_or_counts_any_mutated_frame(
    drawn: tuple[list[Telegram], list[tuple[int, ...]]], data: st.DataObject
) -> None:
    telegrams, values = drawn
    plc = PlcEndpoint(telegrams, CYCLE)
    for index, axis in enumerate(values):
        plc.set(index, telegrams[index].setpoints.as_dict(axis))
    endpoint = CyclicEndpoint(telegrams, cycle_ns=CYCLE)
    original = bytes(plc.build())
    frame = data.draw(mutated(original))
    verdict = endpoint.receive(frame, PEER, CYCLE)
    assert sum(endpoint.counters.values()) == 1
    if frame == original:
        assert verdict is Verdict.ACCEPTED
    if verdict is not Verdict.ACCEPTED:
        assert all(axis is None for axis in endpoint.setpoints)


@given(drawn=axes_values(Direction.ACTUAL), data=st.data())
def test_plc_endpoint_takes_or_counts_any_mutated_frame(
    drawn: tuple[list[Telegram], list[tuple[int, ...]]], data: st.DataObject
) -> None:
    telegrams, values = drawn
    device = CyclicEndpoint(telegrams, cycle_ns=CYCLE)
    plc = PlcEndpoint(telegrams, CYCLE)
    frame = data.draw(mutated(bytes(device.build(values, [True] * len(values)))))
    plc.receive(frame)
    assert sum(plc.counters.values()) == 1
    with contextlib.suppress(ProfidriveError):
        RtFrame.decode(frame)


@given(frames=st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8), st.integers(0, 20)), max_size=30))
def test_simulated_drive_survives_any_frames(frames: list[tuple[int, bytes, int]]) -> None:
    node = SimulatedDriveNode(1, lambda *_: None)
    now = 0
    node.start(now)
    node.receive(0, b"\x01\x01", now)
    for can_id, data, wait in frames:
        now += wait * 1_000_000
        node.receive(can_id, data, now)
        node.poll(now)
    now += 1_000_000
    node.poll(now)
    assert state_of(node.model.statusword) is not None


@settings(max_examples=settings().max_examples // 4)
@given(
    frames=st.lists(
        st.tuples(st.sampled_from(FROM_NODES), st.integers(1, 3), st.binary(max_size=8), st.integers(0, 20)),
        min_size=1,
        max_size=40,
    ),
    started=st.booleans(),
)
def test_gateway_survives_any_frames_of_its_nodes(frames: list[tuple[int, int, bytes, int]], *, started: bool) -> None:
    """An exception in the receiver of a frame would end the loop, and with it the gateway."""
    with plant.running(plant.configuration(plant.axis(1) + ENCODER)) as daemon:
        world = plant.world_of(daemon)
        if started:
            plant.Plc(daemon, [1, 81]).enable()
        stranger = world.bus("world").join("stranger", len(frames))
        for base, node_id, data, wait in frames:
            stranger.send(base + node_id, data)
            world.loop.run_for(wait * MS)
        world.loop.run_for(100 * MS)
