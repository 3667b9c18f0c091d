"""Scan and axis test over controllers: nothing simulated between this process and the drive on the other end of the wire."""

from __future__ import annotations

from pdgw.ds301.bus.port import open_bus
from pdgw.gateway.commissioning.scan import Scan
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.peers.drive import SimulatedDrive
from pdgw.tools.bus_task import complete, opened
from pdgw.tools.commissioning.axis_test import AxisTest, Choices
from tests.can.interfaces import Wire
from tests.can.plant import axis_table, can_table
from tests.can.unhurried import UnhurriedPlatform


def test_scan_over_a_short_queue_queries_every_node_id_and_finds_the_drive(line: Wire) -> None:
    platform = UnhurriedPlatform()
    with (
        SimulatedDrive(open_bus("socketcan", line.far), 5, loop=platform.loop),
        opened(CanConfig(interface="socketcan", channel=line.near, name=line.near), platform) as network,
    ):
        (found,) = complete(platform.loop, Scan(network, timeout_s=5.0).run)
        assert network.send_errors == 0
    platform.loop.close()
    assert found.node_id == 5
    assert found.lacks[1] == ""


def test_the_axis_test_turns_the_drive_and_finds_its_units_right(line: Wire) -> None:
    platform = UnhurriedPlatform()
    transport = "[transport]\ncyclic_port = 0\nacyclic_port = 0\nstatus_port = 0\n"
    config = parse_config("\n".join((can_table(line.near), axis_table(1, line.near), transport)))
    lines: list[str] = []
    test = AxisTest(config, 1, platform, lines.append, lambda wanted, answer: answer(wanted), Choices())
    with SimulatedDrive(open_bus("socketcan", line.far), 1, loop=platform.loop) as drive:
        outcome = complete(platform.loop, test.run)
        assert drive.model.ramp.speed == 0
    platform.loop.close()
    assert outcome.passed, lines
