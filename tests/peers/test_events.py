"""A simulated node that is woken only when it has something to do does what one does that is polled all the time."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdgw.base.durations import MS
from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.drive.images import DriveCommand
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.peers.drive import Machine, SimulatedDriveNode
from pdgw.peers.drive.model.latency import NO_LATENCY, Latency
from pdgw.peers.encoder import SimulatedEncoderNode
from pdgw.peers.encoder.motion import constant_speed, still
from pdgw.peers.node.node import SimulatedNode
from pdgw.peers.node.node_behaviours import NODE_HABITS
from tests.support.axis.mapping import pdo_steps
from tests.support.axis.strategies import latencies

NODE = 5
SMALL = Machine(negative_limit=-20_000, positive_limit=20_000, negative_stop=-30_000, positive_stop=30_000)

Send = Callable[[int, bytes], None]
Event = tuple[int, Callable[[SimulatedNode], None]]
"""Millisecond and what happens then."""


class Life:
    """A node with the events of its life, and every frame it sends with its time."""

    def __init__(self, make: Callable[[Send], SimulatedNode], events: list[Event], end: int) -> None:
        self.frames: list[tuple[int, int, bytes]] = []
        self.polls = 0
        self.now = 0
        self.node = make(lambda can_id, data: self.frames.append((self.now // MS, can_id, data)))
        self._events = [(when * MS, action) for when, action in sorted(events, key=lambda item: item[0])]
        self._end = end * MS
        self.node.start(0)

    def _happen(self) -> None:
        while self._events and self._events[0][0] <= self.now:
            self.node.catch_up(self.now)
            self._events.pop(0)[1](self.node)

    def _poll(self) -> None:
        self.polls += 1
        self.node.poll(self.now)

    def polled(self) -> Life:
        """Each millisecond, and whenever the node asks for it at once."""
        while self.now < self._end:
            self._happen()
            self._poll()
            self.now += MS
        return self

    def woken(self) -> Life:
        """Only when it asks for it, in whole milliseconds."""
        while self.now < self._end:
            self._happen()
            event = self.node.next_event(self.now)
            if event is not None and event <= self.now:
                self._poll()
                event = self.node.next_event(self.now)
                assert event is None or event > self.now, "what is done is not asked for again"
            following = [time for time, _ in self._events[:1]] + [self._end]
            self.now = min([*following, self._end if event is None else -(-event // MS) * MS])
        return self


def drive(
    send: Send, latency: Latency = NO_LATENCY, operation: Operation = Operation.POSITIONING
) -> SimulatedDriveNode:
    node = SimulatedDriveNode(NODE, send, machine=SMALL, latency=latency)
    available = [index for index in node.indices if 0x1400 <= index < 0x1A00]
    node.start(0)
    for step in pdo_steps(LAYOUTS[operation], NODE, available, sync=False, event_ms=20, inhibit_us=3000):
        node.set_data(step.index, step.subindex, step.data, check_writable=True)
    node.set_data(0x1017, 0, (25).to_bytes(2, "little"))
    node.set_data(0x1016, 1, struct.pack("<I", 127 << 16 | 90))
    node.set_data(0x6007, 0, struct.pack("<h", 3))
    return node


def encoder(send: Send) -> SimulatedEncoderNode:
    node = SimulatedEncoderNode(NODE, send, motions=[constant_speed(0.5)])
    node.start(0)
    node.set_data(0x6200, 0, (7).to_bytes(2, "little"))
    node.set_data(0x1017, 0, (25).to_bytes(2, "little"))
    return node


def frame(can_id: int, data: bytes) -> Callable[[SimulatedNode], None]:
    return lambda node: node.receive(can_id, data, node.now)


def command(operation: Operation = Operation.POSITIONING, **values: int) -> list[tuple[int, bytes]]:
    image = DriveCommand()
    for name, value in values.items():
        setattr(image, name, value)
    rpdos = sorted(LAYOUTS[operation].rpdos, key=lambda pdo: -pdo.number)
    return [(pdo.cob_id(NODE), pdo.pack(image)) for pdo in rpdos]


words = st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x3F, 0x5F, 0x10F, 0x11F, 0x80])
modes = st.sampled_from([Mode.VELOCITY, Mode.POSITION, Mode.HOMING, Mode.TORQUE])
moments = st.integers(min_value=2, max_value=900)


@st.composite
def commands(draw: st.DrawFn) -> list[Event]:
    when = draw(moments)
    values = {
        "controlword": draw(words),
        "modes_of_operation": int(draw(modes)),
        "target_position": draw(st.sampled_from([0, 5000, -25_000, 40_000])),
        "profile_velocity": draw(st.sampled_from([100, 3000])),
        "profile_acceleration": draw(st.sampled_from([50, 1000])),
        "profile_deceleration": draw(st.sampled_from([50, 1000])),
    }
    return [(when, frame(can_id, data)) for can_id, data in command(**values)]


def write(index: int, subindex: int, data: bytes) -> Callable[[SimulatedNode], None]:
    header = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex)
    return frame(0x600 + NODE, header + data.ljust(4, b"\0"))


others = st.one_of(
    st.just(frame(0, bytes((NmtCommand.START, NODE)))),
    st.just(frame(0, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, NODE)))),
    st.just(frame(0x77F, b"\x05")),
    st.just(frame(0x80, b"")),
    st.just(write(0x60FF, 0, struct.pack("<i", 4000))),
    st.just(write(0x1017, 0, struct.pack("<H", 40))),
    st.sampled_from(sorted(NODE_HABITS)).map(lambda name: lambda node: node.start_fault(name) and None),
    st.just(lambda node: node.end_fault()),
)
device_events = st.lists(st.tuples(moments, others).map(lambda event: [event]), max_size=8)


@settings(max_examples=20)
@given(st.lists(commands(), max_size=6), device_events, latencies)
def test_a_drive_sends_the_same_frames(moves: list[list[Event]], others: list[list[Event]], latency: Latency) -> None:
    begin: list[Event] = [(1, frame(0, bytes((NmtCommand.START, NODE))))]
    begin += [(1, frame(can_id, data)) for word in (6, 7, 15) for can_id, data in command(controlword=word)]
    events = [*begin, *(event for group in (*moves, *others) for event in group)]
    polled = Life(partial(drive, latency=latency), list(events), 1000).polled()
    woken = Life(partial(drive, latency=latency), list(events), 1000).woken()
    assert woken.frames == polled.frames


@settings(max_examples=15)
@given(st.lists(st.tuples(moments, words, st.sampled_from([0, 200, 1000, -600])), max_size=4), latencies)
def test_a_drive_that_shows_no_position_sends_the_same_frames(
    moves: list[tuple[int, int, int]], latency: Latency
) -> None:
    """At constant speed it is woken for what its PDOs show alone; limit switches and stops are met all the same."""

    def moved(when: int, word: int, speed: int) -> list[Event]:
        return [(when, frame(*item)) for item in command(Operation.VELOCITY, controlword=word, target_velocity=speed)]

    begin: list[Event] = [(1, frame(0, bytes((NmtCommand.START, NODE)))), (1, write(0x6060, 0, b"\x03"))]
    begin += [event for word in (6, 7, 15) for event in moved(1, word, 1000)]
    events = [*begin, *(event for move in moves for event in moved(*move))]
    make = partial(drive, latency=latency, operation=Operation.VELOCITY)
    polled, woken = Life(make, list(events), 1000).polled(), Life(make, list(events), 1000).woken()
    assert woken.frames == polled.frames
    assert moves or woken.polls < 400


@settings(max_examples=20)
@given(device_events)
def test_an_encoder_sends_the_same_frames(others: list[list[Event]]) -> None:
    begin: list[Event] = [(1, frame(0, bytes((NmtCommand.START, NODE))))]
    events = [*begin, *(event for group in others for event in group)]
    assert Life(encoder, list(events), 400).woken().frames == Life(encoder, list(events), 400).polled().frames


def test_drive_at_standstill_is_polled_for_heartbeat_and_event_timer_only() -> None:
    life = Life(drive, [(1, frame(0, bytes((NmtCommand.START, NODE))))], 1000).woken()
    assert life.polls < 1000 // 25 + 1000 // 20 + 20


@pytest.mark.parametrize("speed", [500, 3000])
def test_constant_speed_gives_the_same_positions_as_single_ticks(speed: int) -> None:
    def turning(send: Send) -> SimulatedDriveNode:
        node = SimulatedDriveNode(NODE, send)
        node.start(0)
        return node

    events: list[Event] = [
        (1, write(0x6060, 0, b"\x03")),
        (1, write(0x60FF, 0, struct.pack("<i", speed))),
        *((2, write(0x6040, 0, struct.pack("<H", word))) for word in (6, 7, 15)),
        (1900, write(0x60FF, 0, bytes(4))),
    ]
    polled, woken = Life(turning, list(events), 2500).polled(), Life(turning, list(events), 2500).woken()
    for life in (polled, woken):
        life.node.catch_up(2500 * MS)
    assert polled.node.image.position_actual == woken.node.image.position_actual != 0  # type: ignore[attr-defined]
    assert woken.polls < polled.polls / 5


def test_encoder_at_standstill_is_polled_only_when_needed() -> None:
    life = Life(lambda send: SimulatedEncoderNode(NODE, send, motions=[still(0.5)]), [], 1000).woken()
    assert life.polls < 30
    assert life.node.read(0x6004) == 2048
