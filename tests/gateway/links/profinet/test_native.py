"""The native engine decides as ``Consumer`` and ``Provider`` do, loses no order, and shows when Python stalls."""

from __future__ import annotations

import errno
import os
import random
import select
import socket
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.durations import MS
from pdgw.gateway.axis.values import Outputs
from pdgw.gateway.links.profinet import native
from pdgw.gateway.links.profinet.native import COUNTS, FOREIGN, OTHER, VERDICTS, table_of
from pdgw.profidrive.frame import IOPS_BAD, IOPS_GOOD, STATUS_NORMAL, STATUS_STOP
from pdgw.profinet import ethernet
from pdgw.profinet.connection.cpm import Consumer, Verdict
from pdgw.profinet.connection.ppm import Provider
from tests.support.gateways.daemon import axis, drive_of
from tests.support.gateways.profinet_daemon import OFF, ON, Plant, configuration, plant
from tests.support.native import NativeEthernet, engine_type
from tests.support.wire.profinet import DEVICE_MAC, OBJECTS, PLC_MAC, Wire

AXIS = (1, 2)
CYCLE = 4 * MS
SPEED = 0x1000


class Twin:
    """A connected device, and an engine with the facts of its relationship."""

    def __init__(self, *, wake_ns: int = CYCLE, align: bool = False, **changes: Any) -> None:
        self.wire = Wire()
        self.wire.connect()
        relation = self.wire.device.relation
        assert relation is not None
        assert relation.consumer is not None
        assert relation.provider is not None
        self.relation, self.consumer, self.provider = relation, relation.consumer, relation.provider
        telegrams = [telegram for _, telegram in OBJECTS]
        self.now = self.wire.now
        table = table_of(relation, self.consumer, self.provider, telegrams, cycle_ns=wake_ns, now=self.now)
        self.table = {**table, "align": align, **changes}
        self.engine = engine_type()(**self.table)
        self.mask = self.table["order_mask"]
        outputs = self.wire.plc.provider
        assert outputs is not None
        self.frame = bytes(outputs.frame[:12] + outputs.frame[16:])

    def received(self) -> list[int]:
        """What the device has counted, in the order of the engine's verdicts."""
        return [*(self.wire.device.cm.cyclic.received[verdict] for verdict in VERDICTS), self.wire.device.foreign]

    def order(self, payload: bytes) -> bytes:
        return bytes(byte & mask for byte, mask in zip(payload, self.mask, strict=True))


def changed(frame: bytes, changes: Sequence[tuple[int, int]], counter: int, status: int, transfer: int) -> bytes:
    out = bytearray(frame)
    for place, value in changes:
        out[place % len(out)] = value
    out[-4:] = (counter & 0xFFFF).to_bytes(2, "big") + bytes((status, transfer))
    return bytes(out)


@dataclass
class Sent:
    """The delay and the damage of one frame."""

    after_ns: int = CYCLE
    steps: int = 128
    status: int = STATUS_NORMAL
    transfer: int = 0
    data: list[tuple[int, int]] = field(default_factory=list)
    """Bytes of setpoints and statuses: offset after the FrameID, value."""
    tag: bool = False
    cut: int = 0
    damage: list[tuple[int, int]] = field(default_factory=list)
    """Bytes of the head."""
    takes: bool = False
    """Python takes everything then."""

    def of(self, frame: bytes, counter: int) -> bytes:
        out = bytearray(changed(frame, [], counter, self.status, self.transfer))
        for place, value in self.data:
            out[16 + place] = value
        for place, value in self.damage:
            out[place] = value
        if self.tag:
            out[12:12] = bytes.fromhex("8100c000")
        return bytes(out[: len(out) - self.cut] if self.cut >= 0 else out + bytes(-self.cut))


