"""The bus load planner: bit times of the standard and refusal with numbers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.load import CyclicFrames, bus_load, check_load, frame_bits


def test_an_8_byte_frame_takes_111_to_135_bit_times() -> None:
    assert (frame_bits(8, worst=False), frame_bits(8)) == (111, 135)


@pytest.mark.parametrize(("worst", "rate"), [(True, 7407), (False, 9009)])
def test_frames_per_second_at_1_mbit(worst: bool, rate: int) -> None:
    assert 1_000_000 // frame_bits(8, worst=worst) == rate


@given(size=st.integers(0, 7))
def test_longer_frames_take_longer(size: int) -> None:
    assert frame_bits(size) < frame_bits(size + 1)


def test_a_full_bus_is_refused_with_its_numbers() -> None:
    fits = [CyclicFrames("TPDO1", 8, 7407)]
    assert bus_load(fits, 1_000_000) == pytest.approx(1, abs=0.001)
    assert check_load("can", fits, 1_000_000) <= 1
    with pytest.raises(CanopenError, match=r"bus can.*7500 frames/s at 1000000 bit/s"):
        check_load("can", [CyclicFrames("TPDO1", 8, 7500)], 1_000_000)


@pytest.mark.parametrize("size", [-1, 9])
def test_impossible_frame_length_is_rejected(size: int) -> None:
    with pytest.raises(CanopenError, match=r"0\.\.8"):
        frame_bits(size)


def test_a_bus_without_bitrate_is_refused() -> None:
    with pytest.raises(CanopenError, match="bitrate: 0"):
        bus_load([CyclicFrames("TPDO1", 8, 1)], 0)
