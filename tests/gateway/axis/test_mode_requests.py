"""A mode of operation that is requested, not confirmed, and requested again later."""

from __future__ import annotations

from pdgw.dsp402.modes import MODE_CONFIRM_NS
from pdgw.gateway.reasons import FaultNumber, Reason
from tests.gateway.axis.test_positioner_handshake import positioner
from tests.support.axis.hand import ON, Hand

JOG = 0x100
CYCLE_NS = 4_000_000


def reports_missing_mode(hand: Hand) -> bool:
    return any(fault.number == FaultNumber.MODE_NOT_CONFIRMED for fault in hand.stepper.machine.outputs.faults)


def test_an_abandoned_mode_request_does_not_count_for_the_next_one() -> None:
    hand = positioner().enable()
    hand(ON | JOG)
    hand(ON | JOG)
    assert hand.stepper.reason is Reason.MODE_NOT_CONFIRMED
    for _ in range(MODE_CONFIRM_NS // CYCLE_NS):
        hand(ON)
    for _ in range(10):
        hand(ON | JOG)
        assert hand.stepper.reason is Reason.MODE_NOT_CONFIRMED
        assert not reports_missing_mode(hand)