STATUSES = st.sampled_from([STATUS_NORMAL] * 6 + [STATUS_STOP, 0x34, 0x31, 0xB5, 0x15, 0]) | st.integers(0, 255)
FRAMES = st.lists(
    st.builds(
        Sent,
        after_ns=st.integers(0, 2 * CYCLE),
        steps=st.sampled_from([128] * 6 + [0, -1, 1, 61_440, 61_441]) | st.integers(-70_000, 70_000),
        status=STATUSES,
        transfer=st.sampled_from([0] * 9 + [1]),
        data=st.lists(st.tuples(st.integers(0, 8), st.sampled_from([0, 4, 0x7E, 0x7F, 0x80, 0xFF])), max_size=2),
        tag=st.booleans(),
        cut=st.sampled_from([0] * 12 + [1, -1, 4, 30, 41, 58, -1500]),
        damage=st.lists(st.tuples(st.integers(0, 15), st.integers(0, 255)), max_size=1) | st.just([]),
        takes=st.booleans(),
    ),
    max_size=40,
)


@given(FRAMES)
def test_every_frame_is_judged_as_by_the_device_itself(frames: list[Sent]) -> None:
    twin = Twin()
    octets = twin.wire.device._octets
    counter, before, heard_before = twin.consumer.counter or 0, twin.received(), octets[0]
    for sent in frames:
        twin.now += sent.after_ns
        counter += sent.steps
        frame = sent.of(twin.frame, counter)
        old = twin.received()
        twin.wire.device.on_frame(frame, twin.now)
        new = twin.received()
        verdict = twin.engine.offer(frame, twin.now)
        alarm_or_nothing = FOREIGN if ethernet.payload_of(frame)[0] != ethernet.ETHERTYPE_PROFINET else OTHER
        expected = next((place for place in range(8) if new[place] != old[place]), alarm_or_nothing)
        if verdict == OTHER:  # Python judges these: an alarm, or a frame of another relationship
            assert expected in {OTHER, FOREIGN}
        else:
            assert verdict == expected or (verdict == FOREIGN and expected == alarm_or_nothing)
    counts = dict(zip(COUNTS, twin.engine.counts(), strict=True))
    came = [counts[verdict] for verdict in VERDICTS]
    assert came == [after - first for after, first in zip(twin.received()[:7], before[:7], strict=True)]
    assert counts["octets in"] == octets[0] - heard_before


@given(FRAMES)
def test_python_sees_each_order_in_turn_and_ends_with_the_same_image(frames: list[Sent]) -> None:
    """``reference`` receives all frames; ``behind`` those that the engine hands over, at intervals."""
    twin = Twin()
    reference, behind = Consumer(twin.consumer.plan), Consumer(twin.consumer.plan)
    for item in (reference, behind):
        item.counter = twin.consumer.counter
    counter = twin.consumer.counter or 0
    seen: list[bytes] = []
    expected: list[bytes] = []

    def drain() -> None:
        while (taken := twin.engine.take(0)) is not None:
            frame, heard, lost = taken
            assert not lost, "no more frames than it keeps"
            if heard < 0:
                continue
            start = 18 if frame[12:14] == b"\x81\x00" else 14
            behind.counter = None  # as the link does: the engine has compared it
            assert behind.receive(frame, start, heard) in VERDICTS[:3]
            seen.append(twin.order(frame[start:]))
        assert (behind.payload, behind.running, behind.counter) == (
            reference.payload,
            reference.running,
            reference.counter,
        )
        assert behind.last_ns == reference.last_ns
        assert not twin.engine.more
        assert not twin.engine.signalled

    for sent in frames[:32]:
        twin.now += sent.after_ns
        counter += sent.steps
        frame = sent.of(twin.frame, counter)
        start = 18 if sent.tag else 14
        if twin.engine.offer(frame, twin.now) <= 2:
            assert reference.receive(frame, start, twin.now) in VERDICTS[:3]
            expected.append(twin.order(frame[start:]))
        if sent.takes:
            drain()
    drain()
    assert _runs(seen) == _runs(expected)
    counted = dict(zip(COUNTS, twin.engine.counts(), strict=True))
    for verdict in VERDICTS[:3]:
        assert counted[verdict] + behind.counters[verdict] == reference.counters[verdict]


