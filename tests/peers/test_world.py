"""Buses and networks in virtual time: who is heard when, what errors do, and that one seed is one run."""

from __future__ import annotations

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.can_frame import EXTENDED, REMOTE
from pdgw.ds301.bus.load import frame_bits
from pdgw.ds301.bus.port import PortBusyError, PortLostError
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.peers.world import Conditions, Member, World

BITRATE = 500_000
FULL = frame_bits(8) * SECOND // BITRATE
"""Nanoseconds of a frame with 8 bytes."""


class Ear:
    """A receiver that notes what it hears, with the time."""

    def __init__(self, world: World, port: Member) -> None:
        self.world = world
        self.port = port
        self.frames: list[tuple[int, int]] = []
        self.others: list[tuple[int, bool, bool]] = []
        self.errors: list[tuple[bool, bool]] = []
        self.lost = ""
        port.start(self)

    @property
    def identifiers(self) -> list[int]:
        return [can_id for _, can_id in self.frames]

    def on_frame(self, can_id: int, data: bytes, now: int) -> None:
        self.frames.append((self.world.loop.now(), can_id))

    def on_other_frame(self, can_id: int, data: bytes, *, extended: bool, remote: bool) -> None:
        self.others.append((can_id, extended, remote))

    def on_error_frame(self, *, bus_off: bool, passive: bool) -> None:
        self.errors.append((bus_off, passive))

    def on_room(self) -> None:
        """A test sends what was refused again by itself."""

    def on_refused(self) -> None:
        raise AssertionError("a simulated controller takes a frame or refuses it at once")

    def on_lost(self, text: str) -> None:
        self.lost = text


class Bus:
    """Three members that hear each other."""

    def __init__(self) -> None:
        self.world = World()
        self.loop = self.world.loop
        self.can = self.world.bus("a", BITRATE)
        self.a, self.b, self.c = (Ear(self.world, self.can.join(name)) for name in "abc")


@pytest.fixture
def bus() -> Bus:
    return Bus()


def test_frame_is_received_by_all_others_after_its_bit_time(bus: Bus) -> None:
    begin = bus.loop.now()
    bus.a.port.send(0x181, bytes(8))
    bus.loop.run_for(SECOND)
    assert bus.b.frames == bus.c.frames == [(begin + FULL, 0x181)]
    assert bus.a.frames == []


def test_lowest_identifier_wins_the_arbitration(bus: Bus) -> None:
    bus.a.port.send(0x701, b"")
    bus.b.port.send(0x081, b"")
    bus.c.port.send(0x181, b"")
    bus.loop.run_for(SECOND)
    assert bus.a.identifiers == [0x081, 0x181]
    assert bus.b.identifiers == [0x181, 0x701]


