"""Two redundant controllers with one gateway: a switchover starts nothing, and without a leader the axes stop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pdgw.dsp402.states import State
from pdgw.durations import MS
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.service.status import snapshot
from pdgw.profidrive.frame import STATUS_RUN
from pdgw.tools.output.status_text import status_lines
from tests.support.gateways.daemon import axis
from tests.support.gateways.daemon import configuration as udp_configuration
from tests.support.gateways.profinet_daemon import OFF, ON
from tests.support.gateways.twin_controllers import (
    BOUND_NS,
    CYCLE_NS,
    HOLD_MS,
    OTHER_SPEED,
    SPEED,
    WAYS,
    Twins,
    die,
    hand_over,
    twins,
)
from tests.support.wire.profinet import BACKUP_IP


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
@pytest.mark.parametrize("gap_ms", [0, 50, 170])
def test_the_same_orders_go_on_over_a_switchover(tmp_path: Path, way: Callable[[Twins], None], gap_ms: int) -> None:
    with twins(tmp_path) as pair:
        site = pair.site
        way(pair)
        for _ in range(gap_ms):
            site.run(MS)
            assert pair.turns
        pair.other.lead(primary=True)
        for _ in range(500):
            site.run(MS)
            assert pair.turns
        assert not pair.lost()
        assert site.link.switchovers == 1
        assert site.link.peer_host == BACKUP_IP
        pair.set(pair.other, ON, OTHER_SPEED)
        site.run(500 * MS)
        assert abs(pair.drive.model.velocity_actual) < 1500, "the new controller leads"
        pair.set(pair.other, OFF)
        site.until(lambda: pair.drive.model.state is not State.OPERATION_ENABLED, "OFF1")


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
def test_nobody_takes_over_and_the_axis_stops_as_after_a_loss(tmp_path: Path, way: Callable[[Twins], None]) -> None:
    with twins(tmp_path) as pair:
        site, model = pair.site, pair.drive.model
        since = site.loop.now()
        way(pair)
        limit = HOLD_MS * MS + BOUND_NS
        site.until(lambda: model.state is not State.OPERATION_ENABLED, "a stop", limit)
        assert site.loop.now() - since >= HOLD_MS * MS - 2 * CYCLE_NS
        assert pair.lost()
        # It becomes primary too late, with ON set.
        site.run(100 * MS)
        pair.connect(pair.other)
        pair.other.lead(primary=True)
        pair.set(pair.other, ON, SPEED)
        site.run(1000 * MS)
        assert model.state is State.SWITCH_ON_DISABLED
        pair.set(pair.other, OFF)
        site.run(100 * MS)
        pair.set(pair.other, ON, SPEED)
        site.run(500 * MS)
        assert pair.turns


def test_without_a_backup_the_axis_stops_after_the_watchdog(tmp_path: Path) -> None:
    with twins(tmp_path) as pair:
        site = pair.site
        pair.other.release(site.loop.now())
        site.run(100 * MS)
        assert pair.turns, "the backup is no loss"
        die(pair)
        site.until(lambda: pair.drive.model.state is not State.OPERATION_ENABLED, "a stop", BOUND_NS)
        assert pair.lost()


def test_the_end_of_the_second_controller_too_is_a_loss_at_once(tmp_path: Path) -> None:
    with twins(tmp_path) as pair:
        site = pair.site
        pair.one.release(site.loop.now())
        site.until(lambda: not site.link.connected, "the end of the first", CYCLE_NS)
        assert pair.turns
        pair.other.release(site.loop.now())
        site.until(lambda: not site.link.device.relations, "the end of the second", CYCLE_NS)
        assert site.link.setpoints == [None]
        assert site.link.poll(site.loop.now())
        assert "ended" in site.link.loss


def test_a_dead_backup_cannot_take_over(tmp_path: Path) -> None:
    """Its relationship still exists, but it is silent."""
    with twins(tmp_path, data_hold=10) as pair:
        site = pair.site
        site.dead.add(pair.other)
        site.run(60 * MS)
        die(pair)
        site.until(lambda: pair.drive.model.state is not State.OPERATION_ENABLED, "a stop", 100 * MS)
        assert pair.lost()


def test_stop_of_the_leading_controller_stops_at_once(tmp_path: Path) -> None:
    with twins(tmp_path) as pair:
        assert pair.one.provider is not None
        pair.one.provider.data_status &= ~STATUS_RUN
        pair.site.until(lambda: pair.drive.model.state is not State.OPERATION_ENABLED, "a stop", BOUND_NS)


@pytest.mark.parametrize("word", [0x047F | 0x80, 0x047F | 0x800, 0x047F & ~0x10 | 0x80])
def test_another_order_of_the_new_leader_stops_the_axis_and_needs_off_and_on(tmp_path: Path, word: int) -> None:
    with twins(tmp_path) as pair:
        site, model = pair.site, pair.drive.model
        pair.set(pair.other, word, SPEED)
        pair.other.lead(primary=True)
        pair.one.lead(primary=False)
        site.until(lambda: model.state is not State.OPERATION_ENABLED, "a stop", BOUND_NS)
        pair.set(pair.other, ON, SPEED)
        site.run(1000 * MS)
        assert model.state is State.SWITCH_ON_DISABLED
        assert not pair.lost(), "one axis, not the link"
        pair.set(pair.other, OFF)
        site.run(100 * MS)
        pair.set(pair.other, ON, SPEED)
        site.run(500 * MS)
        assert pair.turns


@pytest.mark.parametrize(("word", "reason"), [(OFF, "OFF1"), (0x047D, "OFF2"), (0x047B, "OFF3"), (0x046F, "speed 0")])
def test_a_stop_of_the_new_leader_is_obeyed_as_such(tmp_path: Path, word: int, reason: str) -> None:
    with twins(tmp_path) as pair:
        pair.set(pair.other, word, SPEED)
        pair.other.lead(primary=True)
        pair.one.lead(primary=False)
        pair.site.until(lambda: not pair.drive.model.velocity_actual, reason)
        assert not pair.lost()


@pytest.mark.parametrize(
    ("word", "frames"), [(OFF, 1), (0x047D, 1), (0x047B, 1), (0x046F, 1), (0x04FE, 2)], ids=lambda value: f"{value:X}"
)
def test_stop_in_first_frames_of_a_takeover_is_a_step_of_the_axes(tmp_path: Path, word: int, frames: int) -> None:
    """The gateway was held up: the frames of both controllers wait, and only the first of the new leader have the stop.

    With an acknowledge beside OFF1, the first of them is a loss of the PLC for the axis.
    """
    with twins(tmp_path) as pair:
        site, link = pair.site, pair.site.link
        for plc, sent in ((pair.one, ON), *[(pair.other, word)] * frames, (pair.other, ON), (pair.other, ON)):
            if plc is pair.other:
                plc.lead(primary=True)
            pair.set(plc, sent, SPEED)
            assert plc.provider is not None
            frame = plc.provider.poll(plc.provider.due)
            assert frame is not None
            site.port.real_time.append(bytes(frame))
        seen = []
        while site.port.real_time:
            link.receive(site.loop.now())
            seen.append(link.setpoints[0])
        assert (word, SPEED) in seen
        assert link.switchovers == 1


def test_a_switchover_starts_no_drive_with_a_standing_on(tmp_path: Path) -> None:
    """The first controller had ordered OFF, which releases the lock; the second one sends ON without an edge."""
    with twins(tmp_path) as pair:
        site, model = pair.site, pair.drive.model
        pair.set(pair.one, OFF)
        site.until(lambda: site.word() & 0x4F == 0x01, "off")
        pair.other.lead(primary=True)
        pair.one.lead(primary=False)
        site.run(1000 * MS)
        assert model.state is not State.OPERATION_ENABLED
        pair.set(pair.other, OFF)
        site.run(100 * MS)
        pair.set(pair.other, ON, SPEED)
        site.run(500 * MS)
        assert pair.turns


def test_two_controllers_that_both_lead_for_the_hold_time_stop_the_axis(tmp_path: Path) -> None:
    with twins(tmp_path) as pair:
        pair.other.lead(primary=True)
        pair.site.run(HOLD_MS * MS // 2)
        assert pair.turns
        pair.site.until(
            lambda: pair.drive.model.state is not State.OPERATION_ENABLED, "a stop", HOLD_MS * MS // 2 + BOUND_NS
        )
        assert pair.lost()


def test_the_status_shows_both_controllers(tmp_path: Path) -> None:
    with twins(tmp_path) as pair:
        text = "\n".join(status_lines(snapshot(pair.site.daemon), 400))
        assert "controller plc-1: exchanges data" in text
        assert "backup controller plc-2" in text
        hand_over(pair)
        pair.other.lead(primary=True)
        pair.site.run(50 * MS)
        text = "\n".join(status_lines(snapshot(pair.site.daemon), 400))
        assert "controller plc-2: exchanges data" in text
        assert "backup controller plc-1" in text


def test_redundancy_is_for_profinet_only() -> None:
    with pytest.raises(GatewayError, match='switchover_ms: allowed only with type = "profinet"'):
        udp_configuration(axis(1), transport="switchover_ms = 200")
