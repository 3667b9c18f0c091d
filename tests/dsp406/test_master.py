"""Simulated encoders: configured and read by canopen as an independent master, and on the shaft of a simulated drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import canopen
import pytest
from canopen.pdo.base import PdoMap
from canopen.sdo import SdoAbortedError

from pdgw.ds301.configuration import map_pdo
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.dsp406.device import eds_path
from pdgw.dsp406.kinds import DEVICES, ROTARY, EncoderDevice
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.peers.encoder import Motion, SimulatedEncoderNode
from pdgw.peers.encoder.motion import Follower, still
from pdgw.peers.node.node import MS, NmtCommand, SimulatedNode
from pdgw.peers.world import World
from tests.support.gateways.canopen_master import Master, master

NODE = 11


class Site:
    """canopen's network and node, and the simulated encoder."""

    def __init__(self, world: World, network: Master, device: EncoderDevice) -> None:
        self.network = network
        self.until = world.loop.until
        self.encoder = world.encoder("a", NODE, powered=False, device=device, motions=[still(1.0)])
        self.node = self.network.add_node(NODE, str(eds_path(device)))
        self.encoder.start()
        self.until(lambda: self.node.nmt.state == "PRE-OPERATIONAL", "boot-up")


@pytest.fixture
def make() -> Iterator[Callable[[EncoderDevice], Site]]:
    world = World()
    with master(world, "a") as network:
        yield lambda device: Site(world, network, device)


@pytest.fixture
def rotary(make: Callable[[EncoderDevice], Site]) -> Site:
    return make(ROTARY)


@pytest.mark.parametrize("device", DEVICES.values(), ids=lambda device: device.name)
def test_every_object_of_the_eds_is_there_with_its_default(
    make: Callable[[EncoderDevice], Site], device: EncoderDevice
) -> None:
    node = make(device).node
    changing = {0x1003, 0x6004, 0x6020, 0x6500, 0x6508}
    for index in node.object_dictionary:
        variables = node.object_dictionary[index]
        for subindex in getattr(variables, "subindices", {0: variables}):
            variable = node.object_dictionary.get_variable(index, subindex)
            assert variable is not None
            if index in changing or isinstance(variable.default, str):
                continue
            found = node.sdo.upload(index, subindex)
            signed = variable.data_type in canopen.objectdictionary.datatypes.SIGNED_TYPES
            assert int.from_bytes(found, "little", signed=signed) == variable.default, hex(index)


def test_scaling_and_preset_by_sdo(rotary: Site) -> None:
    sdo = rotary.node.sdo
    assert sdo[0x1000].raw == 0x0002_0196
    assert sdo["Position value"].raw == 4096
    sdo["Measuring units per revolution"].raw = 360
    sdo["Total measuring range in measuring units"].raw = 3600
    sdo["Operating parameters"].bits[2] = 1
    assert sdo["Position value"].raw == 360
    sdo["Preset value"].raw = 5
    assert (sdo["Position value"].raw, sdo["Offset value"].raw) == (5, -355)
    with pytest.raises(SdoAbortedError, match="too high"):
        sdo["Preset value"].raw = 3600
    assert sdo["Cam 8 hysteresis"][1].raw == 0


def test_pdos_by_cyclic_timer_sync_and_remote_request(rotary: Site) -> None:
    node, network = rotary.node, rotary.network
    node.tpdo.read()
    assert [node.tpdo[n].trans_type for n in (1, 3)] == [254, 1]
    assert [node.tpdo[n].map[0].name for n in (1, 3)] == ["Position value"] * 2
    node.nmt.state = "OPERATIONAL"
    rotary.until(lambda: rotary.encoder.node.state.value == 5, "operational")
    received: list[int] = []

    def on(pdo: PdoMap) -> None:
        received.append(1 if pdo.cob_id == 0x180 + NODE else 3)

    for number in (1, 3):
        node.tpdo[number].add_callback(on)
    assert not received
    node.sdo["Cyclic timer"].raw = 5
    rotary.until(lambda: received == [1, 1, 1], "the cyclic timer")
    node.sdo["Cyclic timer"].raw = 0
    received.clear()
    network.sync.transmit()
    rotary.until(lambda: received == [3], "on SYNC")
    node.tpdo[3].remote_request()
    rotary.until(lambda: received == [3, 3], "on request")
    assert node.tpdo[3]["Position value"].raw == 4096


