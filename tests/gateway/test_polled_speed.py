"""A drive whose speed no TPDO has: it is read by SDO, its answers are late or lost, and an old one counts for nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.states import State
from pdgw.gateway.base.reasons import FaultNumber
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive import SimulatedDrive, shape
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, online, running, world_of

FULL = 0x4000
FAST = 0x3300
"""NSOLL_A of 2391 rpm."""
LATE = ("sdo-answers-of-object-late", {"delay_ms": 400})
LOST = ("sdo-answers-of-object-missing", {})


@contextmanager
def polled(more: str = "", number: int = 1) -> Iterator[tuple[Daemon, SimulatedDrive, Plc]]:
    """A drive in operation, with a speed that is read by SDO."""
    with running(configuration(axis(1, telegram_number=number, more=more), transport="cycle_time_ms = 4")) as daemon:
        drive = world_of(daemon).drive("world", 1, shape=shape("speed-by-sdo"))
        online(daemon)
        plc = Plc(daemon, [number])
        plc.enable()
        yield daemon, drive, plc


def _for(plc: Plc, nanoseconds: int) -> None:
    plc.exchange(nanoseconds // plc.daemon.cycle_ns)


def _faults(daemon: Daemon) -> list[int]:
    return [fault.number for fault in daemon.axes[0].faults]


def _turn(plc: Plc) -> None:
    plc.endpoint.set(0, {"NSOLL_A": FAST})
    plc.until(lambda: abs(plc.value("NIST_A") - FAST) <= 10, "the speed")


def _begin(drive: SimulatedDrive, fault: tuple[str, dict[str, int]]) -> None:
    drive.do(lambda node: node.start_fault(fault[0], **fault[1]))


def test_the_speed_of_this_drive_is_read_by_sdo() -> None:
    with polled() as (daemon, _, _):
        plan = daemon.axes[0].drive.plan
        assert plan is not None
        assert "read by SDO every 100 ms: Velocity Actual Value 606Ch" in plan.lines


@pytest.mark.parametrize("disturbance", [LATE, LOST], ids=["late", "lost"])
def test_off1_of_a_drive_that_brakes_while_answers_are_late_or_lost_is_no_fault(
    disturbance: tuple[str, dict[str, int]],
) -> None:
    with polled() as (daemon, drive, plc):
        _turn(plc)
        _begin(drive, disturbance)
        plc.endpoint.set(0, {"STW1": OFF})
        _for(plc, 600 * MS)
        drive.do(lambda node: node.end_fault())
        plc.until(lambda: drive.model.state is not State.OPERATION_ENABLED, "the end of the ramp")
        assert abs(drive.model.ramp.speed) <= 30
        _for(plc, SECOND)
        assert plc.state() == 0x01
        assert _faults(daemon) == []


def test_off1_with_an_old_standstill_brakes_the_shaft_before_power_goes() -> None:
    with polled() as (daemon, drive, plc):
        _for(plc, SECOND)
        plc.endpoint.set(0, {"NSOLL_A": FULL})
        _begin(drive, LOST)
        plc.until(lambda: drive.model.ramp.speed > 2300, "the speed")
        plc.endpoint.set(0, {"STW1": OFF})
        _for(plc, 40 * MS)
        drive.do(lambda node: node.end_fault())
        plc.until(lambda: drive.model.state is not State.OPERATION_ENABLED, "the end of the ramp")
        assert abs(drive.model.ramp.speed) <= 30
        assert _faults(daemon) == []


def test_a_standstill_needs_two_answers_to_requests_after_the_order() -> None:
    with polled() as (daemon, drive, plc):
        _for(plc, SECOND)
        asked = daemon.axes[0].machine.inputs.speed_asked_ns
        plc.endpoint.set(0, {"STW1": OFF})
        requests = set()
        while drive.model.state is State.OPERATION_ENABLED:
            plc.exchange()
            requests.add(daemon.axes[0].machine.inputs.speed_asked_ns)
        assert len(requests - {asked}) == 2
        assert _faults(daemon) == []


@pytest.mark.parametrize("disturbance", [None, LATE], ids=["prompt", "late"])
def test_a_deaf_drive_with_a_polled_speed_is_stopped_by_nmt(disturbance: tuple[str, dict[str, int]] | None) -> None:
    with polled() as (daemon, drive, plc):
        _turn(plc)
        if disturbance is not None:
            _begin(drive, disturbance)
            _for(plc, SECOND)
        drive.do(lambda node: node.start_fault("deaf"))
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: FaultNumber.STOP_IGNORED in _faults(daemon), "the fault", 2)


def test_a_ramp_with_an_unknown_speed_ends_with_quick_stop_after_twice_the_stop_time() -> None:
    with polled("stop_time_ms = 1500\nsdo_timeout_ms = 2000") as (daemon, drive, plc):
        _turn(plc)
        _begin(drive, ("sdo-answers-of-object-late", {"delay_ms": 1500}))
        _for(plc, 2 * SECOND)
        plc.endpoint.set(0, {"STW1": OFF})
        _for(plc, 3 * SECOND)
        assert drive.model.state is State.OPERATION_ENABLED
        assert _faults(daemon) == []
        _for(plc, 500 * MS)
        assert drive.model.state is not State.OPERATION_ENABLED
        assert _faults(daemon) == [FaultNumber.STOP_IGNORED]
        assert "606Ch by SDO is" in daemon.axes[0].faults[0].text


def test_bits_of_the_speed_are_0_while_it_is_unknown() -> None:
    bits = 1 << 8 | 1 << 10
    with polled() as (_, drive, plc):
        _turn(plc)
        _for(plc, SECOND)
        assert plc.value("ZSW1") & bits == bits
        _begin(drive, LOST)
        _for(plc, 250 * MS)
        assert plc.value("ZSW1") & bits == bits
        _for(plc, 200 * MS)
        assert plc.value("ZSW1") & bits == 0


def test_fast_changes_of_the_speed_between_late_answers_contradict_no_position() -> None:
    """Telegram 3 has the position in a TPDO, which is newer than the speed."""
    with polled(number=3, more="counts_per_revolution = 4096") as (daemon, drive, plc):
        _begin(drive, LATE)
        for speed in (FULL, 0, FULL, 0):
            plc.endpoint.set(0, {"NSOLL_B": speed << 16})
            _for(plc, 1200 * MS)
        assert _faults(daemon) == []
