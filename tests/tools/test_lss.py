"""``pdgw bus assign`` and ``pdgw bus scan``: devices without a node-ID in a world, python canopen as the master of LSS."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import canopen
import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import LSS_REQUEST
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.commissioning.node_ids import look_before
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.world import World
from pdgw.tools.commissioning.bit_rates import hints, listen
from pdgw.tools.commissioning.lss import Identity, LssBus
from tests.support.gateways.canopen_master import Master, master

BUS = "machine"
NEW = {"lss-without-node-id": {}}


class Site:
    """A bus with devices, LSS on it, and each LSS request."""

    def __init__(self, world: World, network: Master) -> None:
        self.world = world
        self.lss = LssBus(network)
        self.requests: list[bytes] = []
        world.bus(BUS).taps.append(self._note)

    def _note(self, _now: int, _sender: object, can_id: int, data: bytes) -> None:
        if can_id == LSS_REQUEST:
            self.requests.append(data)

    def drive(self, node_id: int, serial: int, habits: dict[str, Any]) -> SimulatedDrive:
        made = self.world.drive(BUS, node_id, serial_number=serial, habits=habits)
        self.world.loop.run_for(SECOND // 100)
        return made

    def look(self, node_id: int, old: int | None = None) -> Identity | None:
        config = CanConfig(interface="virtual", channel=BUS)
        network = CanNetwork(self.world.loop, lambda: self.world.open_can(config))
        network.start()
        try:
            return self.world.loop.complete(lambda: look_before(network, node_id, old))
        finally:
            network.close()

    @property
    def in_configuration(self) -> list[int]:
        """Requests that put all devices into configuration state."""
        return [place for place, data in enumerate(self.requests) if data[:2] == b"\x04\x01"]


@pytest.fixture
def site() -> Iterator[Site]:
    world = World()
    with master(world, BUS) as network:
        yield Site(world, network)


def _identity(drive: SimulatedDrive) -> Identity:
    first, second, third, fourth = (int(drive.node.values[0x1018, sub]) for sub in range(1, 5))
    return first, second, third, fourth


def _restarted(site: Site, drive: SimulatedDrive) -> int:
    """Its node-ID after a time without power."""
    drive.do(lambda node: node.power_off())
    drive.do(lambda node: node.restart())
    site.world.loop.run_for(SECOND // 10)
    return drive.node.node_id


def test_devices_without_a_node_id_are_listed_and_waiting_again(site: Site) -> None:
    drives = [site.drive(node_id, serial, NEW) for node_id, serial in ((5, 77), (6, 0xFFFF_FFFF), (7, 1))]
    site.drive(8, 2, {"lss": {}})
    with site.lss.opened():
        assert sorted(site.lss.non_configured()) == sorted(map(_identity, drives))
        assert sorted(site.lss.non_configured()) == sorted(map(_identity, drives))
    site.world.loop.run_for(SECOND)
    assert not site.in_configuration
    assert site.requests[-1][:2] == b"\x04\x00"


def test_a_bus_without_such_a_device_is_asked_once(site: Site) -> None:
    site.drive(8, 2, {"lss": {}})
    with site.lss.opened():
        assert site.lss.non_configured() == []
    site.world.loop.run_for(SECOND)
    assert [data[0] for data in site.requests] == [0x04, 0x4C, 0x04]


def test_a_new_device_gets_a_node_id_that_it_keeps(site: Site) -> None:
    drive, other = site.drive(5, 77, NEW), site.drive(6, 78, NEW)
    assert site.look(3) is None
    with site.lss.opened():
        assert site.lss.assign(_identity(drive), 3, None, None) == ""
    assert _restarted(site, drive) == 3
    with site.lss.opened():
        assert site.lss.non_configured() == [_identity(other)]
    assert not site.in_configuration


def test_a_configured_device_gets_another_node_id_and_bit_rate(site: Site) -> None:
    drive, other = site.drive(5, 77, {"lss": {}}), site.drive(6, 78, {"lss": {}})
    assert site.look(3, 5) == _identity(drive)
    with site.lss.opened():
        assert site.lss.assign(_identity(drive), 3, 5, 125_000) == ""
    assert other.node.node_id == 6
    assert drive.port.bitrate == 1_000_000  # type: ignore[attr-defined]
    site.lss._network.on_error_frame = lambda **_: None
    assert _restarted(site, drive) == 3
    assert drive.port.bitrate == 125_000  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("habit", "bitrate", "says", "node_id"),
    [
        ({"lss": {"bit_timing": 0}}, 125_000, "bit rate 125000 is refused", 5),
        ({}, None, "no answer to its identity: it has no LSS, or is in operation", 5),
    ],
)
def test_a_device_that_takes_nothing_keeps_what_it_had(
    site: Site, habit: dict[str, Any], bitrate: int | None, says: str, node_id: int
) -> None:
    drive = site.drive(5, 77, habit)
    with pytest.raises(GatewayError, match=says), site.lss.opened():
        site.lss.assign(_identity(drive), 3, 5, bitrate)
    site.world.loop.run_for(SECOND // 10)
    assert (drive.node.node_id, _restarted(site, drive)) == (node_id, 5)
    assert site.requests[-1][:2] == b"\x04\x00"


def test_another_device_that_answers_at_the_new_node_id_is_named(site: Site) -> None:
    drive, other = site.drive(5, 77, {"lss": {}}), site.drive(3, 78, {})
    with pytest.raises(GatewayError, match=r"node 3 is another device: .* serial number 0000004Eh"), site.lss.opened():
        site.lss.assign(_identity(drive), 3, 5, None)
    assert other.node.node_id == 3


def test_a_device_that_stores_slowly_is_waited_for(site: Site) -> None:
    drive = site.drive(5, 77, {"lss": {"store_ms": 3000}})
    with site.lss.opened():
        assert site.lss.assign(_identity(drive), 3, 5, None) == ""
    assert _restarted(site, drive) == 3


def test_a_device_that_does_not_store_is_named(site: Site) -> None:
    drive = site.drive(5, 77, {"lss": {"store_fails": 1}})
    with site.lss.opened():
        failed = site.lss.assign(_identity(drive), 3, 5, None)
    assert failed == "not stored (LSS Error: 2): the device loses it at power-off"
    assert drive.node.node_id == 3
    assert _restarted(site, drive) == 5


@pytest.mark.parametrize("place", range(1, 150, 12))
def test_ctrl_c_at_any_request_leaves_all_devices_waiting(site: Site, place: int) -> None:
    drives = [site.drive(5, 77, NEW), site.drive(6, 78, NEW)]
    network: Any = site.lss._network
    send, count = network.send_message, 0

    def interrupted(can_id: int, data: bytes, remote: bool = False) -> None:
        nonlocal count
        count += 1
        if count == place:
            raise KeyboardInterrupt
        send(can_id, data, remote)

    network.send_message = interrupted

    def work() -> None:
        with site.lss.opened():
            site.lss.non_configured()
            site.lss.assign(_identity(drives[0]), 3, None, None)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    site.world.loop.run_for(SECOND)
    network.send_message = send
    site.lss._lss.RESPONSE_TIMEOUT = 0.05
    with pytest.raises(canopen.lss.LssError):
        site.lss._lss.inquire_node_id()
    assert not site.in_configuration


def test_beside_a_master_or_with_a_used_node_id_nothing_is_changed(site: Site) -> None:
    site.drive(3, 7, {})
    with pytest.raises(GatewayError, match="node-ID 3 is used by another device; pdgw bus scan"):
        site.look(3)
    with pytest.raises(GatewayError, match="node-ID 127 is that of the gateway"):
        site.look(127)
    with pytest.raises(GatewayError, match="node 9 does not answer"):
        site.look(4, 9)
    other = site.world.bus(BUS).join("SYNC producer")

    def sync() -> None:
        other.send(0x80, b"")
        site.world.loop.call_later(SECOND // 10, sync)

    sync()
    with pytest.raises(GatewayError, match=r"a master sends SYNC; allowed: none. End the gateway or master"):
        site.look(4)
    assert site.requests == []


def test_other_bit_rates_are_heard_without_a_frame_of_the_adapter() -> None:
    world = World()
    bus = world.bus(BUS, 250_000)
    world.drive(BUS, 5)
    other = bus.join("another device")

    def beat() -> None:
        other.send(0x705, b"\x05")
        world.loop.call_later(SECOND // 10, beat)

    beat()
    config = CanConfig(interface="virtual", channel=BUS, bitrate=500_000)
    lines = list(listen(config, world))
    assert [line.partition(" ")[0] for line in lines] == [
        *("1000000", "800000", "250000", "125000", "50000", "20000", "10000")
    ]
    assert lines[2] == "250000 bit/s: 10 frames heard: this is the bit rate of the bus"
    assert lines[3] == "125000 bit/s: nothing heard, 10 error frames"
    assert not [member for member in bus.members if member.name == "gateway" and member.queue]


def test_socketcan_has_commands_for_the_other_bit_rates() -> None:
    lines = list(listen(CanConfig(interface="socketcan", channel="can1", bitrate=500_000)))
    assert lines[1].startswith(
        "800000 bit/s: sudo ip link set can1 down; sudo ip link set can1 up type can bitrate 800000"
    )
    assert all("listen-only on" in line for line in lines)
    assert next(listen(CanConfig(interface="kvaser", channel="0"))).endswith("set the bit rate and listen by hand")


def test_hints_name_what_the_adapter_reports() -> None:
    world = World()
    world.bus(BUS, 250_000)
    world.drive(BUS, 5)
    config = CanConfig(interface="virtual", channel=BUS, bitrate=500_000)
    network = CanNetwork(world.loop, lambda: world.open_can(config))
    network.start()
    assert next(hints(network, 500_000)).startswith("the adapter reports no error: 500000 bit/s may be right")
    network.send(0x605, bytes(8))
    world.loop.run_for(SECOND)
    text = next(hints(network, 500_000))
    assert text.startswith("the adapter reports 32 error frames")
    assert text.endswith("another bit rate than 500000 bit/s, a wrong termination, or a cable")
