"""DSC on SYNC through the whole gateway in virtual time: transmission types, periods, what is measured and shown."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.communication import CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT, SYNC, SYNC_PERIOD
from pdgw.ds301.configuration import SdoStep
from pdgw.dsp402.drive.guarding import GuardTimes, guard
from pdgw.dsp402.identification.overlay import Overlay, QuirkKeys
from pdgw.dsp402.states import State
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.daemon.sync import Spread
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import SimulatedDrive, shape
from pdgw.peers.drive.model.shapes import SYNCHRONOUS, Shape
from pdgw.tools.output.status_text import status_lines
from tests.support.gateways.daemon import (
    Plc,
    axis,
    configuration,
    drive_of,
    exchanging,
    online,
    operating,
    running,
    until,
    world_of,
)

MORE = 'simulate = true\nfollowing_window = 4096\ndsc = "speed"'
CYCLE_MS = 4


def test_set_points_and_actual_values_are_synchronous_and_the_drive_knows_the_period() -> None:
    with running(configuration(axis(1, telegram_number=105, more=MORE))) as daemon:
        online(daemon)
        node = drive_of(daemon).node
        assert [node.read(index, 2) for index in (0x1400, 0x1401, 0x1800, 0x1801, 0x1802)] == [1] * 5
        assert node.read(0x1006) == CYCLE_MS * 1000
        assert [node.read(0x60C2, sub) for sub in (1, 2)] == [CYCLE_MS, -3]


def test_speed_telegrams_stay_event_driven_and_no_sync_is_sent() -> None:
    with running(configuration(axis(1, telegram_number=102, more=MORE))) as daemon:
        online(daemon)
        node = drive_of(daemon).node
        assert [node.read(index, 2) for index in (0x1400, 0x1800)] == [255, 255]
        assert [bus["sync"] for bus in snapshot(daemon)["buses"]] == [None]


@pytest.mark.parametrize("number", [3, 4, 102, 103])
def test_speed_telegrams_with_an_encoder_are_synchronous_where_it_is_configured(number: int) -> None:
    more = "simulate = true\nsync = true" + ("\ng2 = 'drive'" if number in {4, 103} else "")
    with operating(configuration(axis(1, telegram_number=number, more=more))) as (daemon, plc):
        node = drive_of(daemon).node
        rpdos = range(0x1400, 0x1402 if number > 100 else 0x1401)
        assert {node.read(index, 2) for index in (*rpdos, 0x1800, 0x1801)} == {1}
        assert [node.read(0x60C2, sub) for sub in (1, 2)] == [CYCLE_MS, -3]
        assert node.read(0x6061) == 3
        frames: list[int] = []
        daemon.networks["can"].listeners.append(lambda message: frames.append(message.arbitration_id))
        plc.exchange(5)
        sent = [frame for frame in frames if frame in {0x201, 0x301, SYNC}]
        assert sent == ([0x301, 0x201, SYNC] if number > 100 else [0x201, SYNC]) * 5, "also what did not change"
        plc.endpoint.set(0, {"NSOLL_B": 1 << 28})
        plc.until(lambda: plc.value("NIST_B") == 1 << 28, "it turns")
        plc.exchange(1100)
        (item,) = snapshot(daemon)["buses"][0]["sync"]["axes"]
        assert item["dead_time_p99_ms"] == 1.5 * CYCLE_MS
        assert (item["dead_time_calculated_ms"], item["highest_gain"]) == (None, None), "no gain of the gateway's"
        assert "axis 1 dead time p99 6 ms" in "\n".join(status_lines(snapshot(daemon), 200))


def test_sync_makes_the_values_of_other_telegrams_synchronous_and_not_their_set_points() -> None:
    with running(configuration(axis(1, telegram_number=1, more="simulate = true\nsync = true"))) as daemon:
        online(daemon)
        node = drive_of(daemon).node
        assert [node.read(index, 2) for index in (0x1400, 0x1800)] == [255, 1]


def test_a_setpoint_takes_effect_with_the_next_sync_and_is_sent_in_every_cycle() -> None:
    with operating(configuration(axis(1, telegram_number=105, more=MORE))) as (daemon, plc):
        frames: list[int] = []
        daemon.networks["can"].listeners.append(lambda message: frames.append(message.arbitration_id))
        plc.exchange(5)
        sent = [frame for frame in frames if frame in {0x201, 0x301, SYNC}]
        assert sent == [0x301, 0x201, SYNC] * 5


def test_without_sync_the_drive_stops_by_itself() -> None:
    with operating(configuration(axis(1, telegram_number=105, more=MORE))) as (daemon, plc):
        plc.endpoint.set(0, {"NSOLL_B": 1 << 28})
        plc.until(lambda: plc.value("NIST_B") > 1 << 27, "it turns")
        model = drive_of(daemon).model
        daemon.buses.sync_producers.clear()
        plc.until(lambda: model.state is not State.OPERATION_ENABLED, "loss of SYNC")
        assert model.emcy_code == 0x8700
        plc.until(lambda: model.velocity_actual == 0, "standstill")


HEARTBEATS = {CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT}
KNOWN_TO_STOP = Overlay(name="test", title="test", sources=("this test",), quirks=QuirkKeys(sync_loss_periods=3))
SPEED_KEYS = MORE.replace(
    "simulate = true",
    'velocity_unit = "rpm"\nacceleration_unit = "rpm/s"\nrated_speed_rpm = 3000\ncounts_per_revolution = 4096',
)


def unguarded(daemon: Daemon, kind: Shape = SYNCHRONOUS) -> SimulatedDrive:
    """Nothing but the loss of SYNC stops it."""
    info = replace(kind.info, vendor_id=shape("rpm").info.vendor_id)
    return world_of(daemon).drive("world", 1, shape=replace(kind, lacks=kind.lacks | HEARTBEATS, info=info))


def turning(daemon: Daemon) -> tuple[SimulatedDrive, Plc]:
    """Such a drive in operation with telegram 105, and its PLC."""
    drive = unguarded(daemon)
    plc = Plc(daemon, [105])
    plc.enable()
    plc.endpoint.set(0, {"NSOLL_B": 1 << 28})
    plc.until(lambda: drive.model.ramp.speed > 100, "it turns")
    return drive, plc


def test_a_drive_whose_family_is_known_to_stop_without_sync_needs_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pdgw.dsp402.identification.overlay.Families.of", lambda *_: KNOWN_TO_STOP)
    with running(configuration(axis(1, telegram_number=105, more=SPEED_KEYS))) as daemon:
        drive, plc = turning(daemon)
        (status,) = snapshot(daemon)["axes"]
        period = f"3 periods of {CYCLE_MS * 1000} us, 1006h"
        assert status["guarding"] == f"the loss of SYNC ({period}), then its own reaction"
        plc.exchange(250)
        assert drive.model.ramp.speed > 100, "SYNC for a second, and not stopped"
        world_of(daemon).gateway_port("world").connect(False)
        plc.loop.run_for(1500 * MS)
        assert drive.model.ramp.speed == 0
        world_of(daemon).gateway_port("world").connect(True)


@pytest.mark.parametrize(
    ("number", "kind", "family", "holds_period"),
    [
        pytest.param(105, SYNCHRONOUS, None, True, id="family not known to"),
        pytest.param(1, SYNCHRONOUS, KNOWN_TO_STOP, True, id="set-points without SYNC"),
        pytest.param(105, SYNCHRONOUS, KNOWN_TO_STOP, False, id="period not taken"),
    ],
)
def test_the_loss_of_sync_guards_nothing_where_it_is_not_known_to(
    number: int, kind: Shape, family: Overlay | None, holds_period: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pdgw.dsp402.identification.overlay.Families.of", lambda *_: family)
    with running(configuration(axis(1, telegram_number=number, more=SPEED_KEYS))) as daemon:
        drive = unguarded(daemon, kind)
        if not holds_period:
            drive.node.entries.pop((SYNC_PERIOD, 0))
            drive.node.indices.discard(SYNC_PERIOD)
        client = daemon.axes[0].drive
        until(daemon, lambda: client.status.value == "refused", "refused")
        assert "guarding of the gateway by the drive" in client.status_text


@pytest.mark.parametrize("held", [0, 4000, 8000])
def test_the_loss_of_sync_guards_where_the_drive_holds_the_period_that_was_written(held: int) -> None:
    def refuses(step: SdoStep) -> int:
        raise SdoAbortedError(Abort.NO_SUCH_OBJECT)

    wanted = GuardTimes(127, 100, 3, 100, 3, 0x1400, sync_loss_periods=3, sync_period_us=4000)
    found = guard(wanted, refuses, lambda *_: held)
    assert found.sync is (held == 4000)
    assert bool(found.refusal) is (held != 4000)


def test_sync_is_withheld_from_a_drive_that_reacts_to_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pdgw.dsp402.identification.overlay.Families.of", lambda *_: KNOWN_TO_STOP)
    with running(configuration(axis(1, telegram_number=105, more=SPEED_KEYS))) as daemon:
        drive, plc = turning(daemon)
        receive = drive.node.receive

        def without_reaction(can_id: int, data: bytes, now: int) -> None:
            if can_id == SYNC:
                receive(can_id, data, now)

        drive.do(lambda node: setattr(node, "receive", without_reaction))
        plc.endpoint.set(0, {"STW1": 0x047B})
        plc.until(lambda: drive.model.ramp.speed == 0, "standstill")
        assert drive.model.emcy_code == 0x8700


def test_jitter_and_dead_time_are_measured_and_shown() -> None:
    with operating(configuration(axis(1, telegram_number=105, more=MORE))) as (daemon, plc):
        daemon.buses.find_sync()
        for late_us in (0, 300, 0, -200) * 20:
            plc.send()
            plc.loop.run_for(CYCLE_MS * MS + late_us * 1000)
        (bus,) = snapshot(daemon)["buses"]
        sync = bus["sync"]
        assert sync["period_ms"] == CYCLE_MS
        assert 200 <= sync["jitter_p99_us"] <= sync["jitter_worst_us"] <= 600
        (item,) = sync["axes"]
        # The position at the last SYNC is in the next setpoint, which applies for one period.
        assert 6 <= item["dead_time_p99_ms"] <= item["dead_time_worst_ms"] <= 6.6
        assert item["dead_time_calculated_ms"] == 2.5 * CYCLE_MS
        assert item["highest_gain"] == pytest.approx(1000 / (2.718281828 * 10), abs=0.01)
        text = "\n".join(status_lines(snapshot(daemon), 200))
        assert "SYNC every 4 ms, jitter p99" in text
        assert "for 10 ms KPC is at most 36.8 1/s" in text


def test_a_telegram_with_dsc_that_is_chosen_later_gets_its_sync() -> None:
    with running(configuration(axis(1, telegram_number=1, more=MORE))) as daemon:
        online(daemon)
        assert not daemon.sync_producers
        daemon.change_telegram(daemon.axes[0], 105)
        plc = Plc(daemon, [105])
        with exchanging(plc):
            until(daemon, lambda: daemon.axes[0].good, "online with SYNC")
        assert drive_of(daemon).node.read(0x1400, 2) == 1
        assert world_of(daemon).loop.task_errors == 0


def test_a_spread_shows_the_99th_percentile_of_the_newest_and_the_worst_of_all() -> None:
    spread = Spread()
    assert (spread.p99, spread.worst) == (0, 0)
    spread.add(5000)
    for value in range(1, 1025):
        spread.add(value)
    assert (spread.p99, spread.worst) == (1013, 5000)
