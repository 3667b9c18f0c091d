"""What the events of an interface show of its bus: each outage has its own evidence, and ends with a frame in both directions."""

from __future__ import annotations

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.health import BUSY_NS, RESTART_NS, BusHealth, Outage


def refuse(health: BusHealth, begin: int, duration: int, *, hears: bool = False) -> None:
    """The interface takes no frame for this time."""
    for now in range(begin, begin + duration + 1, MS):
        health.busy(now)
        if hears:
            health.received(now)


def test_a_queue_that_is_full_for_a_moment_does_not_count() -> None:
    health = BusHealth()
    refuse(health, 1, BUSY_NS - MS)
    health.taken()
    refuse(health, BUSY_NS, BUSY_NS - MS)
    assert (health.outage, health.failures) == (None, 0)


def test_a_full_queue_without_received_frames_is_a_missing_acknowledge() -> None:
    health = BusHealth()
    health.error(1, bus_off=False)
    refuse(health, 1, BUSY_NS)
    assert health.outage is Outage.UNACKNOWLEDGED


def test_interface_without_an_error_may_be_bus_off_since_before_the_start() -> None:
    health = BusHealth()
    refuse(health, 1, BUSY_NS)
    assert health.outage is Outage.QUIET


def test_an_interface_that_only_receives_is_stuck_and_not_well_again_by_a_frame() -> None:
    health = BusHealth()
    refuse(health, 1, 2 * BUSY_NS, hears=True)
    assert health.outage is Outage.STUCK
    health.received(SECOND)
    assert health.outage is Outage.STUCK
    health.taken()
    assert health.outage is Outage.STUCK, "taken is not sent"
    health.received(SECOND)
    assert health.outage is None
    assert (health.last, health.failures) == (Outage.STUCK, 1)


def test_first_frame_of_a_device_that_was_off_does_not_prove_a_stuck_interface() -> None:
    health = BusHealth()
    health.error(1, bus_off=False)
    refuse(health, 1, 5 * BUSY_NS)
    health.received(6 * BUSY_NS)
    health.busy(6 * BUSY_NS + MS)
    assert health.outage is Outage.UNACKNOWLEDGED


def test_the_queue_of_a_lost_interface_is_gone_with_it() -> None:
    health = BusHealth()
    refuse(health, 1, BUSY_NS)
    health.lost()
    assert health.outage is Outage.INTERFACE
    health.received(SECOND)
    assert health.outage is None


def test_bus_off_stays_what_a_full_queue_means_until_the_controller_reports_another_state() -> None:
    health = BusHealth()
    health.error(1, bus_off=True)
    refuse(health, 1, SECOND)
    assert health.outage is Outage.BUS_OFF
    health.taken()
    health.error(2 * SECOND, bus_off=False)
    refuse(health, 2 * SECOND, BUSY_NS)
    assert (health.outage, health.failures) == (Outage.UNACKNOWLEDGED, 1)


def test_bus_off_without_another_error_for_seconds_is_one_that_does_not_end() -> None:
    health = BusHealth()
    health.error(SECOND, bus_off=True)
    assert health.shown(SECOND + RESTART_NS - 1) is Outage.BUS_OFF
    assert health.shown(SECOND + RESTART_NS) is Outage.STAYS_OFF
    health.error(SECOND + RESTART_NS, bus_off=True)
    assert health.shown(SECOND + RESTART_NS) is Outage.BUS_OFF, "it restarts, into the same short circuit"


def test_a_lost_interface_is_that_until_a_frame_passes() -> None:
    health = BusHealth()
    health.error(1, bus_off=True)
    health.lost()
    assert health.outage is Outage.INTERFACE
    health.taken()
    health.received(1)
    assert health.outage is None
