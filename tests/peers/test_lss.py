"""Simulated nodes with LSS and with values that have habits, asked by python canopen: its ``LssMaster`` and its SDO client."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import canopen.lss
import pytest
from canopen.lss import LssError

from pdgw.base.durations import SECOND
from pdgw.ds301.communication import SAVE_SIGNATURE
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.world import World
from tests.support.gateways.canopen_master import Master, master

BUS = "machine"
CONFIGURED = {"lss": {}}
NEW = {"lss-without-node-id": {}}


class Machine:
    """A bus with drives, and canopen as its master."""

    def __init__(self, world: World, network: Master) -> None:
        self.world = world
        self.network = network
        self.lss = network.lss
        self.lss.RESPONSE_TIMEOUT = 0.05
        self.boots: list[int] = []
        for node_id in range(1, 128):
            network.subscribe(0x700 + node_id, lambda can_id, data, _: self._beat(can_id - 0x700, data))

    def _beat(self, node_id: int, data: bytes) -> None:
        if data == b"\0":
            self.boots.append(node_id)

    def drive(self, node_id: int, serial: int, habits: dict[str, Any], **options: Any) -> SimulatedDrive:
        drive = self.world.drive(BUS, node_id, serial_number=serial, habits=habits, **options)
        self.world.loop.run_for(SECOND // 100)
        return drive

    def select(self, drive: SimulatedDrive) -> bool:
        identity = [int(drive.node.values[0x1018, sub]) for sub in range(1, 5)]
        return bool(self.lss.send_switch_state_selective(*identity))

    def serial(self, node_id: int) -> int:
        """1018h/4 by SDO."""
        return int.from_bytes(self.network.add_node(node_id).sdo.upload(0x1018, 4), "little")


@pytest.fixture
def machine() -> Iterator[Machine]:
    with _machine() as made:
        yield made


@contextmanager
def _machine() -> Iterator[Machine]:
    world = World()
    with master(world, BUS) as network:
        yield Machine(world, network)


def test_a_device_without_node_id_answers_lss_alone(machine: Machine) -> None:
    machine.drive(5, 0x1234, NEW)
    assert machine.boots == []
    with pytest.raises(canopen.SdoCommunicationError):
        machine.serial(5)
    found, identity = machine.lss.fast_scan()
    assert found
    assert identity[3] == 0x1234
    assert machine.lss.inquire_node_id() == 0xFF
    assert machine.lss.inquire_lss_address(canopen.lss.CS_INQUIRE_SERIAL_NUMBER) == 0x1234


def test_a_fastscan_finds_each_device_without_node_id_once(machine: Machine) -> None:
    for node_id, serial in ((5, 0xFFFF_FFFF), (6, 0), (7, 0x8000_0001), (8, 77)):
        machine.drive(node_id, serial, NEW)
    machine.drive(9, 5, CONFIGURED)
    found = []
    while (answer := machine.lss.fast_scan())[0]:
        found.append(answer[1][3])
    assert sorted(found) == [0, 77, 0x8000_0001, 0xFFFF_FFFF]
    machine.lss.send_switch_state_global(machine.lss.WAITING_STATE)
    machine.lss.send_identify_non_configured_remote_slave()
    machine.world.loop.run_for(SECOND // 10)
    assert machine.lss.responses.qsize() == 4
    assert machine.boots == [9]


def test_a_new_node_id_is_in_force_in_waiting_state_and_kept_if_stored(machine: Machine) -> None:
    drive = machine.drive(5, 77, NEW)
    for stores, after in ((False, []), (True, [3])):
        assert machine.select(drive)
        machine.lss.configure_node_id(3)
        if stores:
            machine.lss.store_configuration()
        machine.boots.clear()
        machine.lss.send_switch_state_global(machine.lss.WAITING_STATE)
        machine.world.loop.run_for(SECOND // 10)
        assert machine.boots == [3]
        assert machine.serial(3) == 77
        machine.boots.clear()
        drive.do(lambda node: node.power_off())
        drive.do(lambda node: node.restart())
        machine.world.loop.run_for(SECOND // 10)
        assert machine.boots == after


def test_a_configured_device_takes_its_new_node_id_by_reset_communication(machine: Machine) -> None:
    drive, other = machine.drive(5, 77, CONFIGURED), machine.drive(6, 78, CONFIGURED)
    assert machine.select(drive)
    machine.lss.configure_node_id(3)
    machine.lss.send_switch_state_global(machine.lss.WAITING_STATE)
    assert machine.serial(5) == 77
    machine.network.send_message(0, bytes((130, 5)))
    machine.world.loop.run_for(SECOND // 10)
    assert machine.boots == [5, 6, 3]
    assert machine.serial(3) == 77
    assert machine.serial(6) == int(other.node.values[0x1018, 4])


@pytest.mark.parametrize(
    ("habit", "values", "service", "fails"),
    [
        ("lss", {"store_fails": 1}, lambda lss: lss.store_configuration(), "LSS Error: 2"),
        ("lss", {"store_ms": 1000}, lambda lss: lss.store_configuration(), "No LSS response"),
        ("lss", {"bit_timing": 0}, lambda lss: lss.configure_bit_timing(4), "LSS Error: 1"),
        ("lss", {}, lambda lss: lss.configure_bit_timing(9), "LSS Error: 1"),
        ("lss", {}, lambda lss: lss.configure_node_id(0), "LSS Error: 1"),
    ],
)
def test_a_service_that_fails_says_so(
    machine: Machine, habit: str, values: dict[str, int], service: Any, fails: str
) -> None:
    assert machine.select(machine.drive(5, 77, {habit: values}))
    with pytest.raises(LssError, match=fails):
        service(machine.lss)


def test_a_device_in_operation_answers_no_lss(machine: Machine) -> None:
    drive = machine.drive(5, 77, CONFIGURED)
    machine.network.send_message(0, bytes((1, 5)))
    with pytest.raises(LssError):
        machine.select(drive)


def test_frames_at_another_bit_rate_are_error_frames_to_all() -> None:
    world = World()
    bus = world.bus(BUS, 500_000)
    errors: list[str] = []
    listener = bus.join("listener")
    listener.start(_Counting(errors))
    drive = world.drive(BUS, 5, serial_number=77, habits={"another-bit-rate": {"bitrate": 125_000}})
    world.loop.run_for(SECOND // 10)
    assert len(errors) == 32, "then it is bus-off"
    assert drive.port.bus_off
    listener.send(0x605, bytes.fromhex("4000100000000000"))
    world.loop.run_for(SECOND // 100)
    assert bus.frames == 0, "nobody acknowledges"


class _Counting:
    """A receiver that counts error frames."""

    def __init__(self, errors: list[str]) -> None:
        self._errors = errors

    def on_error_frame(self, *, bus_off: bool, passive: bool) -> None:
        self._errors.append("bus-off" if bus_off else "error")

    def on_frame(self, *_: object) -> None: ...

    def on_other_frame(self, *_: object, **__: object) -> None: ...

    on_room = on_refused = on_lost = on_frame


def test_another_bit_rate_is_in_force_after_its_delay(machine: Machine) -> None:
    drive = machine.drive(5, 77, CONFIGURED)
    assert machine.select(drive)
    machine.lss.configure_bit_timing(3)
    machine.lss.activate_bit_timing(200)
    machine.world.loop.run_for(SECOND // 10)
    with pytest.raises(LssError):
        machine.lss.inquire_node_id()
    machine.world.loop.run_for(SECOND)
    port: Any = drive.port
    assert port.bitrate == 250_000


def test_a_value_that_acts_after_a_restart_is_shown_at_once(machine: Machine) -> None:
    drive = machine.drive(5, 77, {"acts-after-restart": {"index": 0x6083}})
    node = machine.network.add_node(5)
    before = drive.node.model.profile_acceleration
    node.sdo.download(0x6083, 0, (4321).to_bytes(4, "little"))
    assert int.from_bytes(node.sdo.upload(0x6083, 0), "little") == 4321
    assert drive.node.model.profile_acceleration == before
    drive.do(lambda device: device.restart())
    assert int.from_bytes(node.sdo.upload(0x6083, 0), "little") == before
    node.sdo.download(0x6083, 0, (4321).to_bytes(4, "little"))
    node.sdo.download(0x1010, 1, SAVE_SIGNATURE.to_bytes(4, "little"))
    drive.do(lambda device: device.restart())
    machine.world.loop.run_for(SECOND // 10)
    assert int.from_bytes(node.sdo.upload(0x6083, 0), "little") == 4321
    assert drive.node.model.profile_acceleration == 4321


def test_1020h_is_kept_by_storing_and_else_lost_at_power_off(machine: Machine) -> None:
    drive = machine.drive(5, 77, {"verify-configuration": {}})
    node = machine.network.add_node(5)
    node.sdo.download(0x1020, 1, (15000).to_bytes(4, "little"))
    node.sdo.download(0x1010, 1, SAVE_SIGNATURE.to_bytes(4, "little"))
    node.sdo.download(0x1020, 1, bytes(4))
    drive.do(lambda device: device.restart())
    machine.world.loop.run_for(SECOND // 10)
    assert int.from_bytes(node.sdo.upload(0x1020, 1), "little") == 15000
