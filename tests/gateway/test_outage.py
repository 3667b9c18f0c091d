"""A CAN bus that was away: a drive that turned meanwhile gets its stop as soon as a frame can pass, and nothing starts it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle, product

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.states import Command, State
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.peers.world import World
from tests.conformance.rig import COMPLETE
from tests.support.gateways.daemon import (
    OFF,
    ON,
    Plc,
    axis,
    configuration,
    drive_of,
    exchanging,
    operating,
    running,
    until,
    world_of,
)

CHANNEL = "world"
FULL_SPEED = 0x4000
OUTAGES_MS = (1, 20, 60, 100, 140, 180, 219, 250, 290, 310, 400, 700, 1000, 1500, 3000, 10_000)
REFRESH = DriveSettings(1).rpdo_refresh_ms * MS
CONTROL = PdoDirection.RPDO.cob_id(1, 1)


def _cut(world: World, away: bool) -> None:
    world.gateway_port(CHANNEL).connect(not away)


def _unplug(world: World, away: bool) -> None:
    world.unplug(CHANNEL, away)


def _short(world: World, away: bool) -> None:
    world.bus(CHANNEL).short(away)


OUTAGES: dict[str, Callable[[World, bool], None]] = {
    "wire cut": _cut,
    "adapter unplugged": _unplug,
    "short circuit": _short,
}


@pytest.mark.parametrize(
    ("milliseconds", "outage"),
    list(product(OUTAGES_MS, OUTAGES)) if COMPLETE else list(zip(OUTAGES_MS, cycle(OUTAGES), strict=False)),
    ids=str,
)
def test_a_turning_drive_is_stopped_within_two_refreshes_of_the_first_frame_that_passes(
    milliseconds: int, outage: str
) -> None:
    """Each duration with one kind of outage in turn; ``make conformance`` has all combinations."""
    with operating() as (daemon, plc):
        plc.turn(FULL_SPEED)
        model, world = drive_of(daemon).model, world_of(daemon)
        world.bus(CHANNEL).members[0].restart_ns = 0
        with exchanging(plc):
            OUTAGES[outage](world, True)
            world.loop.run_for(milliseconds * MS)
            lost = not daemon.axes[0].good or model.state is not State.OPERATION_ENABLED
            OUTAGES[outage](world, False)
            passed = daemon.networks["can"].received
            until(daemon, lambda: daemon.networks["can"].received > passed, "the first frame", 15 * SECOND)
            world.loop.run_for(2 * REFRESH)
            lost = lost or not daemon.axes[0].good
            if lost:
                # A drive that noticed the silence of the gateway has stopped by itself already.
                assert model.state is not State.OPERATION_ENABLED, daemon.axes[0].client.status_text
                until(daemon, lambda: model.velocity_actual == 0, "standstill")
                until(daemon, lambda: daemon.axes[0].good, "online again", 30 * SECOND)
                world.loop.run_for(2 * SECOND)
                assert model.state is State.SWITCH_ON_DISABLED, "a standing ON restarts nothing"
                assert model.velocity_actual == 0
            else:
                world.loop.run_for(2 * SECOND)
                assert model.state is State.OPERATION_ENABLED, "what nobody noticed stops nobody"


def test_the_stop_is_on_its_way_while_the_bus_is_away() -> None:
    """The queue of a controller without a bus, and every try to send, hold the stop: it is what passes first."""
    sent: list[int] = []
    with operating() as (daemon, plc):
        plc.turn(FULL_SPEED)
        world = world_of(daemon)
        with exchanging(plc):
            world.unplug(CHANNEL)
            world.loop.run_for(900 * MS)
            daemon.networks["can"].listeners.append(
                lambda message: (
                    sent.append(int.from_bytes(message.data[-2:], "little"))
                    if message.arbitration_id == CONTROL and not message.is_rx
                    else None
                )
            )
            world.unplug(CHANNEL, False)
            until(daemon, lambda: sent, "the first Controlword")
    assert Command.QUICK_STOP.matches(sent[0]) or Command.DISABLE_VOLTAGE.matches(sent[0])


@pytest.mark.parametrize(("droppable", "at_most_ms"), [(True, 0), (False, 10)])
@pytest.mark.parametrize("outage_ms", [300, 5000])
def test_an_enable_that_waited_in_the_controller_turns_no_drive(
    outage_ms: int, droppable: bool, at_most_ms: int
) -> None:
    """The wire is cut in Switched On, then the PLC enables: the enable is queued, and the stop after it."""
    switched_on = ON & ~0x8
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "ready")
        plc.endpoint.set(0, {"STW1": switched_on, "NSOLL_A": FULL_SPEED})
        plc.until(lambda: plc.state() == 0x03, "switched on")
        drive, world = drive_of(daemon), world_of(daemon)
        # The drive does not notice the outage itself: its guarding is what would hide the rest.
        drive.do(lambda node: node.set_data(0x1016, 1, bytes(4), check_writable=True))
        controller = world.gateway_port(CHANNEL)
        controller.droppable = droppable
        enabled: list[int] = []
        drive.do(
            lambda node: node.model.disguises.append(
                lambda model, now: enabled.append(now) if model.state is State.OPERATION_ENABLED else None
            )
        )
        with exchanging(plc):
            world.loop.run_for(100 * MS)
            controller.connect(connected=False)
            plc.endpoint.set(0, {"STW1": ON})
            world.loop.run_for(outage_ms * MS)
            assert not enabled
            controller.connect(connected=True)
            world.loop.run_for(3 * SECOND)
        assert (enabled[-1] - enabled[0] if enabled else 0) <= at_most_ms * MS
        assert droppable is (not enabled)
        assert drive.model.state is not State.OPERATION_ENABLED


@pytest.mark.parametrize("outage_ms", [300, 5000])
def test_an_enable_that_waited_starts_a_drive_in_ready_to_switch_on_for_10_ms_at_most(outage_ms: int) -> None:
    """Its Statusword is late: the Enable Operation is the answer to a Switched On that the drive has left by an OFF."""
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "ready")
        plc.endpoint.set(0, {"STW1": ON & ~0x8, "NSOLL_A": FULL_SPEED})
        plc.until(lambda: plc.state() == 0x03, "switched on")
        drive, world = drive_of(daemon), world_of(daemon)
        # Without its guarding, which ends Ready To Switch On before.
        drive.do(lambda node: node.set_data(0x1016, 1, bytes(4), check_writable=True))
        drive.do(lambda node: node.start_fault("late-status", delay_ms=100))
        enabled: list[int] = []
        drive.do(
            lambda node: node.model.disguises.append(
                lambda model, now: enabled.append(now) if model.state is State.OPERATION_ENABLED else None
            )
        )
        with exchanging(plc):
            world.loop.run_for(200 * MS)
            plc.endpoint.set(0, {"STW1": OFF})
            until(daemon, lambda: drive.model.state is State.READY_TO_SWITCH_ON, "the drive obeys the OFF")
            world.gateway_port(CHANNEL).connect(connected=False)
            plc.endpoint.set(0, {"STW1": ON})
            world.loop.run_for(outage_ms * MS)
            assert not enabled
            world.gateway_port(CHANNEL).connect(connected=True)
            world.loop.run_for(3 * SECOND)
        assert enabled
        assert enabled[-1] - enabled[0] <= 10 * MS
        assert drive.model.state is not State.OPERATION_ENABLED


def test_a_bus_off_that_is_over_at_once_stops_the_drive_until_off_and_on() -> None:
    """Between two passes of the watch the controller left the bus, came back, and received a frame."""
    with operating() as (daemon, plc):
        plc.turn(FULL_SPEED)
        model, network = drive_of(daemon).model, daemon.networks["can"]
        network.on_error_frame(bus_off=True, passive=False)
        network.on_frame(0x7F, b"", network.loop.now())
        assert network.healthy
        with exchanging(plc):
            until(daemon, lambda: model.velocity_actual == 0, "standstill", 5 * SECOND)
            until(daemon, lambda: daemon.axes[0].good, "the drive is back", 15 * SECOND)
            world_of(daemon).loop.run_for(SECOND)
            assert model.state is not State.OPERATION_ENABLED, "the ON that is still 1 starts nothing"
        assert FaultNumber.BUS_LOST in [fault.number for fault in daemon.axes[0].faults]


@pytest.mark.parametrize("outage_ms", [50, 300, 5000])
def test_nothing_that_waited_starts_the_only_drive_when_its_power_returns(outage_ms: int) -> None:
    """No device acknowledges meanwhile: the controller of the gateway is error-passive, and its frames wait."""
    with operating() as (daemon, plc):
        plc.turn(FULL_SPEED)
        drive, world, network = drive_of(daemon), world_of(daemon), daemon.networks["can"]
        controller = world.gateway_port(CHANNEL)
        states: list[State] = []
        with exchanging(plc):
            drive.do(lambda node: node.power_off())
            drive.do(lambda node: node.model.watchers.append(states.append))
            world.loop.run_for(outage_ms * MS)
            assert (network.health.error_passive, network.health.bus_off, controller.bus_off) == (1, 0, False)
            assert controller.queue
            drive.do(lambda node: node.restart())
            until(daemon, lambda: network.healthy and not controller.queue, "the frames that waited")
            world.loop.run_for(10 * SECOND)
            until(daemon, lambda: daemon.axes[0].good, "online again", 30 * SECOND)
            world.loop.run_for(2 * SECOND)
        assert State.OPERATION_ENABLED not in states
        assert drive.model.speed == 0
