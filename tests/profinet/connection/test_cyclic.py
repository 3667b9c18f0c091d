"""Which cyclic frames count, when they are lost, and what is sent; the frames are the controller's own, changed by hand."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS
from pdgw.profidrive.frame import STATUS_NO_PROBLEM, STATUS_NORMAL, STATUS_STOP
from pdgw.profinet import ethernet
from pdgw.profinet.blocks.connect_blocks import HOLD_MAX_NS, IocrType
from pdgw.profinet.connection.cpm import STATUS_IGNORE, Consumer, Verdict
from pdgw.profinet.connection.ppm import Provider
from tests.support.wire.connect import Caller, blocks
from tests.support.wire.profinet import DEVICE_MAC, PLC_MAC, Wire, project

AXIS = (1, 2)
SETPOINTS = bytes.fromhex("047f2000")
PLACES = frozenset(project().submodules)


def output_frame(counter: int = 0, status: int = STATUS_NORMAL, transfer: int = 0, iops: int = 0x80) -> bytearray:
    """A frame of the controller."""
    provider = Provider(project().plan(IocrType.OUTPUT, 0x8000), DEVICE_MAC, PLC_MAC, PLACES)
    provider.open()
    provider.set(AXIS, SETPOINTS, good=bool(iops))
    frame = provider.poll(0)
    assert frame is not None
    frame[-4:] = counter.to_bytes(2, "big") + bytes((status, transfer))
    return frame


def consumer() -> Consumer:
    return Consumer(project().plan(IocrType.OUTPUT, 0x8000))


START = 18


def give(item: Consumer, frame: bytes | bytearray, now: int = 0) -> Verdict:
    return item.receive(bytes(frame), START, now)


def test_the_first_counter_may_be_anything_and_then_counters_have_to_advance() -> None:
    for first in (0, 1, 0x7FFF, 0xFFFF):
        item = consumer()
        assert give(item, output_frame(first)) is Verdict.ACCEPTED
        assert give(item, output_frame(first)) is Verdict.STALE
        assert give(item, output_frame((first + 61_440) & 0xFFFF)) is Verdict.ACCEPTED
        assert give(item, output_frame((first + 61_440 + 61_441) & 0xFFFF)) is Verdict.STALE


@pytest.mark.parametrize(
    ("frame", "verdict"),
    [
        (output_frame()[:-1], Verdict.LENGTH),
        (output_frame() + b"\0", Verdict.LENGTH),
        (output_frame(transfer=1), Verdict.TRANSFER_STATUS),
        (output_frame(status=STATUS_NORMAL & ~0x04), Verdict.NOT_VALID),
    ],
)
def test_frames_that_do_not_count_do_not_restart_the_hold_time(frame: bytes, verdict: Verdict) -> None:
    item = consumer()
    assert give(item, frame, 5) is verdict
    assert item.last_ns is None
    assert item.output(AXIS) is None
    assert item.counters[verdict] == 1


def test_before_the_first_frame_nothing_is_received_and_a_submodule_without_data_never_has_any() -> None:
    item = consumer()
    assert (item.running, item.last_ns, item.deadline, item.status) == (False, None, None, (0, 0, 0))
    give(item, output_frame(5))
    assert item.status == (5, STATUS_NORMAL, 0)
    assert item.output((1, 1)) is None
    give(item, output_frame(37, STATUS_STOP))
    assert item.status == (37, STATUS_STOP, 0)


def test_provider_stop_and_bad_data_keep_the_relationship_without_setpoints() -> None:
    item = consumer()
    give(item, output_frame(0))
    assert item.output(AXIS) == SETPOINTS
    assert give(item, output_frame(32, STATUS_STOP), 7) is Verdict.PROVIDER_STOP
    assert (item.output(AXIS), item.last_ns) == (None, 7)
    assert give(item, output_frame(64, iops=0), 9) is Verdict.ACCEPTED
    assert (item.output(AXIS), item.last_ns) == (None, 9)
    assert give(item, output_frame(96), 11) is Verdict.ACCEPTED
    assert item.output(AXIS) == SETPOINTS


@pytest.mark.parametrize("status", [STATUS_NORMAL | STATUS_IGNORE, STATUS_NORMAL & ~0x01])
def test_ignored_and_backup_frames_keep_the_data(status: int) -> None:
    item = consumer()
    give(item, output_frame(0))
    assert give(item, output_frame(32, status), 7) is Verdict.NO_DATA
    assert (item.output(AXIS), item.last_ns) == (SETPOINTS, 7)


def test_frames_with_and_without_a_priority_tag_count() -> None:
    wire = Wire()
    wire.connect()
    wire.plc.set_output(AXIS, SETPOINTS)
    wire.run(20 * MS)
    assert wire.device.output(AXIS) == SETPOINTS
    tagged = bytearray(wire.plc.provider.frame if wire.plc.provider else b"")
    assert tagged[12:14] == b"\x81\x00"
    before = wire.fresh
    wire.to_device = False
    for counter, stripped in ((0x4000, True), (0x5000, False)):
        wire.run(1 * MS)
        frame = bytes(tagged[:-4]) + counter.to_bytes(2, "big") + bytes((STATUS_NORMAL, 0))
        sent = frame[:12] + frame[16:] if stripped else frame
        wire.fresh += wire.device.on_frame(sent, wire.now)
    assert wire.fresh == before + 2


@pytest.mark.parametrize(
    ("position", "value"),
    [(0, 0x04), (6, 0x04), (19, 0x99)],
    ids=["to another station", "from another station", "another FrameID"],
)
def test_frames_of_other_senders_do_not_count(position: int, value: int) -> None:
    wire = Wire()
    wire.connect()
    wire.run(20 * MS)
    assert wire.plc.provider is not None
    frame = bytearray(wire.plc.provider.frame)
    frame[-4:-2] = b"\x40\x00"
    frame[position] = value
    last = wire.consumer.last_ns
    assert wire.device.on_frame(bytes(frame), wire.now + 1) is False
    assert wire.consumer.last_ns == last
    assert wire.device.foreign == 1


@pytest.mark.parametrize(("ratio", "hold"), [(1, 3), (4, 3), (32, 3), (128, 3), (512, 3), (1, 255)])
def test_the_data_hold_time_is_what_was_agreed(ratio: int, hold: int) -> None:
    wire = Wire(of_project=project(reduction_ratio=ratio, data_hold=hold, activity_timeout=1000))
    assert ratio * hold * MS <= HOLD_MAX_NS
    wire.connect()
    wire.run(2 * ratio * MS)
    wire.to_device = False
    wire.run(ratio * hold * MS - wire.silent_ns - 1)
    assert wire.device.connected
    wire.run(1)
    assert not wire.device.connected


def test_axis_learns_of_silence_before_the_data_hold_time() -> None:
    wire = Wire(of_project=project(reduction_ratio=4, data_hold=255))
    wire.connect()
    wire.run(40 * MS)
    wire.to_device = False
    wire.run(100 * MS)
    assert wire.device.connected
    assert 96 * MS <= wire.silent_ns <= 104 * MS


# -- provider ---------------------------------------------------------------------------------------------------------


def provider(ratio: int = 4) -> Provider:
    chosen = project(reduction_ratio=ratio)
    item = Provider(chosen.plan(IocrType.INPUT, 0x8001), PLC_MAC, DEVICE_MAC, PLACES)
    item.start(0)
    return item


def test_frames_keep_the_grid_of_the_cycle_and_late_ones_are_skipped() -> None:
    item = provider(4)
    sent = []
    skipped = 0
    for now in (0, 3_999_999, 4_000_000, 8_500_000, 12_000_000, 29_000_000, 32_000_000):
        frame = item.poll(now)
        if frame is not None:
            sent.append((now, int.from_bytes(frame[-4:-2], "big") // 128))
            skipped += item.skipped
    assert sent == [(4_000_000, 1), (8_500_000, 2), (12_000_000, 3), (29_000_000, 7), (32_000_000, 8)]
    assert skipped == 3


@given(st.integers(1, 16), st.lists(st.integers(0, 40 * MS), max_size=60))
def test_no_cycle_is_sent_twice_and_the_counter_always_advances(ratio: int, steps: list[int]) -> None:
    item = provider(ratio)
    now = cycles = 0
    counters = []
    for step in steps:
        now += step
        frame = item.poll(now)
        if frame is not None:
            counters.append(int.from_bytes(frame[-4:-2], "big"))
            cycles += 1 + item.skipped
            assert now < item.due <= now + item.cycle_ns
    expected = [(b - a) & 0xFFFF for a, b in itertools.pairwise(counters)]
    assert all(step and step % (32 * ratio) == 0 for step in expected)
    assert cycles == now // item.cycle_ns


def test_statuses_are_bad_until_the_application_is_ready() -> None:
    item = provider()
    item.set(AXIS, bytes(4), good=True)
    where = item.place(AXIS)
    assert where is not None
    assert item.frame[where[1]] == 0
    item.open()
    item.set(AXIS, bytes(4), good=True)
    assert item.frame[where[1]] == 0x80
    item.set_status(AXIS, good=False)
    assert item.frame[where[1]] == 0
    item.set_status(AXIS, good=True)
    item.close()
    assert item.frame[where[1]] == 0
    item.set_status(AXIS, good=True)
    assert item.frame[where[1]] == 0
    item.open()
    assert item.frame[where[1]] == 0x80, "what was said to be valid meanwhile is valid"


def test_every_status_of_a_submodule_that_is_as_projected_is_good_from_ready_on_and_no_other() -> None:
    plan = project().plan(IocrType.INPUT, 0x8001)
    wrong = {(1, 1), (2, 2)}
    item = Provider(plan, PLC_MAC, DEVICE_MAC, PLACES - wrong)
    start = 20  # after header, tag and FrameID
    offsets = {place: [data.iops] for place, data in plan.data.items()}
    for place, offset in plan.iocs.items():
        offsets.setdefault(place, []).append(offset)

    def good() -> set[tuple[int, int]]:
        found = {place for place, at in offsets.items() if all(item.frame[start + offset] == 0x80 for offset in at)}
        others = {place for place, at in offsets.items() if not any(item.frame[start + offset] for offset in at)}
        assert found | others == set(offsets), "half of the statuses"
        return found

    with_data = {place for place, data in plan.data.items() if data.length}
    assert good() == set()
    item.open()
    for place in with_data:
        item.set_status(place, good=True)
    assert good() == set(offsets) - wrong
    item.close()
    assert good() == set()
    assert not any(item.frame[start:-4])
    assert item.place((9, 9)) is None
    assert item.place((2, 2)) is None


def test_before_prm_end_every_status_on_the_wire_is_bad() -> None:
    caller = Caller()
    assert not caller.connect(blocks())[0].value
    device = caller.wire.device
    device.set_input(AXIS, bytes(4), good=True)
    frames = []
    for now in range(0, 40 * MS, MS):
        device.poll(now)
        frames += [bytes(data) for address, data in device.outgoing() if address is None]
    cyclic = [frame for frame in frames if frame[18:20] == b"\x80\x01"]
    assert len(cyclic) == 9
    assert not any(any(frame[20:-4]) for frame in cyclic)


def test_present_fault_is_shown_in_the_first_frame() -> None:
    caller = Caller()
    caller.wire.device.set_diagnosis((1, 1), 0x9000)
    assert not caller.connect(blocks())[0].value
    caller.wire.run(4 * MS)
    (first,) = [frame for frame in caller.wire.frames if frame[18:20] == b"\x80\x01"]
    assert first[-2] == STATUS_NORMAL & ~STATUS_NO_PROBLEM


def test_a_fault_diagnosis_shows_in_the_data_status() -> None:
    wire = Wire()
    wire.connect()
    wire.device.set_diagnosis((1, 1), 0x9000)
    wire.run(8 * MS)
    relation = wire.device.relation
    assert relation is not None
    assert relation.provider is not None
    assert relation.provider.frame[-2] == STATUS_NORMAL & ~STATUS_NO_PROBLEM
    wire.device.clear_diagnosis((1, 1))
    wire.run(8 * MS)
    assert relation.provider.frame[-2] == STATUS_NORMAL


def test_the_frames_header_is_that_of_a_priority_six_frame_to_the_controller() -> None:
    frame = provider().frame
    assert frame[:18] == PLC_MAC + DEVICE_MAC + bytes.fromhex("8100c0008892")
    assert ethernet.payload_of(bytes(frame)) == (0x8892, 18)
