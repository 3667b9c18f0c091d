"""Signs of two devices with one node-ID, and what one healthy device does that looks alike."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.ds301.node.doubles import FrameRate, SecondAnswers
from pdgw.durations import MS

READ, WRITE, ABORTED, SEGMENT = 0x40, 0x2B, 0x80, 0x60
VALUE, WRITTEN = 0x4B, 0x60
PERIOD = 100 * MS


def frame(command: int, index: int) -> bytes:
    return bytes((command, *index.to_bytes(2, "little"), 0, 1, 2, 3, 4))


def test_second_answers_of_two_devices_are_found_within_a_few_requests() -> None:
    answers = SecondAnswers()
    for index in range(0x1000, 0x1004):
        answers.requested(frame(READ, index))
        answers.answered(frame(VALUE, index))
        answers.answered(frame(VALUE, index))
    assert answers.found
    answers.begin()
    assert not answers.found


def test_second_answers_that_arrive_after_the_next_request_are_found() -> None:
    answers = SecondAnswers()
    for _ in range(5):  # of one object
        answers.requested(frame(WRITE, 0x1017))
        answers.answered(frame(WRITTEN, 0x1017))
        answers.requested(frame(WRITE, 0x1017))
        answers.answered(frame(WRITTEN, 0x1017))
        answers.answered(frame(WRITTEN, 0x1017))
    assert answers.found


@given(
    st.lists(st.tuples(st.integers(0x1000, 0x1003), st.integers(1, 3), st.integers(0, 3), st.booleans()), max_size=60)
)
def test_repeated_requests_and_lost_or_late_answers_are_not_second_answers(
    requests: list[tuple[int, int, int, bool]],
) -> None:
    """Each request is sent up to three times; some of its answers are lost, others arrive after the next requests."""
    answers, late = SecondAnswers(), list[bytes]()
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
        assert not answers.found


def test_answers_to_another_client_are_not_second_answers() -> None:
    answers = SecondAnswers()
    for _ in range(20):
        answers.requested(frame(READ, 0x6041))
        answers.requested(frame(READ, 0x6041))  # another tool
        answers.answered(frame(VALUE, 0x6041))
        answers.answered(frame(VALUE, 0x6041))
    for _ in range(20):
        answers.answered(frame(VALUE, 0x6064))  # to requests before the start of the gateway
    assert not answers.found


def test_a_frame_that_is_sometimes_received_twice_is_not_a_second_answer() -> None:
    answers = SecondAnswers()
    for count in range(300):
        answers.requested(frame(READ, 0x6041))
        for _ in range(2 if count % 5 == 0 else 1):
            answers.answered(frame(VALUE, 0x6041))
        assert not answers.found


def test_aborts_and_segments_are_not_second_answers() -> None:
    answers = SecondAnswers()
    for _ in range(20):
        answers.requested(frame(READ, 0x1008))
        answers.answered(frame(0x41, 0x1008))
        answers.requested(frame(SEGMENT, 0x1008))
        answers.answered(frame(0x00, 0x1008))
        answers.answered(frame(ABORTED, 0x1008))
        answers.requested(b"")
        answers.answered(b"")
    assert not answers.found


def test_requests_that_look_like_data_of_a_block_transfer_need_limited_memory() -> None:
    answers = SecondAnswers()
    for number in range(20_000):
        answers.requested(bytes((READ, *number.to_bytes(3, "little"), 0, 0, 0, 0)))
    assert len(answers._open) < 5000


@pytest.mark.parametrize("phase", [0.01, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("ratio", [1, 5, 10])
def test_heartbeats_of_two_devices_are_found(phase: float, ratio: int) -> None:
    rate = FrameRate(PERIOD)
    other = [int(PERIOD * (phase + ratio * count)) for count in range(60 // ratio)]
    times = sorted([PERIOD * count for count in range(60)] + other)
    for time in times:
        rate.see(time)
    assert rate.found


@given(
    delays=st.lists(st.floats(0, 20), min_size=3, max_size=100),
    clock=st.floats(1.0, 1.1),
)
def test_heartbeats_that_wait_for_the_bus_are_of_one_device(delays: list[float], clock: float) -> None:
    """Frames keep their order. A pause of the gateway, or a bus-off, delays many of them."""
    rate, arrival = FrameRate(PERIOD), 0
    rate.see(0)
    for count, delay in enumerate(delays, 1):
        arrival = max(arrival, int(PERIOD * (clock * count + delay)))
        rate.see(arrival)
        assert not rate.found


@pytest.mark.parametrize("clock", [0.9, 0.95, 0.999])
@pytest.mark.parametrize("jitter", [0.0, 0.25])
def test_heartbeats_of_a_fast_clock_are_of_one_device(clock: float, jitter: float) -> None:
    rate, chance = FrameRate(PERIOD), random.Random(1)
    for count in range(20_000):
        rate.see(int(PERIOD * (clock * count + chance.random() * jitter)))
        assert not rate.found


def test_heartbeats_after_a_pause_of_the_gateway_are_of_one_device() -> None:
    rate = FrameRate(PERIOD)
    for second in range(100):
        for count in range(10):
            rate.see(second * 1000 * MS + (9 if second % 3 else count) * PERIOD)
        assert not rate.found


def test_tpdos_are_counted_against_the_sync() -> None:
    one, two = FrameRate(1), FrameRate(1)
    for sync in range(200):
        if sync % 7:  # some frames are lost
            one.see(sync)
        two.see(sync)
        two.see(sync)
    assert not one.found
    assert two.found
