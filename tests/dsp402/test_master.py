"""An independent master: canopen's own CiA 402 profile drives the simulator, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from canopen.profiles.p402 import BaseNode402, OperationMode

from pdgw.peers.drive import Machine, SimulatedDrive
from pdgw.peers.drive.objects import EDS_PATH
from pdgw.peers.world import World
from tests.support.gateways.canopen_master import master

NODE = 6


class Pair:
    """canopen's node and the simulated drive."""

    def __init__(self, world: World, node: BaseNode402) -> None:
        self.node = node
        self.drive: SimulatedDrive = world.drive("a", NODE, machine=Machine(-20_000, 20_000, -30_000, 30_000))
        self.until = world.loop.until
        self.until(lambda: self.drive.node.state.value, "boot-up")
        node.nmt.state = "PRE-OPERATIONAL"
        # p402 waits for a TPDO before it uses a Statusword: send it every 5 ms, changed or not.
        node.sdo[0x1800][5].raw = 5
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"


@pytest.fixture
def pair() -> Iterator[Pair]:
    world = World()
    with master(world, "a") as network:
        node = BaseNode402(NODE, str(EDS_PATH))
        network.add_node(node)
        yield Pair(world, node)


def test_enable_by_the_independent_master(pair: Pair) -> None:
    node = pair.node
    node.state = "OPERATION ENABLED"
    assert node.state == "OPERATION ENABLED"
    node.state = "SWITCH ON DISABLED"
    assert node.state == "SWITCH ON DISABLED"


def test_fault_reset_by_the_independent_master(pair: Pair) -> None:
    node, drive = pair.node, pair.drive
    node.state = "OPERATION ENABLED"
    drive.inject(7)
    pair.until(lambda: node.state == "FAULT", "fault")
    assert node.sdo[0x200C].raw == 7
    assert [error.code for error in node.emcy.log] == [0x2310]
    drive.clear()
    node.reset_from_fault()
    pair.until(lambda: node.state != "FAULT", "fault reset")


def test_homing_by_the_independent_master(pair: Pair) -> None:
    node, drive = pair.node, pair.drive
    node.sdo[0x6098].raw = 17
    node.sdo[0x6099][1].raw = 6000
    node.sdo[0x6099][2].raw = 3000
    assert node.homing(timeout=20)
    assert node.is_homed()
    assert drive.model.machine_position == pytest.approx(-20_000, abs=110)  # one step at 1500 rpm


def test_position_move_by_the_independent_master(pair: Pair) -> None:
    node, drive = pair.node, pair.drive
    node.op_mode = "PROFILED POSITION"
    assert node.op_mode == "PROFILED POSITION"
    node.state = "OPERATION ENABLED"
    node.sdo[0x607A].raw = 9000
    node.sdo[0x6081].raw = 6000
    node.controlword = 0x1F
    pair.until(lambda: node.sdo[0x6041].raw & 0x1000, "set-point acknowledge")
    node.controlword = 0x0F
    pair.until(lambda: node.sdo[0x6041].raw & 0x1400 == 0x0400, "target reached")
    assert node.sdo[0x6064].raw == 9000
    assert OperationMode.CODE2NAME[node.sdo[0x6061].raw] == "PROFILED POSITION"
    assert drive.model.position_actual == 9000
