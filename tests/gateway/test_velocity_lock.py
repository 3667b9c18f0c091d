"""An axis whose speed contradicts its units: stopped by a quick stop, locked until acknowledged, then OFF and ON again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import can
import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.communication import SDO_REQUEST
from pdgw.ds301.loop.loop import Event
from pdgw.dsp402.states import State
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.daemon.daemon import Daemon
from tests.support.drives.own_law_drive import Law, OwnLawDrive
from tests.support.gateways.daemon import OFF, ON, Plc, axis, configuration, online, running, world_of

ACKNOWLEDGE = 1 << 7
_OBJECTS = {(0x6080, 0): 3000, (0x60A9, 0): 0x00B4_4700, (0x608F, 1): 4096, (0x608F, 2): 1}
WRONG_LAW = Law(8.0, objects=_OBJECTS)
"""60A9h says rpm, one unit is 8 rpm."""


@contextmanager
def stopped_by_the_check() -> Iterator[tuple[Daemon, OwnLawDrive, Plc]]:
    with running(configuration(axis(1, more=""))) as daemon:
        drive = OwnLawDrive(world_of(daemon), "world", 1, WRONG_LAW)
        online(daemon)
        plc = Plc(daemon, [1])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": 0x0100})
        plc.until(lambda: daemon.axes[0].faults, "the fault")
        plc.until(lambda: drive.node.rpm == 0, "standstill")
        yield daemon, drive, plc


@contextmanager
def turning_in_velocity_mode() -> Iterator[tuple[Daemon, OwnLawDrive, Plc]]:
    """A drive in velocity mode whose factors are 1 turns with the speed that was asked for."""
    ones = {(factor, place): 1 for factor in (0x604B, 0x604C) for place in (1, 2)}
    law = Law(1.0, objects={(0x6080, 0): 3000} | ones, vl=True)
    with running(configuration(axis(1, more=""))) as daemon:
        drive = OwnLawDrive(world_of(daemon), "world", 1, law)
        online(daemon)
        plc = Plc(daemon, [1])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": 0x0100})
        plc.until(lambda: abs(drive.node.rpm - 3000 / 64) < 1, "the speed that was asked for")
        yield daemon, drive, plc


def _for_a_second(plc: Plc) -> None:
    plc.exchange(SECOND // plc.daemon.cycle_ns)


def test_contradiction_stops_by_quick_stop_and_is_reported() -> None:
    with stopped_by_the_check() as (daemon, drive, plc):
        _for_a_second(plc)
        fault = daemon.axes[0].faults[0]
        assert fault.number == FaultNumber.VELOCITY
        assert "606Ch reports" in fault.text
        assert "6064h moves at" in fault.text
        assert State.QUICK_STOP_ACTIVE in drive.node.states
        assert daemon.axes[0].outputs.reason is Reason.UNITS_CONTRADICTED
        assert plc.value("ZSW1") & 1 << 3, "fault"


def test_no_off_and_on_and_no_restart_of_the_drive_start_it_before_an_acknowledgement() -> None:
    with stopped_by_the_check() as (daemon, drive, plc):
        for word in (OFF, ON, OFF, ON):
            plc.endpoint.set(0, {"STW1": word})
            _for_a_second(plc)
        drive.do(lambda node: node.restart())
        generation = daemon.axes[0].drive.generation
        plc.until(lambda: daemon.axes[0].drive.generation > generation, "online again")
        for word in (OFF, ON):
            plc.endpoint.set(0, {"STW1": word})
            _for_a_second(plc)
        assert drive.node.rpm == 0
        assert drive.node.drive_state is not State.OPERATION_ENABLED
        assert daemon.axes[0].outputs.reason is Reason.UNITS_CONTRADICTED


def test_acknowledged_axis_needs_off_and_on_and_is_checked_again() -> None:
    with stopped_by_the_check() as (daemon, drive, plc):
        drive.do(lambda node: setattr(node, "rpm_per_unit", 1.0))
        plc.endpoint.set(0, {"STW1": ON | ACKNOWLEDGE})
        _for_a_second(plc)
        assert drive.node.rpm == 0, "a standing ON starts nothing"
        plc.endpoint.set(0, {"STW1": OFF})
        _for_a_second(plc)
        plc.enable()
        plc.until(lambda: abs(drive.node.rpm - 3000 / 64) < 1, "the speed that was asked for")
        drive.do(lambda node: setattr(node, "rpm_per_unit", 8.0))
        plc.until(lambda: daemon.axes[0].outputs.reason is Reason.UNITS_CONTRADICTED, "stopped again")


@pytest.mark.parametrize("index", [0x604B, 0x604C])
def test_factor_of_velocity_mode_that_changes_in_operation_stops_the_axis(index: int) -> None:
    with turning_in_velocity_mode() as (daemon, drive, plc):
        drive.do(lambda node: node.values.__setitem__((index, 1), 10))
        drive.do(lambda node: setattr(node, "rpm_per_unit", 10.0))
        plc.until(lambda: daemon.axes[0].faults, "the fault")
        assert daemon.axes[0].faults[0].number == FaultNumber.VELOCITY
        assert f"{index:04X}h/1 was 1h and is Ah now" in daemon.axes[0].faults[0].text


def test_factor_that_could_not_be_read_for_a_moment_is_still_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    with turning_in_velocity_mode() as (daemon, drive, plc):
        read, aborted = drive.node.get_data, 0

        def not_now(index: int, subindex: int, check_readable: bool = False) -> bytes:
            nonlocal aborted
            if (index, subindex) == (0x604B, 1) and not aborted:
                aborted += 1
                raise SdoAbortedError(Abort.CANNOT_STORE_DEVICE_STATE)
            return read(index, subindex, check_readable)

        monkeypatch.setattr(drive.node, "get_data", not_now)
        plc.until(lambda: aborted, "an abort")
        drive.do(lambda node: node.values.__setitem__((0x604B, 1), 10))
        plc.until(lambda: daemon.axes[0].faults, "the fault")
        assert "604Bh/1 was 1h and is Ah now" in daemon.axes[0].faults[0].text


def test_no_unit_is_read_during_a_job() -> None:
    """It could be read between two accesses of the job, which may change it."""
    with turning_in_velocity_mode() as (daemon, _drive, plc):
        requests: list[bytes] = []

        def listen(message: can.Message) -> None:
            if not message.is_rx and message.arbitration_id == SDO_REQUEST + 1:
                requests.append(bytes(message.data))

        (network,) = daemon.networks.values()
        network.listeners.append(listen)
        release = Event(daemon.loop)
        daemon.axes[0].drive.submit(lambda _: release.wait())
        plc.exchange()
        requests.clear()
        _for_a_second(plc)
        assert requests == []
        release.set()
        _for_a_second(plc)
        assert len(requests) >= 5


def test_units_that_could_not_be_read_again_are_read_before_the_next_start() -> None:
    tenths = Law(0.1, objects={**_OBJECTS, (0x60A9, 0): 0xFFB4_4700})
    with running(configuration(axis(1, more=""))) as daemon:
        drive = OwnLawDrive(world_of(daemon), "world", 1, tenths)
        online(daemon)
        plc = Plc(daemon, [1])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": 0x0100})
        plc.until(lambda: abs(drive.node.rpm - 3000 / 64) < 1, "the speed that was asked for")
        drive.do(lambda node: node.start_fault("slow-sdo", delay_ms=10))
        drive.do(lambda node: node.values.__setitem__((0x60A9, 0), _OBJECTS[0x60A9, 0]))
        drive.do(lambda node: setattr(node, "rpm_per_unit", 1.0))
        plc.until(lambda: daemon.axes[0].faults, "the fault")
        drive.do(lambda node: node.start_fault("sdo-timeout"))
        for _ in range(2):
            _for_a_second(plc)
        drive.do(lambda node: node.end_fault())
        for _ in range(2):
            _for_a_second(plc)
        for word in (ON | ACKNOWLEDGE, OFF):
            plc.endpoint.set(0, {"STW1": word})
            _for_a_second(plc)
        plc.enable()
        drive.do(lambda node: setattr(node, "fastest", 0.0))
        _for_a_second(plc)
        assert drive.node.fastest == pytest.approx(3000 / 64, rel=0.02)
        assert drive.node.rpm == pytest.approx(3000 / 64, rel=0.02)


@pytest.mark.parametrize("clients", [1, 2])
def test_clients_that_read_all_the_time_do_not_end_the_check(clients: int) -> None:
    """The drive has no TPDO with 6064h, and each answer comes during the access of a client."""
    with running(configuration(axis(1, more=""))) as daemon:
        OwnLawDrive(world_of(daemon), "world", 1, WRONG_LAW)
        client = daemon.axes[0].drive
        online(daemon)
        plc = Plc(daemon, [1])
        plc.enable()

        def read_until_stopped() -> None:
            while not daemon.axes[0].faults:
                daemon.loop.result(client.submit(lambda node: node.sdo.read(0x6080)))

        for number in range(clients):
            daemon.loop.spawn(read_until_stopped, f"client {number}")
        plc.endpoint.set(0, {"NSOLL_A": 0x0100})
        _for_a_second(plc)
        assert [fault.number for fault in daemon.axes[0].faults] == [FaultNumber.VELOCITY]


@pytest.mark.parametrize("delay_ms", [60, 180])
def test_slow_sdo_answers_make_the_check_slower_and_not_blind(delay_ms: int) -> None:
    """The drive has no TPDO with 6064h. A step is five times as long as an answer, and four steps count."""
    with running(configuration(axis(1, more=""))) as daemon:
        drive = OwnLawDrive(world_of(daemon), "world", 1, WRONG_LAW)
        online(daemon)
        plc = Plc(daemon, [1])
        plc.enable()
        drive.do(lambda node: node.start_fault("slow-sdo", delay_ms=delay_ms))
        plc.endpoint.set(0, {"NSOLL_A": 0x0100})
        began = daemon.loop.now()
        plc.until(lambda: daemon.axes[0].faults, "the fault")
        assert daemon.axes[0].faults[0].number == FaultNumber.VELOCITY
        assert daemon.loop.now() - began <= 5 * 5 * delay_ms * MS + SECOND


@pytest.mark.parametrize("delay_ms", [1, 60, 180])
def test_slow_sdo_answers_are_not_contradictions(delay_ms: int) -> None:
    with running(configuration(axis(1, more=""))) as daemon:
        drive = OwnLawDrive(world_of(daemon), "world", 1, Law(1.0, objects=_OBJECTS))
        online(daemon)
        plc = Plc(daemon, [1])
        plc.enable()
        drive.do(lambda node: node.start_fault("slow-sdo", delay_ms=delay_ms))
        plc.endpoint.set(0, {"NSOLL_A": 0x0100})
        for _ in range(5):
            _for_a_second(plc)
        assert not daemon.axes[0].faults
        assert drive.node.rpm == pytest.approx(3000 / 64, rel=0.01)