def test_the_master_maps_more_into_a_pdo(rotary: Site) -> None:
    node = rotary.node
    node.tpdo.read()
    pdo = node.tpdo[3]
    pdo.clear()
    for name in ("Position value", "Speed value.Speed value channel 1"):
        pdo.add_variable(name)
    pdo.rtr_allowed = False
    pdo.save()
    assert rotary.encoder.node.read(0x1A02, 2) == 0x6030_0110
    assert rotary.encoder.node.read(0x1802, 1) == 0x4000_0380 + NODE


def test_emergency_nmt_and_heartbeat(rotary: Site) -> None:
    node = rotary.node
    node.sdo["Producer heartbeat time"].raw = 10
    node.nmt.state = "OPERATIONAL"
    node.nmt.wait_for_heartbeat(5)
    rotary.until(lambda: node.nmt.state == "OPERATIONAL", "heartbeat")
    rotary.encoder.inject("memory")
    rotary.until(lambda: node.emcy.log, "EMCY")
    assert [(error.code, error.register) for error in node.emcy.log] == [(0x5100, 0x01)]
    assert node.sdo["Alarms"].raw == 1
    assert node.sdo["Pre-defined error field"][1].raw == 0x5100
    rotary.encoder.clear()
    rotary.until(lambda: node.emcy.log[-1].code == 0, "error reset")
    node.nmt.state = "STOPPED"
    rotary.until(lambda: rotary.encoder.node.state.value == 4, "stopped")
    node.nmt.state = "RESET"
    rotary.until(lambda: rotary.encoder.node.state.value == 127, "boot-up")


def test_parameters_are_stored_and_restored(rotary: Site) -> None:
    node = rotary.node

    def reset() -> None:
        node.nmt.send_command(0x81)  # what is asked next comes after it on the bus

    node.sdo["Measuring units per revolution"].raw = 100
    node.store()
    reset()
    assert node.sdo["Measuring units per revolution"].raw == 100
    node.restore()
    reset()
    assert node.sdo["Measuring units per revolution"].raw == 4096


# -- on the shaft of a drive ------------------------------------------------------------------------------------------


DRIVE, ENCODER = 4, 9
INCREMENTS = 4096
TPDO = next(pdo for pdo in LAYOUTS[Operation.POSITIONING].tpdos if "position_actual" in pdo.attributes)
RPM = 300


class Shaft:
    """A drive and an encoder joined without bus or thread; the drive turns at ``RPM``."""

    def __init__(self, make: Callable[[SimulatedDriveNode], Motion]) -> None:
        self.drive = SimulatedDriveNode(DRIVE, lambda *frame: self.pass_on(self.encoder, *frame))
        self.encoder = SimulatedEncoderNode(ENCODER, lambda *_: None, motions=[make(self.drive)])
        self.now = 0
        for node in (self.drive, self.encoder):
            node.start(0)
        for step in map_pdo(TPDO, TPDO.cob_id(DRIVE), event_ms=0):
            self.drive.set_data(step.index, step.subindex, step.data, check_writable=True)
        self.run(2)
        self.drive.receive(0, bytes((NmtCommand.START, 0)), self.now)
        self.write(0x6060, 3)
        self.write(0x60FF, 2 * RPM)  # velocity units of 0.5 rpm
        for word in (0x06, 0x0F):
            self.write(0x6040, word)

    def pass_on(self, node: SimulatedNode, can_id: int, data: bytes) -> None:
        node.receive(can_id, data, self.now)

    def write(self, index: int, value: int) -> None:
        entry = self.drive.entry(index, 0)
        self.drive.set_data(index, 0, value.to_bytes(entry.type.bits // 8, "little"), check_writable=True)

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now += MS
            for node in (self.drive, self.encoder):
                node.poll(self.now)


def _listens(drive: SimulatedDriveNode) -> Motion:
    byte = TPDO.attributes.index("position_actual")
    return Follower(TPDO.cob_id(DRIVE), sum(entry.type.bits // 8 for entry in TPDO.entries[:byte]), INCREMENTS)


def _asks(drive: SimulatedDriveNode) -> Motion:
    return lambda _: drive.model.position_actual / INCREMENTS


@pytest.mark.parametrize("make", [_listens, _asks])
def test_the_encoder_has_position_and_speed_of_the_drive(make: Callable[[SimulatedDriveNode], Motion]) -> None:
    shaft = Shaft(make)
    shaft.run(1500)
    model = shaft.drive.model
    assert model.velocity_actual == 2 * RPM
    assert int(shaft.encoder.read(0x6004)) == pytest.approx(model.position_actual, abs=1)
    assert shaft.encoder.read(0x6030, 1) == pytest.approx(RPM / 60 * 4096, rel=0.01)
