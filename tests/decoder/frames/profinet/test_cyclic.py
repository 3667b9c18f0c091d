"""Cyclic frames: which telegrams are inferred or observed, and that the decoder reads what the frame codec wrote."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import (
    FRAME_ID_TO_CONTROLLER,
    FRAME_ID_TO_DEVICE,
    IOPS_BAD,
    IOPS_GOOD,
    STATUS_NORMAL,
    STATUS_STOP,
    TRAILER,
    CSduLayout,
)
from pdgw.profidrive.telegrams import TELEGRAMS, Direction, Telegram, telegram
from pdgw.tools.decoder.frames.profinet.cyclic import CyclicDecoder
from pdgw.tools.decoder.frames.profinet.frame_telegrams import Axis, given_axes, infer
from pdgw.tools.decoder.frames.records import CyclicRecord, OtherRecord
from tests.support.axis.strategies import axes_values

Values = list[tuple[int, ...]]
FRAME_IDS = {Direction.SETPOINT: FRAME_ID_TO_DEVICE, Direction.ACTUAL: FRAME_ID_TO_CONTROLLER}


def frame(
    telegrams: list[Telegram],
    direction: Direction,
    values: Values,
    *,
    counter: int = 0,
    status: int = STATUS_NORMAL,
    iops: int = IOPS_GOOD,
) -> bytes:
    layout = CSduLayout(telegrams, direction)
    data = layout.new_frame(FRAME_IDS[direction])
    for half, offset, iops_at, iocs_at, axis in zip(
        layout.halves, layout.offsets, layout.iops, layout.iocs, values, strict=True
    ):
        half.encode_into(data, offset, axis)
        data[iops_at] = iops
        data[iocs_at] = IOPS_GOOD
    TRAILER.pack_into(data, layout.trailer, counter, status, 0)
    return bytes(data)


def zeros(numbers: list[int], direction: Direction) -> bytes:
    telegrams = [telegram(number) for number in numbers]
    return frame(telegrams, direction, [(0,) * len(t.half(direction).signals) for t in telegrams])


def decoder(axes: tuple[Axis, ...] = ()) -> tuple[CyclicDecoder, list[str]]:
    notices: list[str] = []
    return CyclicDecoder(axes, notices.append), notices


def decode(cyclic: CyclicDecoder, data: bytes) -> CyclicRecord:
    record = cyclic.decode(1, 0, "", data)
    assert isinstance(record, CyclicRecord)
    return record


@given(
    drawn=st.one_of(st.tuples(st.just(direction), axes_values(direction)) for direction in Direction),
    counter=st.integers(0, 0xFFFF),
)
def test_given_telegrams_every_value_comes_back(
    drawn: tuple[Direction, tuple[list[Telegram], Values]], counter: int
) -> None:
    direction, (telegrams, values) = drawn
    data = frame(telegrams, direction, values, counter=counter)
    cyclic, _ = decoder(tuple(Axis(i, t.number, 10 + i) for i, t in enumerate(telegrams, 1)))
    record = decode(cyclic, data)
    assert (record.frame_id, record.cycle_counter, record.data_status) == (FRAME_IDS[direction], counter, STATUS_NORMAL)
    assert [unit.values for unit in record.units] == values
    assert [(unit.axis, unit.node) for unit in record.units] == [(i, 10 + i) for i in range(1, len(telegrams) + 1)]
    assert {unit.iops for unit in record.units} == {unit.iocs for unit in record.units} == {IOPS_GOOD}
    for chosen, unit in zip(telegrams, record.units, strict=True):
        assert [item.name for item, _ in unit.items()] == list(chosen.half(direction).names)


@given(drawn=st.lists(st.sampled_from(sorted(TELEGRAMS)), min_size=1, max_size=4), direction=st.sampled_from(Direction))
def test_the_right_telegrams_are_among_the_inferred(drawn: list[int], direction: Direction) -> None:
    found = infer(zeros(drawn, direction)[2:-4], direction)
    assert any(
        len(parts) == len(drawn) and all(number in part for number, part in zip(drawn, parts, strict=True))
        for parts in found
    )


@pytest.mark.parametrize(
    ("numbers", "inferred"),
    [([1], [1]), ([2], [2]), ([3], [3]), ([9], [9]), ([20], [20]), ([82], [82]), ([84], [84]), ([100], [100])],
)
def test_both_directions_together_identify_a_telegram(numbers: list[int], inferred: list[int]) -> None:
    cyclic, notices = decoder()
    decode(cyclic, zeros(numbers, Direction.SETPOINT))
    record = decode(cyclic, zeros(numbers, Direction.ACTUAL))
    assert [axis.telegram for axis in cyclic.axes] == inferred
    assert [unit.layout.telegram for unit in record.units] == inferred
    assert "inferred" in notices[0]


def test_wrong_telegram_is_reported_after_frames_without_good_status() -> None:
    cyclic, notices = decoder((Axis(1, 9),))
    chosen = telegram(111)
    values = [(0,) * len(chosen.actuals.signals)]
    beginning = bytearray(frame([chosen], Direction.ACTUAL, values, iops=IOPS_BAD))
    beginning[CSduLayout([chosen], Direction.ACTUAL).iocs[0]] = IOPS_BAD
    for _ in range(20):
        decode(cyclic, bytes(beginning))
    assert not notices
    decode(cyclic, frame([chosen], Direction.ACTUAL, values))
    assert notices == [
        "the actual values do not fit the given telegram 9: their length is the length of telegram 111/112"
    ]


@pytest.mark.parametrize("offline", [0, 1])
def test_given_telegrams_are_not_questioned_while_an_axis_is_offline(offline: int) -> None:
    """An IOPS BAD in the place of a status byte makes other telegrams fit: 1 and 9 with axis 1 offline."""
    numbers = [1, 9]
    cyclic, notices = decoder(given_axes(numbers))
    data = bytearray(zeros(numbers, Direction.ACTUAL))
    data[CSduLayout([telegram(n) for n in numbers], Direction.ACTUAL).iops[offline]] = IOPS_BAD
    for _ in range(50):
        record = decode(cyclic, bytes(data))
    assert [unit.layout.telegram for unit in record.units] == numbers
    assert not notices


def test_several_axes_are_distinguished() -> None:
    cyclic, _ = decoder()
    decode(cyclic, zeros([1, 9, 100], Direction.SETPOINT))
    record = decode(cyclic, zeros([1, 9, 100], Direction.ACTUAL))
    assert [unit.layout.telegram for unit in record.units] == [1, 9, 100]


def test_a_frame_without_good_status_waits_for_a_better_one() -> None:
    cyclic, notices = decoder()
    stopped = frame([telegram(9)], Direction.SETPOINT, [(0,) * 8], status=STATUS_STOP)
    bad = frame([telegram(9)], Direction.SETPOINT, [(0,) * 8], iops=IOPS_BAD)
    for data in (stopped, bad):
        record = decode(cyclic, data)
        assert record.units == ()
        assert "telegram unknown" in record.summary
    assert not notices
    assert decode(cyclic, zeros([9], Direction.SETPOINT)).units[0].layout.telegram == 9
    assert decode(cyclic, stopped).units[0].layout.telegram == 9


def test_a_long_time_without_good_status_does_not_end_the_search() -> None:
    cyclic, _ = decoder()
    bad = frame([telegram(9)], Direction.SETPOINT, [(0,) * 8], iops=IOPS_BAD)
    assert not any(decode(cyclic, bad).units for _ in range(2000))
    good = zeros([9], Direction.SETPOINT)
    assert any(decode(cyclic, good).units for _ in range(100))
    assert decode(cyclic, good).units[0].layout.telegram == 9


def test_p922_decides_against_length_and_option() -> None:
    for axes in ((), given_axes([1])):
        cyclic, notices = decoder(axes)
        assert decode(cyclic, zeros([7], Direction.SETPOINT)).units[0].layout.telegram == 1
        cyclic.observe(1, 7)
        assert decode(cyclic, zeros([7], Direction.SETPOINT)).units[0].layout.telegram == 7
        assert notices[-1] == "axis 1: telegram 7, observed in P922"
        cyclic.observe(1, 555)
        assert decode(cyclic, zeros([7], Direction.SETPOINT)).units[0].layout.telegram == 7
        assert "555 is an unknown telegram" in notices[-1]


def test_telegram_that_does_not_fit_is_reported() -> None:
    cyclic, _ = decoder(given_axes([100, 100]))
    record = decode(cyclic, zeros([1], Direction.SETPOINT))
    assert record.units == ()
    assert record.summary.endswith("(too short for telegram 100, 100)")


def test_an_unknown_telegram_is_refused_at_once() -> None:
    with pytest.raises(ProfidriveError, match="telegram: 8"):
        given_axes([8])


@given(data=st.binary(max_size=120))
def test_any_bytes_are_a_record(data: bytes) -> None:
    cyclic, _ = decoder(given_axes([1, 9]))
    record = cyclic.decode(1, 0, "", data)
    assert isinstance(record, CyclicRecord | OtherRecord)
    assert record.document()
