"""The position controller of the simulated PLC."""

from __future__ import annotations

from pdgw.peers.plc.exchange.following import PositionLoop


def test_the_controller_sends_gain_and_error_with_dsc_and_their_product_without() -> None:
    actuals = {"G1_XIST1": 0xFFFF_FFFF}
    with_dsc = PositionLoop(50, dsc=True, increments_per_revolution=4096, reference_rpm=3000)
    assert with_dsc.step(2047, actuals) == {"NSOLL_B": 0, "XERR": 2048, "KPC": 50_000}
    without = PositionLoop(50, dsc=False, increments_per_revolution=4096, reference_rpm=3000)
    assert without.step(2047, actuals) == {"NSOLL_B": 0x2000_0000, "XERR": 0, "KPC": 0}, "25 rev/s"
