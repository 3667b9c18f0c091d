"""The benchmarks run and measure what they say; their figures belong to ``pdgw bench``, not to a test."""

from __future__ import annotations

import pytest
from pdgw.profidrive.frame import RtFrame
from pdgw.tools.bench import roundtrip, storm
from pdgw.tools.bench.measure import latency
from pdgw.tools.bench.translation import axis_cycle


@pytest.mark.parametrize(("number", "enabled"), [(1, 0x07), (9, 0x07), (100, 0x27)])
def test_the_measured_axis_cycle_is_one_in_operation(number: int, enabled: int) -> None:
    cycle = axis_cycle(number)
    frames = [RtFrame.decode(bytes(cycle())) for _ in range(20)]  # type: ignore[call-overload]
    word = int.from_bytes(frames[-1].c_sdu[:2], "big")
    assert word & enabled == enabled
    assert len({frame.c_sdu for frame in frames}) > 8, "the values change from cycle to cycle"


def test_percentiles() -> None:
    result = latency([n * 1000 for n in range(1, 1001)], 2)
    assert (result.p50, result.p99, result.samples, result.lost) == (501, 991, 1000, 2)


def test_a_short_comparison_with_the_echo() -> None:
    trip = roundtrip.run(axes=4, cycles=50)
    assert trip.echo.samples == trip.gateway.samples == 50
    assert trip.gateway.lost == 0
    assert trip.can_frames_per_s > 0


def test_a_short_storm_of_parameter_requests_loses_no_cycle() -> None:
    result = storm.run(cycles=80)
    assert result.quiet.samples == result.storm.samples == 80
    assert (result.quiet.lost, result.storm.lost) == (0, 0)
    assert result.requests_per_s > 0