def _runs(orders: list[bytes]) -> list[bytes]:
    """Without repetitions."""
    return [item for place, item in enumerate(orders) if not place or orders[place - 1] != item]


@given(st.lists(st.tuples(st.integers(0, 5 * CYCLE), st.integers(0, 255)), max_size=30))
def test_input_frames_are_those_of_the_provider(times: list[tuple[int, int]]) -> None:
    twin = Twin(bound_ns=1 << 60)
    provider, engine = twin.provider, twin.engine
    now = twin.now
    twin_of = Provider(twin.relation.plan.inputs, PLC_MAC, DEVICE_MAC, twin.relation.plan.proper)  # type: ignore[arg-type]
    twin_of.open()
    twin_of.due, twin_of.counter = provider.due, provider.counter
    for step, value in times:
        now += step
        twin_of.set(AXIS, bytes((value,)) * 4, good=value > 9)
        engine.publish(twin_of.image(engine.counter), now)
        frame = twin_of.poll(now)
        assert engine.provide(now) == (None if frame is None else bytes(frame))
        assert engine.due == twin_of.due
    assert engine.counter == twin_of.counter


def test_a_stalled_owner_makes_the_data_invalid_and_then_there_are_no_frames() -> None:
    twin = Twin()
    bound = twin.table["bound_ns"]
    place = twin.provider.place(AXIS)
    assert place is not None
    twin.provider.set(AXIS, bytes(4), good=True)
    begun = twin.now
    twin.engine.publish(twin.provider.image(twin.engine.counter), begun)
    good, bad, none = [], [], []
    for _ in range(3 * bound // CYCLE):
        now = twin.engine.due
        frame = twin.engine.provide(now)
        if frame is None:
            none.append(now - begun)
        else:
            statuses = {frame[iops] for iops in twin.provider.statuses}
            (bad if statuses == {IOPS_BAD} else good).append(now - begun)
            assert statuses == {IOPS_BAD} or frame[place[1]] == IOPS_GOOD
            assert frame[-2] == twin.provider.data_status
    assert max(good) <= bound < min(bad)
    assert max(bad) <= 2 * bound < min(none)
    counts = dict(zip(COUNTS, twin.engine.counts(), strict=True))
    assert (counts["sent"], counts["invalid"], counts["withheld"]) == (len(good) + len(bad), len(bad), len(none))
    twin.engine.publish(bytes(twin.provider.frame), twin.engine.due)
    frame = twin.engine.provide(twin.engine.due)
    assert frame is not None, "it is back"
    assert frame[place[1]] == IOPS_GOOD


@pytest.mark.parametrize("phase", range(0, CYCLE, CYCLE // 7))
def test_the_input_frame_is_moved_behind_the_frame_of_the_controller(phase: int) -> None:
    twin = Twin(align=True, due=100 * CYCLE + phase, counter=-1)
    moves = []
    for number in range(400):
        now = (100 + number) * CYCLE
        twin.engine.offer(changed(twin.frame, [], 128 * number, STATUS_NORMAL, 0), now)
        while (due := twin.engine.due) < now + CYCLE:
            twin.engine.provide(due)
            moves.append(twin.engine.due - due - CYCLE)
    assert max(map(abs, moves)) <= CYCLE // 64
    assert abs(twin.engine.due % CYCLE - CYCLE // 2) <= CYCLE // 64


def test_python_is_woken_by_each_change_and_by_every_nth_frame() -> None:
    twin = Twin(wake_ns=4 * CYCLE)
    counter, woken = twin.consumer.counter or 0, []
    for number in range(24):
        counter += 128
        speed = 0x80 if number >= 10 else 0
        frame = changed(twin.frame, [(18, speed)], counter, STATUS_NORMAL, 0)
        assert twin.engine.offer(frame, twin.now) == 0
        if twin.engine.signalled:
            woken.append(number)
            assert twin.engine.take(0) is not None
            assert twin.engine.take(0) is None
    assert woken == [0, 4, 8, 10, 14, 18, 22]


def test_orders_beyond_what_it_keeps_are_told_as_lost_and_the_newest_counts() -> None:
    twin = Twin()
    counter = twin.consumer.counter or 0
    for number in range(33):
        counter += 128
        frame = changed(twin.frame, [(17, number)], counter, STATUS_NORMAL, 0)
        twin.engine.offer(frame, twin.now)
    assert twin.engine.take(0) == (frame, twin.now, True)
    assert twin.engine.take(0) is None
    counter += 128
    twin.engine.offer(changed(twin.frame, [(17, 99)], counter, STATUS_NORMAL, 0), twin.now)
    taken = twin.engine.take(0)
    assert taken is not None
    assert not taken[2]


def test_an_order_that_waited_for_longer_than_the_limit_is_told_as_lost() -> None:
    twin = Twin()
    counter = twin.consumer.counter or 0
    for number, status in enumerate((STATUS_NORMAL, STATUS_STOP, STATUS_NORMAL), 1):
        frame = changed(twin.frame, [], counter + 128 * number, status, 0)
        twin.engine.offer(frame, twin.now + number * CYCLE)
    first = twin.engine.take(twin.now + CYCLE)
    assert first is not None
    assert not first[2]
    assert twin.engine.take(twin.now + 2 * CYCLE + 1) == (frame, twin.now + 3 * CYCLE, True)
    assert twin.engine.take(0) is None
    counter += 4 * 128
    same = changed(twin.frame, [], counter, STATUS_NORMAL, 0)
    twin.engine.offer(same, twin.now + 4 * CYCLE)
    assert twin.engine.take(twin.now + 9 * CYCLE) == (same, twin.now + 4 * CYCLE, False), "it has no other order"


def test_a_flood_of_other_frames_pushes_no_order_out() -> None:
    twin = Twin()
    other = changed(twin.frame, [(14, 0xFC), (15, 0x01)], 0, 0, 0)
    for _ in range(100):
        assert twin.engine.offer(other, twin.now) == OTHER
    order = changed(twin.frame, [(17, 5)], (twin.consumer.counter or 0) + 128, STATUS_NORMAL, 0)
    twin.engine.offer(order, twin.now)
    taken = []
    while (item := twin.engine.take(0)) is not None:
        taken.append(item)
    assert [item[1] for item in taken[:-1]] == [-1] * 16
    assert taken[-1] == (order, twin.now, False)
    assert dict(zip(COUNTS, twin.engine.counts(), strict=True))["dropped"] == 84


@pytest.mark.parametrize(
    "change",
    [
        {"head": b"1234"},
        {"tag": b""},
        {"counter_at": -1},
        {"status_at": 2000},
        {"bad_mask": b""},
        {"cycle_ns": 0},
        {"sent_at": 5000},
        {"frame": bytes(3000)},
        {"order_mask": b""},
        {"bound_ns": 0},
    ],
    ids=lambda change: next(iter(change)),
)
def test_a_table_that_does_not_fit_makes_no_engine(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="does not fit"):
        Twin(**change)


def test_without_the_module_or_with_one_of_another_version_there_is_no_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = Twin()
    assert native.make({**twin.table, "unknown": 1}) is None
    with pytest.raises(TypeError, match="keyword"):
        Twin(unknown=1)
    monkeypatch.setitem(sys.modules, "pdgw.gateway.links.profinet.engine", None)
    assert native.make(twin.table) is None


def test_the_thread_receives_sends_wakes_python_and_ends() -> None:
    """On a pair of sockets; whatever the machine does meanwhile."""
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    now = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    twin = Twin(due=now, bound_ns=1 << 60)
    engine = twin.engine
    with here, there:
        here.setblocking(False)
        there.settimeout(300)
        engine.start(here.fileno())
        with pytest.raises(RuntimeError):
            engine.offer(twin.frame, 0)
        with pytest.raises(RuntimeError):
            engine.provide(0)
        sent = [there.recv(2048) for _ in range(3)]
        counters = [int.from_bytes(frame[-4:-2], "big") for frame in sent]
        assert len(set(counters)) == 3
        assert {frame[:18] for frame in sent} == {bytes(twin.provider.frame[:18])}
        counter = twin.consumer.counter or 0
        orders = [changed(twin.frame, [(17, number)], counter + 128 * number, STATUS_NORMAL, 0) for number in (1, 2, 3)]
        for order in orders:
            there.send(order)
        taken: list[bytes] = []
        while len(taken) < 3:
            assert select.select([engine.fileno()], [], [], 300)[0]
            while (item := engine.take(0)) is not None:
                assert item[1] >= now
                taken.append(item[0])
        assert taken == orders
        engine.stop()
        engine.stop()
        assert engine.offer(twin.frame, now) in range(9)
    descriptor = engine.fileno()
    del engine, twin.engine
    with pytest.raises(OSError) as error:  # noqa: PT011
        os.fstat(descriptor)
    assert error.value.errno == errno.EBADF


# -- the gateway with the engine --------------------------------------------------------------------------------------


def controlwords(can: list[tuple[int, int, bytes]]) -> list[bytes]:
    """What the drive was ordered, without repetitions."""
    return _runs([data[:2] for _, can_id, data in can if can_id == 0x201])


def played(folder: Path, *, native: bool) -> tuple[list[bytes], dict[str, int]]:
    folder.mkdir()
    with plant(configuration(axis(1), folder / "store.json"), data_hold=400, native=native) as site:
        site.connect()
        site.enable(1, SPEED)
        for speed in (0x2000, 0x0800, 0):
            site.set(1, ON, speed)
            site.run(60 * MS)
        site.set(1, OFF, 0)
        site.run(500 * MS)
        site.enable(1, SPEED)
        assert isinstance(site.port, NativeEthernet) == native
        assert not native or site.port.given is not None  # type: ignore[union-attr]
        frames = site.link.status()["frames"]
        assert isinstance(frames, dict)
        return controlwords(site.can), frames


def test_a_drive_gets_the_same_orders_with_and_without_the_engine(tmp_path: Path) -> None:
    (pure, counted), (engine, counted_too) = (played(tmp_path / str(how), native=how) for how in (False, True))
    assert pure == engine
    assert len(pure) > 5
    assert counted[Verdict.ACCEPTED.value] == pytest.approx(counted_too[Verdict.ACCEPTED.value], abs=3)


def test_an_off_between_two_ons_reaches_the_drive_however_late_python_is(tmp_path: Path) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json", transport="watchdog_factor = 100"), native=True) as site:
        model = drive_of(site.daemon).model
        site.connect()
        site.enable(1, SPEED)
        port = site.port
        assert isinstance(port, NativeEthernet)
        port.held_up = True
        site.daemon._due.postpone(site.loop.now() + 40 * MS)  # type: ignore[union-attr]
        before = len(site.can)
        for word in (OFF & ~2, ON):
            site.set(1, word, SPEED)
            site.run(8 * MS)
        assert before == len(site.can) or model.state.name == "OPERATION_ENABLED"
        port.held_up = False
        port.wake()
        site.run(300 * MS)
        assert model.state.name != "OPERATION_ENABLED", "OFF2 was there, and ON without an edge starts nothing"


_ORDERS_LOST = "PLC lost: the gateway was held up, and orders waited for too long or were too many"


def lose_orders(site: Plant) -> None:
    """More changes of the control word than the engine keeps come before Python reads the first."""
    port, consumer, provider = site.port, site.link._consumer, site.plc.provider
    assert isinstance(port, NativeEthernet)
    assert consumer is not None
    assert provider is not None
    port.held_up = True
    counter, frame = consumer.counter or 0, bytes(provider.frame[:12] + provider.frame[16:])
    for number in range(1, 40):
        word = ON ^ (number & 1) << 11
        port.arrive(None, frame[:16] + word.to_bytes(2, "big") + changed(frame, [], counter + number, 0x35, 0)[18:])
    port.held_up = False
    port.wake()


def test_orders_that_were_lost_stop_the_drive_as_a_lost_plc_does(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json", transport="watchdog_factor = 100"), native=True) as site:
        model = drive_of(site.daemon).model
        site.connect()
        site.enable(1, SPEED)
        lose_orders(site)
        site.run(300 * MS)
        assert _ORDERS_LOST in caplog.text
        assert model.state.name != "OPERATION_ENABLED"


def test_orders_that_were_lost_while_the_plc_is_lost_are_no_second_loss(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json"), data_hold=400, native=True) as site:
        site.connect()
        site.enable(1, SPEED)
        site.killed = True
        site.run(100 * MS)
        assert site.link.watchdog_expiries == 1
        lose_orders(site)
        site.run(CYCLE)
        assert site.link.setpoints[0] is not None, "the newest frame counts"
        assert site.link.watchdog_expiries == 1
        assert _ORDERS_LOST not in caplog.text


@pytest.mark.parametrize(("waited_ms", "starts"), [(12, True), (13, False)])
def test_orders_that_waited_for_longer_than_the_watchdog_time_are_a_loss_of_the_plc(
    waited_ms: int, starts: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json"), data_hold=400, native=True) as site:
        model = drive_of(site.daemon).model
        site.connect()
        site.enable(1, SPEED)
        port = site.port
        assert isinstance(port, NativeEthernet)
        site.set(1, OFF, SPEED)
        site.run(500 * MS)
        assert site.plc.provider is not None
        assert site.link._consumer is not None
        frame = bytes(site.plc.provider.frame[:12] + site.plc.provider.frame[16:])
        now, counter = site.loop.now(), site.link._consumer.counter or 0
        for number, came in enumerate((now - waited_ms * MS, now), 1):
            tail = changed(frame, [], counter + number, STATUS_NORMAL, 0)[18:]
            port.given.offer(frame[:16] + ON.to_bytes(2, "big") + tail, came)
        port.wake()
        site.set(1, ON, SPEED)
        site.run(300 * MS)
        assert (model.state.name == "OPERATION_ENABLED") == starts
        assert ("PLC lost: the gateway was held up" in caplog.text) != starts
        assert site.link.connected


def words_of_steps(folder: Path, seed: int, *, native: bool) -> list[int | None]:
    """The control words that the steps of an axis get, None without a PLC, for random frames; some wait until Python runs."""
    draw = random.Random(seed)
    seen: list[int | None] = [ON]
    folder.mkdir()
    with plant(configuration(axis(1), folder / "store.json"), data_hold=400, native=native) as site:
        port, item = site.port, site.daemon.axes[0]
        site.connect()
        site.enable(1, SPEED)
        site.killed = True
        consumer, provider, step = site.link._consumer, site.plc.provider, item.step
        assert consumer is not None
        assert provider is not None

        def seen_step(setpoints: Sequence[int] | None, now: int) -> Outputs:
            word = None if setpoints is None else setpoints[0]
            if word != seen[-1]:
                seen.append(word)
            return step(setpoints, now)

        item.step = seen_step  # type: ignore[method-assign]
        frame = bytes(provider.frame[:12] + provider.frame[16:])
        place = consumer.place(AXIS)
        assert place is not None
        counter = consumer.counter or 0
        for _ in range(12):
            for _ in range(draw.choice([1, 1, 8])):
                counter += draw.choice([128] * 20 + [0, -128, 61_440])
                word, status = (
                    draw.choice([ON] * 8 + [OFF, 0x047D, 0x046F]),
                    draw.choice([0x35] * 9 + [0x25, 0x34, 0xB5]),
                )
                iops = draw.choice([IOPS_GOOD] * 9 + [IOPS_BAD])
                data = [(14 + place[0], word >> 8), (15 + place[0], word & 0xFF), (14 + place[1], iops)]
                sent = changed(frame, data, counter, status, 0)
                if isinstance(port, NativeEthernet):
                    port.held_up = True
                    port.arrive(None, sent)
                else:
                    port.real_time.append(sent)
            if isinstance(port, NativeEthernet):
                port.held_up = False
                port.wake()
            while port.real_time:
                port.on_real_time()
            site.run(draw.choice([CYCLE] * 8 + [5 * CYCLE]))
        item.step = step  # type: ignore[method-assign]
    return seen


@pytest.mark.parametrize("seed", [1, 2, 9, 29])
def test_steps_of_the_axes_get_the_same_orders_with_and_without_the_engine(tmp_path: Path, seed: int) -> None:
    pure, engine = (words_of_steps(tmp_path / str(how), seed, native=how) for how in (False, True))
    assert engine == pure


def test_order_behind_a_jump_of_the_counter_is_a_step(tmp_path: Path) -> None:
    """Python was held up, and did not get the frame before which the counter made its longest step."""
    with plant(configuration(axis(1), tmp_path / "store.json"), data_hold=400, native=True) as site:
        site.connect()
        site.enable(1, SPEED)
        site.run(100 * MS)
        port, consumer, provider = site.port, site.link._consumer, site.plc.provider
        assert isinstance(port, NativeEthernet)
        assert consumer is not None
        assert provider is not None
        frame = bytes(provider.frame[:12] + provider.frame[16:])
        begun = consumer.counter or 0
        port.held_up = True
        for word, counter in ((ON, begun + 61_440), (0x047D, begun + 61_568), (ON, begun + (1 << 16) + 1)):
            port.arrive(None, changed(frame, [(16, word >> 8), (17, word & 0xFF)], counter, STATUS_NORMAL, 0))
        port.held_up = False
        port.wake()
        site.run(CYCLE // 2)
        assert drive_of(site.daemon).model.state.name == "SWITCH_ON_DISABLED"


def test_what_the_engine_counted_is_counted_by_the_device(tmp_path: Path) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json"), data_hold=400, native=True) as site:
        site.connect()
        site.run(200 * MS)
        cyclic, octets = site.link.device.cm.cyclic, site.link.device.cm.records.octets
        before = cyclic.sent, cyclic.received[Verdict.ACCEPTED], *octets
        site.run(400 * MS)
        after = cyclic.sent, cyclic.received[Verdict.ACCEPTED], *octets
        sent, received, came, went = (new - old for new, old in zip(after, before, strict=True))
        assert 98 <= min(sent, received) <= max(sent, received) <= 102
        assert (came, went) == (64 * received, 64 * sent)
        assert site.link.invalid == 0


def test_a_stall_is_logged_and_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json"), data_hold=400, native=True) as site:
        port = site.port
        assert isinstance(port, NativeEthernet)
        port.changes["bound_ns"] = 3 * CYCLE // 8  # input frames are half a cycle after the last step: too old
        site.connect()
        site.run(200 * MS)
        assert site.link.invalid > 0
        assert caplog.text.count("the gateway was held up: ") == 1
        assert site.word() == -1, "the controller sees it"


@pytest.mark.parametrize("wanted", [True, False])
def test_the_engine_is_used_only_where_it_is_wanted(
    wanted: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    from pdgw.gateway.links.profinet.ethernet import RawEthernet  # noqa: PLC0415

    port = RawEthernet.__new__(RawEthernet)
    port._use_engine = wanted
    monkeypatch.setattr(native, "make", lambda table: None)
    assert port.engine({}) is None
    assert ("this installation has no native engine" in caplog.text) == wanted
