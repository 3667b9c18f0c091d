"""The position loop closed by a simulated PLC over the gateway: what gain and cycle time do to it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.exchange.position_loop import PositionLoop
from pdgw.workshop.loop_study import point
from tests.support.cli import workshop

SLOW_MS, GAIN = 4.0, 100.0


def test_without_dsc_a_gain_beyond_the_dead_time_does_not_settle() -> None:
    assert point("without DSC", SLOW_MS, 20).stable
    assert not point("without DSC", SLOW_MS, 200).stable


def test_with_dsc_no_gain_overshoots_because_the_gateway_limits_it() -> None:
    found = point("DSC, speed", SLOW_MS, 300)
    assert found.stable
    assert found.overshoot == 0


def test_a_higher_gain_follows_closer() -> None:
    assert point("DSC, speed", SLOW_MS, 30).following_error < point("DSC, speed", SLOW_MS, 15).following_error


def test_in_the_form_position_the_error_is_the_way_of_a_few_cycles() -> None:
    fastest = 1024 * 2 * 3.1416 * SLOW_MS / 1000
    """Increments in one cycle."""
    assert point("DSC, position", SLOW_MS, GAIN).following_error < 3 * fastest


def test_the_controller_sends_gain_and_error_with_dsc_and_their_product_without() -> None:
    actuals = {"G1_XIST1": 0xFFFF_FFFF}
    with_dsc = PositionLoop(50, dsc=True, increments_per_revolution=4096, reference_rpm=3000)
    assert with_dsc.step(2047, actuals) == {"NSOLL_B": 0, "XERR": 2048, "KPC": 50_000}
    without = PositionLoop(50, dsc=False, increments_per_revolution=4096, reference_rpm=3000)
    assert without.step(2047, actuals) == {"NSOLL_B": 0x2000_0000, "XERR": 0, "KPC": 0}, "25 rev/s"


def test_a_form_there_is_not_is_told() -> None:
    with pytest.raises(GatewayError, match="form 'torque' does not exist"):
        point("torque", SLOW_MS, GAIN)


def test_the_command_prints_and_draws(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "loop.png"
    result = workshop("loop", "--cycle-ms", "4", "--gain", "20", "--plot", str(picture))
    assert result.returncode == 0
    assert "without DSC" in result.stdout
    assert picture.stat().st_size > 10_000
