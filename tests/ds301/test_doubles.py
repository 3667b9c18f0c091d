"""Suspicion and proof of two devices with one node-ID, and what one healthy device does that looks alike."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.node.doubles import Doubles, Jumps, SecondTpdos
from pdgw.ds301.node.heartbeat import OFTEN, Heartbeat
from pdgw.ds301.objects import CanType, Entry
from pdgw.ds301.pdo import Pdo, PdoDirection
from pdgw.peers.world import World

READ, WRITE, ABORTED, SEGMENT = 0x40, 0x2B, 0x80, 0x60
VALUE, WRITTEN = 0x4B, 0x60
PERIOD = 100 * MS
OPERATIONAL = b"\x05"


def frame(command: int, index: int) -> bytes:
    return bytes((command, *index.to_bytes(2, "little"), 0, 1, 2, 3, 4))


def test_second_answers_of_two_devices_are_found_within_a_few_requests() -> None:
    answers = Doubles()
    for index in range(0x1000, 0x1004):
        answers.requested(frame(READ, index))
        answers.answered(frame(VALUE, index))
        answers.answered(frame(VALUE, index))
    assert answers.proof
    answers.begin()
    assert not answers.proof


def test_second_answers_that_arrive_after_the_next_request_are_found() -> None:
    answers = Doubles()
    for _ in range(5):  # of one object
        answers.requested(frame(WRITE, 0x1017))
        answers.answered(frame(WRITTEN, 0x1017))
        answers.requested(frame(WRITE, 0x1017))
        answers.answered(frame(WRITTEN, 0x1017))
        answers.answered(frame(WRITTEN, 0x1017))
    assert answers.proof


@given(
    st.lists(st.tuples(st.integers(0x1000, 0x1003), st.integers(1, 3), st.integers(0, 3), st.booleans()), max_size=60)
)
def test_repeated_requests_and_lost_or_late_answers_are_not_second_answers(
    requests: list[tuple[int, int, int, bool]],
) -> None:
    """Each request is sent up to three times; some of its answers are lost, others arrive after the next requests."""
    answers, late = Doubles(), list[bytes]()
    for index, sent, lost, is_late in requests:
        for _ in range(sent):
            answers.requested(frame(READ, index))
        here = [frame(VALUE, index)] * max(0, sent - lost)
        if is_late:
            late += here
            continue
        for answer in here:
            answers.answered(answer)
        while late:
            answers.answered(late.pop(0))
        assert not answers.proof


def test_answers_to_another_client_are_not_second_answers() -> None:
    answers = Doubles()
    for _ in range(20):
        answers.requested(frame(READ, 0x6041))
        answers.requested(frame(READ, 0x6041))  # another tool
        answers.answered(frame(VALUE, 0x6041))
        answers.answered(frame(VALUE, 0x6041))
    for _ in range(20):
        answers.answered(frame(VALUE, 0x6064))  # to requests before the start of the gateway
    assert not answers.proof


def test_a_frame_that_is_sometimes_received_twice_is_not_a_second_answer() -> None:
    answers = Doubles()
    for count in range(300):
        answers.requested(frame(READ, 0x6041))
        for _ in range(2 if count % 5 == 0 else 1):
            answers.answered(frame(VALUE, 0x6041))
        assert not answers.proof


def test_aborts_and_segments_are_not_second_answers() -> None:
    answers = Doubles()
    for _ in range(20):
        answers.requested(frame(READ, 0x1008))
        answers.answered(frame(0x41, 0x1008))
        answers.requested(frame(SEGMENT, 0x1008))
        answers.answered(frame(0x00, 0x1008))
        answers.answered(frame(ABORTED, 0x1008))
        answers.requested(b"")
        answers.answered(b"")
    assert not answers.proof


def test_requests_that_look_like_data_of_a_block_transfer_need_limited_memory() -> None:
    answers = Doubles()
    for number in range(20_000):
        answers.requested(bytes((READ, *number.to_bytes(3, "little"), 0, 0, 0, 0)))
    assert len(answers._open) < 5000


# -- TPDOs on SYNC ------------------------------------------------------------------------------------------------------


def second_tpdos() -> tuple[SecondTpdos, Doubles]:
    doubles = Doubles()
    return SecondTpdos(doubles, "TPDO1"), doubles


def test_second_tpdos_are_counted_against_the_sync() -> None:
    (one, healthy), (two, doubles) = second_tpdos(), second_tpdos()
    for sync in range(200):
        if sync % 7:  # some frames are lost
            one.see(sync)
        two.see(sync)
        two.see(sync)
        assert doubles.early == sync + 1
        assert (doubles.proof == "TPDO1 more often than SYNC") == (sync >= 4)
    assert (healthy.early, healthy.proof) == (0, "")


@given(delays=st.lists(st.integers(0, 20), min_size=3, max_size=100))
def test_tpdos_that_wait_for_the_bus_are_of_one_device(delays: list[int]) -> None:
    """Frames keep their order. A pause of the gateway, or a bus-off, delays many of them."""
    (second, doubles), arrival = second_tpdos(), 0
    second.see(0)
    for count, delay in enumerate(delays, 1):
        arrival = max(arrival, count + delay)
        second.see(arrival)
    assert doubles.early == 0


def test_a_tpdo_that_is_sometimes_received_twice_is_only_a_doubles() -> None:
    second, doubles = second_tpdos()
    for sync in range(5000):
        second.see(sync)
        if sync % 30 == 0:
            second.see(sync)
    assert (doubles.early, doubles.proof) == (167, "")


# -- heartbeats -------------------------------------------------------------------------------------------------------


def heartbeat(expected: bool = True) -> tuple[Heartbeat, Doubles]:
    doubles = Doubles()
    world = World()
    made = Heartbeat(CanNetwork(world.loop, lambda: world.bus("bus").join("gateway")), 1, doubles)
    made.expected = expected
    made.begin(PERIOD // MS)
    return made, doubles


@pytest.mark.parametrize("phase", [0.01, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("ratio", [1, 5, 10])
def test_heartbeats_of_two_devices_are_early(phase: float, ratio: int) -> None:
    made, doubles = heartbeat()
    other = [int(PERIOD * (phase + ratio * count)) for count in range(60 // ratio)]
    for time in sorted([PERIOD * (count + 1) for count in range(60)] + [PERIOD + time for time in other]):
        made.receive(OPERATIONAL, time)
    assert doubles.early >= len(other) - 1


@pytest.mark.parametrize("clock", [0.9, 0.95, 0.999, 1.1])
@pytest.mark.parametrize("jitter", [0.0, 0.25])
def test_heartbeats_of_a_fast_clock_are_not_early(clock: float, jitter: float) -> None:
    made, doubles = heartbeat()
    chance = random.Random(1)
    for count in range(1, 20_000):
        made.receive(OPERATIONAL, int(PERIOD * (clock * count + chance.random() * jitter)))
    assert doubles.early == 0


def test_the_first_heartbeat_after_a_start_is_not_early() -> None:
    """The node has another period, and reports the change of its state at once."""
    made, doubles = heartbeat()
    for start in range(1, 5):
        made.receive(OPERATIONAL, start * SECOND)
        made.begin(PERIOD // MS)
        made.receive(OPERATIONAL, start * SECOND + 20 * MS)
        made.receive(OPERATIONAL, start * SECOND + 20 * MS + PERIOD)
    assert doubles.early == 0


def test_heartbeat_that_the_gateway_does_not_expect_is_never_early() -> None:
    made, doubles = heartbeat(expected=False)
    for count in range(1, 100):
        made.receive(OPERATIONAL, count * MS)
    assert doubles.early == 0


def test_heartbeats_in_a_row_that_are_early_are_a_shorter_period() -> None:
    """Reported once after each start; a burst is not."""
    made, _ = heartbeat()
    now, reported = PERIOD, []
    for gap_ms in [*[100, 1, 1, 1] * 20, *[20, 21] * 50, *[100] * 20, *[40] * 30]:
        now += gap_ms * MS
        made.receive(OPERATIONAL, now)
        if made.in_row == OFTEN:
            reported.append(made.gap // MS)
    made.begin(PERIOD // MS)
    assert (reported, made.in_row) == ([20], 0)


A, B, BOOT = 5, 127, 0


@pytest.mark.parametrize(
    ("reports", "two"),
    [
        ([A, B, A, B], True),
        ([A, A, B, A, A, B], True),
        ([A, B, A], False),
        ([A, B, 4, A, B], False),
        ([A, B, BOOT, A, B], False),
        ([A, B, None, A, B], False),
        ([A, B, BOOT, A, B, A, B], True),
    ],
    ids=str,
)
def test_alternating_states_without_a_reason_prove_two_devices(reports: list[int | None], two: bool) -> None:
    """None: an NMT command."""
    made, doubles = heartbeat(expected=False)
    for number, state in enumerate(reports, 1):
        if state is None:
            made.commanded()
        else:
            made.receive(bytes((state,)), number * PERIOD)
    assert (doubles.proof != "") == two


# -- positions --------------------------------------------------------------------------------------------------------

TURN = 1000
PDO = Pdo(
    PdoDirection.TPDO,
    1,
    (Entry(0x6041, 0, "", CanType.U16, attribute="a"), Entry(0x6064, 0, "", CanType.I32, attribute="b")),
)


def jumps(positions: Iterable[int]) -> bool:
    """Whether positions each 20 ms are of two devices. The questions began a second before."""
    doubles = Doubles()
    doubles.early += 1
    assert doubles.begins(9 * SECOND)
    made, now = Jumps(doubles, PDO, "b", TURN), 10 * SECOND
    for position in positions:
        now += 20 * MS
        made.see(b"\0\0" + position.to_bytes(4, "little", signed=True), now)
    return doubles.proof == "TPDO1 shows two positions"


@pytest.mark.parametrize("speed", [-300, -30, 0, 30, 300])
@pytest.mark.parametrize("distance", [500, 5250, -350])
def test_positions_of_two_devices_jump_there_and_back(speed: int, distance: int) -> None:
    assert jumps(speed // 10 * count + distance * (count % 2) for count in range(20))


@pytest.mark.parametrize(
    "positions",
    [
        [count % 2 * 20 for count in range(100)],
        [count % 2 * (10 * TURN - 1) for count in range(100)],
        *([speed * count for count in range(100)] for speed in (3, 200, 500, 501, 1300)),
        [speed * count % (10 * TURN) for speed in (200, 500) for count in range(100)],
        [0, 500] * 2 + list(range(500, 600)),
    ],
    ids=["noise", "noise at the wrap", "slow", "fast", "half a turn", "more", "very fast", "wraps", "two jumps"],
)
def test_positions_of_one_device_do_not_jump_there_and_back(positions: list[int]) -> None:
    assert not jumps(positions)


def test_positions_of_two_devices_count_only_after_the_questions() -> None:
    doubles = Doubles()
    doubles.early += 1
    assert doubles.begins(9 * SECOND)
    made = Jumps(doubles, PDO, "b", TURN)
    for count in range(200):
        made.see(bytes((0, 0, 0, count % 2, 0, 0)), 9 * SECOND + count * 20 * MS)
        assert (doubles.proof != "") == (count >= 50)
        if 50 <= count < 99:
            doubles.proof = ""


# -- the examination --------------------------------------------------------------------------------------------------


def test_early_frames_are_examined_with_questions_and_later_ones_again() -> None:
    doubles = Doubles()
    assert not doubles.begins(5 * SECOND)
    doubles.early += 1
    assert doubles.begins(5 * SECOND)
    assert doubles.questions == 8
    doubles.early += 1
    assert not doubles.begins(7 * SECOND - 1)
    assert doubles.begins(7 * SECOND)
    assert not doubles.begins(20 * SECOND), "all early frames were examined"
    doubles.early += 1
    doubles.begin()
    assert (doubles.begins(30 * SECOND), doubles.questions) == (False, 0), "ended with the next bring-up"
