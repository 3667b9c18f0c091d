"""Two nodes of one bus never share the COB-ID of a PDO: neither gets the other's commands."""

from __future__ import annotations

import pytest

from pdgw.ds301.node.node import NodeStatus
from pdgw.ds301.objects import Access, CanType, Entry
from pdgw.dsp402.states import State
from pdgw.gateway.daemon import Daemon
from pdgw.peers.drive import SimulatedDriveNode
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, drive_of, running, until

FIRST, HIGHER = 1, 65
"""RPDO5 of the first has the COB-ID of RPDO1 of the other, 241h."""


def test_fifth_rpdo_of_a_node_commands_no_node_that_is_64_higher() -> None:
    """Telegram 100 sends outputs and their mask in RPDO5, as many bytes as Target Velocity and Controlword."""
    with running(configuration(axis(FIRST, telegram_number=100) + axis(HIGHER))) as daemon:
        other = drive_of(daemon, HIGHER)
        states: list[State] = []
        plc = Plc(daemon, [100, 1])
        until(daemon, lambda: daemon.axes[1].drive.generation, "node 65 online")
        plc.endpoint.set(1, {"STW1": OFF})
        plc.until(lambda: other.model.state is State.READY_TO_SWITCH_ON, "ready")
        for mask in (0x07, 0x0F) * 20:
            plc.endpoint.set(0, {"Digital Outputs": 1000, "Digital Outputs Mask": mask})
            plc.exchange()
            plc.exchange()
            states.append(other.model.state)
        assert State.OPERATION_ENABLED not in states
        assert other.model.velocity_actual == 0
        refused = daemon.axes[0].drive
        assert refused.status is NodeStatus.REFUSED
        assert "RPDO5" in refused.status_text
        assert "node 65" in refused.status_text


@pytest.mark.parametrize("left", [0x245, 0x8000_0245])
def test_rpdo_left_by_another_master_takes_no_commands_of_another_node(left: int) -> None:
    """Above node-ID 63 the gateway has no COB-ID for RPDO5; in the drive it still has that of RPDO1 of node 69."""

    def left_mapped(daemon: Daemon) -> None:
        def write(node: SimulatedDriveNode) -> None:
            node.values |= {(0x1604, 0): 2, (0x1604, 1): 0x60FF_0020, (0x1604, 2): 0x6040_0010, (0x1404, 1): left}
            node.pdos.map()

        drive_of(daemon, 70).do(write)

    with running(configuration(axis(69) + axis(70)), before=left_mapped) as daemon:
        until(daemon, lambda: all(item.good for item in daemon.axes), "online")
        plc, other = Plc(daemon, [1, 1]), drive_of(daemon, 70).model
        plc.endpoint.set(0, {"NSOLL_A": 0x1000})
        plc.endpoint.set(1, {"STW1": OFF})
        plc.enable()
        states = set()
        for _ in range(200):
            plc.exchange()
            states.add(other.state)
        assert State.OPERATION_ENABLED not in states
        assert other.velocity_actual == 0
        assert drive_of(daemon, 70).node.values[0x1404, 1] & 0x8000_0000


def _fixed(daemon: Daemon, node_id: int, cob_id: int) -> None:
    """RPDO5 of a drive keeps this COB-ID."""

    def write(node: SimulatedDriveNode) -> None:
        node.entries = {**node.entries, (0x1404, 1): Entry(0x1404, 1, "COB-ID", CanType.U32, Access.RO)}
        node.values[0x1404, 1] = cob_id

    drive_of(daemon, node_id).do(write)


def test_equal_drives_may_keep_a_cob_id_that_nobody_sends() -> None:
    def fixed(daemon: Daemon) -> None:
        _fixed(daemon, 69, 0x6FF)
        _fixed(daemon, 70, 0x6FF)

    with running(configuration(axis(69) + axis(70)), before=fixed) as daemon:
        until(daemon, lambda: all(item.good for item in daemon.axes), "online")


def test_drive_that_keeps_the_cob_id_of_another_node_is_refused() -> None:
    with running(configuration(axis(69) + axis(70)), before=lambda daemon: _fixed(daemon, 70, 0x245)) as daemon:
        until(daemon, lambda: daemon.axes[1].drive.status is NodeStatus.REFUSED, "refused")
        assert "RPDO5 unused" in daemon.axes[1].drive.status_text
