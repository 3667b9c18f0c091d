"""Configurations beyond what the running build was measured for."""

from __future__ import annotations

import pytest

from pdgw.gateway.service.build import COMPILED, PURE, beyond_measured


@pytest.mark.parametrize("build", [PURE, COMPILED])
def test_more_axes_or_a_shorter_cycle_than_measured_are_told(build: str) -> None:
    for axes, cycle_ms in ((1, 1), (8, 1), (4, 4), (32, 8)):
        assert beyond_measured(axes, cycle_ms, build) == ""
    assert beyond_measured(9, 1, build).startswith(f"9 axes at 1 ms: beyond what this build ({build}) was measured for")
    assert beyond_measured(1, 0.1, build).startswith("1 axis at 0.1 ms")
