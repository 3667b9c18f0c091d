"""Hypothesis strategies generated from the declarations."""

from __future__ import annotations

from hypothesis import strategies as st

from pdgw.peers.drive.model.latency import LATENCY_MAX_MS, Latency
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import TELEGRAMS, Direction, Telegram, TelegramHalf

telegrams = st.sampled_from([TELEGRAMS[number] for number in sorted(TELEGRAMS)])
_direction = st.just(0) | st.integers(0, LATENCY_MAX_MS)
latencies = st.builds(Latency, command_ms=_direction, status_ms=_direction)
"""Latency of a simulated drive."""
directions = st.sampled_from(list(Direction))


def signal_values(signal: Signal) -> st.SearchStrategy[int]:
    """Every raw value of a signal."""
    low, high = signal.type.integer_range
    return st.integers(low, high)


def half_values(half: TelegramHalf) -> st.SearchStrategy[tuple[int, ...]]:
    """Raw values of one telegram direction, in telegram order."""
    return st.tuples(*(signal_values(signal) for signal in half.signals))


@st.composite
def axes_values(draw: st.DrawFn, direction: Direction) -> tuple[list[Telegram], list[tuple[int, ...]]]:
    """One to four axes with their telegrams and values."""
    chosen = draw(st.lists(telegrams, min_size=1, max_size=4))
    return chosen, [draw(half_values(telegram.half(direction))) for telegram in chosen]
