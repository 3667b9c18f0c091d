"""Drives with too few RPDOs: data by SDO first, then the setpoint."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can
import pytest

from pdgw.base.durations import MS
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.bus.port import PortBusyError
from pdgw.ds301.loop.loop import Event
from pdgw.ds301.node.node import Notice
from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive.client import DriveClient
from pdgw.dsp402.drive.images import DriveCommand
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.dsp402.states import ControlBit
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.peers.node.node import Value
from tests.support.drives.plant import NODE, Plant, observe
from tests.support.gateways import site


class TwoPdos:
    """A positioning drive with two RPDOs: 6083h and 6084h are written by SDO. Record the setpoints that the drive receives."""

    def __init__(self, plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
        self.plant = plant
        self.drive = plant.power_on(misbehaves="two-pdos")
        self.client = plant.connected(Operation.POSITIONING, initial_mode=None)
        self.accelerations: list[int] = []
        """6083h at each rising edge of bit 4."""
        self.words: list[int] = []
        """The Controlwords sent."""
        self._bit = False
        self.command = DriveCommand()
        self.now = 0
        plant.network.listeners.append(self._listen)
        self.drive.do(lambda node: monkeypatch.setattr(node, "on_rpdo", self._on_rpdo))

    def _on_rpdo(self, pdo: Pdo) -> None:
        bit = bool(self.drive.model.controlword & ControlBit.NEW_SETPOINT)
        if bit and not self._bit:
            self.accelerations.append(self.drive.model.profile_acceleration)
        self._bit = bit

    def _listen(self, message: can.Message) -> None:
        if not message.is_rx and message.arbitration_id == 0x200 + NODE:
            self.words.append(int.from_bytes(message.data[-2:], "little"))

    def send(self, word: int, acceleration: int | None = None) -> None:
        self.command.controlword = word
        if acceleration is not None:
            self.command.profile_acceleration = acceleration
        self.now += 4 * MS
        self.client.send(self.command, self.now)

    def until(self, condition: Callable[[], object], what: str) -> None:
        def cycle() -> object:
            self.client.send(self.command, self.now)
            return condition()

        site.wait_for(cycle, what)

    @property
    def reported(self) -> list[str]:
        return [event.text for event in self.plant.events if event.notice is Notice.SET_POINT_REFUSED]


@pytest.fixture
def two_pdos(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> TwoPdos:
    return TwoPdos(plant, monkeypatch)


START, ENABLED = 0x003F, 0x002F


def test_a_set_point_starts_with_its_own_data_although_that_goes_by_sdo(two_pdos: TwoPdos) -> None:
    two_pdos.drive.do(lambda node: node.start_fault("slow-sdo", delay_ms=20))
    for acceleration in (100, 200, 300, 200):
        two_pdos.send(ENABLED)
        two_pdos.send(START, acceleration)
        count = len(two_pdos.accelerations)
        two_pdos.until(lambda count=count: len(two_pdos.accelerations) > count, "set-point")
    assert two_pdos.accelerations == [100, 200, 300, 200]
    assert two_pdos.reported == []


def test_delayed_setpoint_does_not_delay_stop_halt_and_acknowledge(two_pdos: TwoPdos) -> None:
    two_pdos.drive.do(lambda node: node.start_fault("sdo-timeout"))
    two_pdos.send(ENABLED)
    for word in (START, START | ControlBit.HALT, 0x003B, 0x003D, 0x00BF, 0x0010):
        two_pdos.send(word, 100)
        assert two_pdos.words[-1] == word & ~ControlBit.NEW_SETPOINT
        assert two_pdos.command.controlword == word, "the image stays the stepper's"


def test_a_set_point_without_new_data_starts_at_once(two_pdos: TwoPdos) -> None:
    two_pdos.send(START, 100)
    two_pdos.until(lambda: two_pdos.accelerations, "set-point")
    two_pdos.send(ENABLED)
    two_pdos.send(START)
    assert two_pdos.words[-2:] == [ENABLED, START]
    two_pdos.send(START, 200)
    two_pdos.send(START | ControlBit.HALT)
    assert two_pdos.words[-1] == START | ControlBit.HALT, "no new edge, nothing to hold back"


def test_alternating_data_does_not_count_as_written(two_pdos: TwoPdos) -> None:
    """The old value comes back while another one is being written: the drive must have it again before the start."""
    two_pdos.send(ENABLED, 100)
    two_pdos.until(lambda: two_pdos.drive.model.profile_acceleration == 100, "written")
    two_pdos.drive.do(lambda node: node.start_fault("slow-sdo", delay_ms=50))
    writing = observe(two_pdos.plant)
    two_pdos.send(ENABLED, 900)
    site.wait_for(lambda: writing, "900 being written")
    two_pdos.send(START, 100)
    two_pdos.until(lambda: two_pdos.accelerations, "set-point")
    assert two_pdos.accelerations == [100]


def test_a_set_point_whose_data_is_refused_does_not_start_and_needs_a_new_edge(two_pdos: TwoPdos) -> None:
    two_pdos.send(ENABLED)
    two_pdos.send(START, 0xFFFF_FFFF)
    two_pdos.until(lambda: two_pdos.client.rpdos.set_point_refused, "refused")
    assert re.fullmatch("not started: .*6083h: .*value.*", two_pdos.reported[0])
    two_pdos.send(START, 500)
    two_pdos.until(lambda: two_pdos.drive.model.profile_acceleration == 500, "good data taken")
    two_pdos.send(START)
    assert (two_pdos.accelerations, two_pdos.words[-1]) == ([], ENABLED)
    two_pdos.send(ENABLED)
    assert not two_pdos.client.rpdos.set_point_refused
    two_pdos.send(START)
    two_pdos.until(lambda: two_pdos.accelerations == [500], "set-point")
    assert len(two_pdos.reported) == 1


def test_a_refused_set_point_may_be_given_again_with_the_same_data(two_pdos: TwoPdos) -> None:
    two_pdos.drive.do(lambda node: node.start_fault("sdo-timeout"))
    two_pdos.send(START, 100)
    two_pdos.until(lambda: two_pdos.client.rpdos.set_point_refused, "no answer")
    assert "6083h" in two_pdos.reported[0]
    two_pdos.drive.do(lambda node: node.end_fault())
    two_pdos.send(ENABLED)
    two_pdos.send(START)
    two_pdos.until(lambda: two_pdos.accelerations == [100], "set-point")


def test_the_wait_for_the_data_of_a_set_point_is_bounded(two_pdos: TwoPdos) -> None:
    release, running = Event(two_pdos.client.loop), Event(two_pdos.client.loop)

    def hold(_: DriveClient) -> None:
        running.set()
        release.wait()

    two_pdos.client.submit(hold)
    site.wait_for(running.is_set, "held")
    two_pdos.send(START, 100)
    two_pdos.now += 596 * MS
    two_pdos.send(START)
    assert two_pdos.reported == []
    two_pdos.send(START)
    assert two_pdos.reported == ["not started: data not written within 600 ms"]
    release.set()
    two_pdos.until(lambda: two_pdos.drive.model.profile_acceleration == 100, "written at last")
    two_pdos.send(START)
    assert two_pdos.accelerations == [], "too late is not at all"


class _DataBySync(SimulatedDriveNode):
    """The transmission type of its RPDO2 is fixed: the values act with the next SYNC."""

    def on_written(self, entry: Entry, value: Value) -> None:
        if entry.address == (0x1401, 2):
            raise SdoAbortedError(Abort.READ_ONLY)
        super().on_written(entry, value)


def _connected_by_sync(plant: Plant, monkeypatch: pytest.MonkeyPatch, **settings: int) -> tuple[DriveClient, list[int]]:
    """A drive whose data acts with SYNC, and its profile velocities at each start of a setpoint."""
    drive = plant.power_on(_DataBySync, {(0x1401, 2): 1})
    client = plant.connected(Operation.POSITIONING, initial_mode=None, **settings)
    seen: list[int] = []
    bit = False

    def on_rpdo(_: Pdo) -> None:
        nonlocal bit
        before, bit = bit, bool(drive.model.controlword & ControlBit.NEW_SETPOINT)
        if bit and not before:
            seen.append(drive.model.profile_velocity)

    monkeypatch.setattr(drive.node, "on_rpdo", on_rpdo)
    return client, seen


@pytest.mark.parametrize(("refresh_ms", "full"), [(100, False), (4, False), (4, True)])
def test_setpoint_waits_for_the_sync_with_which_its_data_acts(
    plant: Plant, monkeypatch: pytest.MonkeyPatch, refresh_ms: int, full: bool
) -> None:
    """Data that is repeated in each cycle does not delay it. ``full``: the bus takes the Controlword later than the data."""
    client, seen = _connected_by_sync(plant, monkeypatch, rpdo_refresh_ms=refresh_ms)
    command = DriveCommand()
    send = plant.network._interface.port.send
    refused = 0

    def send_unless_refused(can_id: int, data: bytes) -> None:
        if can_id == refused:
            raise PortBusyError
        send(can_id, data)

    monkeypatch.setattr(plant.network._interface.port, "send", send_unless_refused)
    for velocity in (100, 900, 200):
        for word in (ENABLED, START):
            command.controlword = word
            if word == START:
                command.profile_velocity = velocity
            for cycle in range(3):
                refused = 0x200 + NODE if full and cycle == 0 else 0
                client.send(command, site.now())
                site.pass_time(MS)
                refused = 0
                plant.network.on_room()
                plant.network.send_sync()
                site.pass_time(4 * MS)
    assert seen == [100, 900, 200]


def test_setpoint_that_was_dropped_with_its_data_does_not_start_toward_the_previous_target(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another node is lost while data, SYNC and Controlword wait in the interface."""
    client, seen = _connected_by_sync(plant, monkeypatch)
    port = site.gateway_port()
    port.droppable = True
    command = DriveCommand()

    def cycles(count: int) -> None:
        for _ in range(count):
            client.send(command, site.now())
            plant.network.send_sync()
            site.pass_time(4 * MS)

    command.controlword, command.profile_velocity = ENABLED, 100
    cycles(3)
    port.connect(False)
    command.controlword, command.profile_velocity = START, 900
    cycles(3)
    plant.network.drop_waiting()
    port.connect(True)
    cycles(3)
    assert seen == [900]


