"""Scan and axis test over controllers: nothing simulated between this process and the drive on the other end of the wire."""

from __future__ import annotations

from pdgw.ds301.bus import open_bus
from pdgw.gateway.commissioning.scan import Scan
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.peers.drive import SimulatedDrive
from pdgw.tools.bus_task import complete, opened
from pdgw.tools.commissioning.axis_test import AxisTest, Choices
from tests.can.interfaces import Wire
from tests.can.plant import axis_table, can_table
from tests.can.unhurried import UnhurriedEdge


def test_a_scan_asks_every_node_id_over_a_short_queue_and_finds_the_drive(line: Wire) -> None:
    edge = UnhurriedEdge()
    with (
        SimulatedDrive(open_bus("socketcan", line.far), 5, loop=edge.loop),
        opened(CanConfig(interface="socketcan", channel=line.near, name=line.near), edge) as network,
    ):
        (found,) = complete(edge.loop, Scan(network, timeout_s=5.0).run)
        assert network.send_errors == 0
    edge.loop.close()
    assert found.node_id == 5
    assert found.lacks[1] == ""


def test_the_axis_test_turns_the_drive_and_finds_its_units_right(line: Wire) -> None:
    edge = UnhurriedEdge()
    transport = "[transport]\ncyclic_port = 0\nacyclic_port = 0\nstatus_port = 0\n"
    config = parse_config("\n".join((can_table(line.near), axis_table(1, line.near), transport)))
    lines: list[str] = []
    test = AxisTest(config, 1, edge, lines.append, lambda wanted, answer: answer(wanted), Choices())
    with SimulatedDrive(open_bus("socketcan", line.far), 1, loop=edge.loop) as drive:
        outcome = complete(edge.loop, test.run)
        assert drive.model.ramp.speed == 0
    edge.loop.close()
    assert outcome.passed, lines