def test_a_frame_under_way_is_not_interrupted_and_a_queue_keeps_its_order(bus: Bus) -> None:
    bus.a.port.send(0x701, bytes(8))
    bus.a.port.send(0x081, b"")
    bus.loop.run_for(FULL // 2)
    bus.b.port.send(0x181, b"")
    bus.loop.run_for(SECOND)
    assert bus.c.identifiers == [0x701, 0x081, 0x181]


def test_arbitration_prefers_standard_and_data_frames(bus: Bus) -> None:
    bus.a.port.send(0x181 << 18 | EXTENDED, b"")
    bus.b.port.send(0x181 | REMOTE, b"")
    bus.c.port.send(0x181, b"")
    bus.loop.run_for(SECOND)
    assert bus.a.identifiers == [0x181]
    assert bus.a.others == [(0x181, False, True)]
    assert bus.c.others == [(0x181, False, True), (0x181 << 18, True, False)]


def test_an_answer_given_while_a_frame_is_delivered_waits_for_its_arbitration(bus: Bus) -> None:
    bus.b.on_frame = lambda can_id, data, now: bus.b.port.send(0x581, data)  # type: ignore[method-assign]
    bus.a.port.send(0x601, b"")
    bus.a.port.send(0x081, b"")
    bus.loop.run_for(SECOND)
    assert bus.c.identifiers == [0x601, 0x081, 0x581, 0x581]


def test_single_member_gets_no_acknowledgement_and_its_queue_fills(bus: Bus) -> None:
    bus.a.port.connect(False)
    for number in range(16):
        bus.a.port.send(0x200 + number, b"")
    with pytest.raises(PortBusyError):
        bus.a.port.send(0x300, b"")
    bus.b.port.send(0x181, b"")
    bus.loop.run_for(SECOND)
    assert bus.c.identifiers == [0x181]
    assert bus.a.frames == []
    bus.a.port.connect(True)
    bus.loop.run_for(SECOND)
    assert bus.c.identifiers[1:] == [0x200 + number for number in range(16)], "what waited goes out"


@pytest.mark.parametrize("why", ["its wires are cut", "the others have no power"])
def test_sender_without_acknowledgement_becomes_error_passive_and_never_bus_off(bus: Bus, why: str) -> None:
    if why.startswith("its"):
        bus.a.port.connect(False)
    for port in (bus.b.port, bus.c.port):
        port.power(not why.startswith("the"))
    bus.a.port.send(0x181, bytes(8))
    bus.loop.run_for(10 * FULL)
    assert bus.a.errors == []
    bus.loop.run_for(SECOND)
    assert bus.a.errors == [(False, True)], "reported once"
    assert len(bus.a.port.queue) == 1
    bus.a.port.send(0x182, b"")
    bus.a.port.connect(True)
    bus.c.port.power(True)
    bus.loop.run_for(SECOND)
    assert bus.c.identifiers == [0x181, 0x182]
    assert not bus.a.port.bus_off


def test_member_without_power_loses_its_queue_and_frames_need_another_one(bus: Bus) -> None:
    bus.a.port.connect(False)
    bus.a.port.send(0x181, b"")
    bus.a.port.power(False)
    bus.a.port.connect(True)
    bus.a.port.power(True)
    bus.c.port.power(False)
    bus.b.port.send(0x182, bytes(8))
    bus.loop.run_for(FULL // 2)
    bus.a.port.power(False)
    bus.loop.run_for(SECOND)
    assert (bus.a.identifiers, bus.c.identifiers) == ([], [])
    bus.c.port.power(True)
    bus.loop.run_for(SECOND)
    assert bus.c.identifiers == [0x182]


def test_device_acknowledges_from_its_power_on_to_its_power_off() -> None:
    world = World()
    ear = Ear(world, world.bus("a").join("gateway"))
    drive = world.drive("a", 3, powered=False)

    def waiting() -> int:
        ear.port.send(0x80, b"")
        world.loop.run_for(SECOND)
        return len(ear.port.queue)

    assert waiting() == 1
    drive.start()
    assert waiting() == 0
    assert ear.identifiers == [0x703]
    drive.do(lambda node: node.power_off())
    assert waiting() == 1
    drive.do(lambda node: node.restart())
    assert waiting() == 0
    drive.do(lambda node: node.start_fault("reboot", off_ms=5000))
    assert waiting() == 1
    world.loop.run_for(5 * SECOND)
    assert waiting() == 0
    assert ear.identifiers == [0x703] * 3


def test_a_frame_cut_off_under_way_is_repeated_as_a_whole(bus: Bus) -> None:
    bus.a.port.send(0x181, bytes(8))
    bus.loop.run_for(FULL // 2)
    bus.a.port.connect(False)
    bus.loop.run_for(10 * FULL)
    begin = bus.loop.now()
    bus.a.port.connect(True)
    bus.loop.run_for(SECOND)
    assert bus.b.frames == [(begin + FULL, 0x181)]


def test_errors_delay_frames_and_lose_none(bus: Bus) -> None:
    bus.can.error_rate = 0.3
    for number in range(12):
        bus.a.port.send(0x100 + number, bytes(8))
    begin = bus.loop.now()
    bus.loop.run_for(SECOND)
    assert bus.b.identifiers == [0x100 + number for number in range(12)]
    assert bus.b.frames[-1][0] > begin + 12 * FULL
    assert bus.b.errors


def test_controller_with_permanent_errors_is_bus_off_and_recovers(bus: Bus) -> None:
    bus.can.error_rate = 1.0
    bus.a.port.send(0x181, b"")
    bus.loop.until(lambda: bus.a.port.bus_off, "bus-off")
    assert bus.a.errors[-1] == (True, True)
    with pytest.raises(PortBusyError):
        bus.a.port.send(0x182, b"")
    bus.can.error_rate = 0.0
    bus.loop.run_for(200 * MS)
    bus.a.port.send(0x183, b"")
    bus.loop.run_for(SECOND)
    assert bus.b.identifiers == [0x183], "what was queued before is gone"


def test_short_circuit_stops_every_sender(bus: Bus) -> None:
    bus.a.port.send(0x181, bytes(8))
    bus.loop.run_for(FULL // 2)
    bus.can.short(True)
    bus.loop.run_for(MS)
    bus.b.port.send(0x281, b"")
    bus.loop.run_for(SECOND)
    assert (bus.a.port.bus_off, bus.b.port.bus_off, bus.c.port.bus_off) == (True, True, False)
    assert bus.c.frames == []
    bus.can.short(False)
    bus.loop.run_for(200 * MS)
    bus.a.port.send(0x182, b"")
    bus.loop.run_for(SECOND)
    assert bus.c.identifiers == [0x182]


def test_closed_member_sends_its_queue_before_it_leaves(bus: Bus) -> None:
    bus.b.port.send(0x081, bytes(8))
    for can_id in (0x181, 0x000):
        bus.a.port.send(can_id, bytes(8))
    bus.a.port.close()
    assert bus.a.port in bus.can.members
    bus.loop.run_for(SECOND)
    assert bus.c.identifiers == [0x081, 0x181, 0x000]
    assert bus.a.port not in bus.can.members
    assert bus.a.frames == [], "who has closed hears nothing"
    bus.b.port.close()
    bus.c.port.send(0x201, b"")
    bus.loop.run_for(SECOND)
    assert len(bus.c.port.queue) == 1, "nobody is left to acknowledge it"


def test_closed_member_with_permanent_errors_leaves_at_bus_off(bus: Bus) -> None:
    bus.can.error_rate = 1.0
    bus.a.port.send(0x181, b"")
    bus.a.port.close()
    bus.loop.until(lambda: bus.a.port not in bus.can.members, "gone")
    assert bus.b.frames == []


def test_unplugged_interface_loses_its_queue() -> None:
    world = World()
    ear = Ear(world, world.bus("a", BITRATE).join("node"))
    world.open_can(CanConfig(interface="virtual", channel="a")).send(0x181, bytes(8))
    world.loop.run_for(FULL // 2)
    world.unplug("a")
    world.loop.run_for(SECOND)
    assert ear.frames == []


def test_unplugged_interface_is_reported_and_cannot_be_opened() -> None:
    world = World()
    config = CanConfig(interface="virtual", channel="a")
    ear = Ear(world, world.open_can(config))
    world.unplug("a")
    assert ear.lost == "unplugged"
    with pytest.raises(PortLostError):
        ear.port.send(0x181, b"")
    with pytest.raises(CanopenError, match="plugged in"):
        world.open_can(config)
    world.unplug("a", False)
    world.open_can(config).send(0x181, b"")


# -- the network ----------------------------------------------------------------------------------------------------------


class Hosts:
    """Two ports and what arrives at the second."""

    def __init__(self, seed: int, **conditions: float) -> None:
        self.world = World(seed)
        self.network = self.world.network
        self.network.conditions = Conditions(**conditions)  # type: ignore[arg-type]
        self.a, self.b = (self.network.open(name, 100, "test") for name in "ab")
        self.heard: list[int] = []
        self.b.start(self._take)

    def _take(self) -> None:
        datagram = self.b.receive()
        assert datagram is not None
        self.heard.append(datagram[0][0])

    def send(self, count: int = 200) -> list[int]:
        for number in range(count):
            self.a.send(bytes([number]), self.b.address)
            self.world.loop.run_for(MS)
        self.world.loop.run_for(SECOND)
        return self.heard


def test_undisturbed_network_delivers_everything_in_order() -> None:
    assert Hosts(1).send() == list(range(200))


def test_loss_duplication_and_overtaking() -> None:
    lossy = Hosts(1, loss=0.5).send()
    assert 50 < len(lossy) < 150
    assert lossy == sorted(lossy)
    doubled = Hosts(1, duplication=0.5).send()
    assert set(doubled) == set(range(200))
    assert 250 < len(doubled) < 350
    overtaken = Hosts(1, jitter_ns=5 * MS).send()
    assert overtaken != sorted(overtaken)
    assert sorted(overtaken) == list(range(200))


def test_disconnected_host_receives_nothing() -> None:
    hosts = Hosts(1)
    hosts.network.cut("b")
    hosts.send(3)
    hosts.network.cut("b", False)
    assert hosts.send(2) == [0, 1]


def test_a_sender_may_use_its_buffer_again() -> None:
    hosts = Hosts(1)
    buffer = bytearray(b"\x07")
    hosts.a.send(buffer, hosts.b.address)
    buffer[0] = 9
    hosts.world.loop.run_for(SECOND)
    assert hosts.heard == [7]


def test_used_port_is_rejected_and_free_again_after_its_end() -> None:
    network = World().network
    port = network.open("a", 100, "cyclic port")
    with pytest.raises(GatewayError, match="cyclic port: a port 100 cannot be used"):
        network.open("a", 100, "cyclic port")
    port.close()
    network.open("a", 100, "cyclic port")
    assert network.open("a", 0, "free").address != network.open("a", 0, "free").address


# -- one seed, one run ----------------------------------------------------------------------------------------------------


def life(seed: int) -> list[tuple[int, str, int, bytes]]:
    """Two drives and an encoder on a disturbed bus, and everything that went over it."""
    world = World(seed)
    can = world.bus("a")
    log: list[tuple[int, str, int, bytes]] = []
    can.taps.append(lambda now, member, can_id, data: log.append((now, member.name, can_id, data)))
    can.error_rate = 0.2
    drives = [world.drive("a", node) for node in (1, 2)]
    world.encoder("a", 3)
    master = can.join("master")
    for node in (1, 2, 3):
        master.send(0, bytes((1, node)))
    world.loop.run_for(200 * MS)
    drives[0].do(lambda node: node.start_fault("emcy-burst"))
    world.loop.run_for(SECOND)
    return log


def test_one_seed_is_one_run_bit_for_bit_and_another_is_another() -> None:
    first = life(7)
    assert len(first) > 50
    assert first == life(7)
    assert first != life(8)