class _PartlyFull:
    """A port that may take no frame of one identifier."""

    def __init__(self, refused: int) -> None:
        self.refused = refused
        self.full = True
        self.sent: list[tuple[int, bytes]] = []

    def send(self, can_id: int, data: bytes) -> None:
        if self.full and can_id == self.refused:
            raise PortBusyError
        self.sent.append((can_id, data))

    def close(self) -> None:
        """Nothing to release."""


@contextmanager
def _starting(plant: Plant, refused: int) -> Iterator[tuple[DriveClient, DriveCommand, _PartlyFull]]:
    """A drive in operation that is about to get a setpoint; the bus refuses one of its frames."""
    client = plant.connected(Operation.POSITIONING, initial_mode=None)
    command = DriveCommand()
    command.controlword = ENABLED
    client.send(command, site.now())
    before = plant.network._interface.port
    plant.network._interface.port = port = _PartlyFull(refused)  # type: ignore[assignment]
    command.controlword = START
    try:
        yield client, command, port
    finally:
        plant.network._interface.port = before


def test_a_set_point_waits_for_an_rpdo_that_the_bus_did_not_take(plant: Plant) -> None:
    with _starting(plant, 0x300 + NODE) as (client, command, port):
        command.profile_velocity = 77
        client.send(command, site.now())
        assert port.sent == []
        port.full = False
        plant.network.on_room()
        data, edge = port.sent
        assert (data[0], data[1][:2], edge[0], edge[1][-2:]) == (0x300 + NODE, b"\x4d\0", 0x200 + NODE, b"\x3f\0")
        port.full = True
        command.profile_velocity = 78
        port.sent.clear()
        client.send(command, site.now())
        assert port.sent == [], "the edge was there: it is not taken back"


DATA_RPDOS = LAYOUTS[Operation.POSITIONING].rpdos[1:]


@pytest.mark.parametrize("late", DATA_RPDOS, ids=str)
def test_setpoint_waits_for_each_of_its_rpdos_not_sent_yet(plant: Plant, late: Pdo) -> None:
    assert len(DATA_RPDOS) > 1
    with _starting(plant, late.cob_id(NODE)) as (client, command, port):
        for pdo in DATA_RPDOS:
            for attribute in pdo.attributes:
                setattr(command, attribute, 77)
        client.send(command, site.now())
        assert 0x200 + NODE not in [can_id for can_id, _ in port.sent]
        port.full = False
        plant.network.on_room()
        order = [can_id for can_id, _ in port.sent]
        assert sorted(order[:-1]) == sorted(pdo.cob_id(NODE) for pdo in DATA_RPDOS)
        assert order[-1] == 0x200 + NODE
