"""The sign of life in both directions."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import MONITORING_OFF, SignOfLife


def test_the_own_counter_runs_1_to_15_without_0() -> None:
    life = SignOfLife(0)
    received = [(start + 7) % 15 + 1 for start in range(40)]
    assert [life.step(counter) for counter in received] == [cycle % 15 + 1 for cycle in range(40)]
    assert not life.failed


def test_controller_without_sign_of_life_is_neither_monitored_nor_answered() -> None:
    life = SignOfLife(0)
    assert [life.step(0) for _ in range(20)] == [0] * 20
    assert not life.failed


@pytest.mark.parametrize("tolerated", [0, 1, 5, 14, 15, 16, 100])
@pytest.mark.parametrize("stuck", [0, 3])
def test_more_failures_than_tolerated_are_an_error(tolerated: int, stuck: int) -> None:
    life = SignOfLife(tolerated)
    life.step(3)
    for _ in range(tolerated):
        life.step(stuck)
        assert not life.failed
    assert life.step(stuck) == 0
    assert life.failed


def test_65535_switches_the_monitoring_off() -> None:
    life = SignOfLife(MONITORING_OFF)
    life.step(3)
    assert [life.step(3) for _ in range(16)] == [cycle % 15 + 1 for cycle in range(1, 17)]
    assert not life.failed


def test_a_lost_frame_is_one_failure() -> None:
    life = SignOfLife(1)
    for counter in (4, 4, 6, 7, 7, 9):
        life.step(counter)
        assert not life.failed
    assert life.failures == 0


def test_lost_controller_returns_after_15_correct_counters() -> None:
    life = SignOfLife(0)
    for counter in (4, 5, 11):
        life.step(counter)
    assert [life.step(counter) for counter in (12, 13, 14, 15, *range(1, 12))] == [0] * 14 + [1]
    assert not life.failed


@pytest.mark.parametrize("tolerated", [0, 3])
def test_controller_that_counts_too_slowly_is_lost_once(tolerated: int) -> None:
    life, losses, failed = SignOfLife(tolerated), 0, False
    for frame in range(1000):
        life.step(frame // 8 % 15 + 1)
        losses += life.failed and not failed
        failed = life.failed
    assert failed
    assert losses == 1


@given(st.lists(st.integers(0, 15)), st.integers(0, 20))
def test_no_failure_while_the_last_counter_is_correct(counters: list[int], tolerated: int) -> None:
    life = SignOfLife(tolerated)
    for counter in counters:
        own = life.step(counter)
        assert 0 <= own <= 15
        assert life.failed == (life.failures > tolerated)


@pytest.mark.parametrize("tolerated", [-1, 65536])
def test_p925_is_a_word(tolerated: int) -> None:
    with pytest.raises(ProfidriveError, match="P925"):
        SignOfLife(tolerated)


@pytest.mark.parametrize("counter", [-1, 16])
def test_a_counter_has_four_bits(counter: int) -> None:
    with pytest.raises(ProfidriveError, match="sign of life"):
        SignOfLife(0).step(counter)
