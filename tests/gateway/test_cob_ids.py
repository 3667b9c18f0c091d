"""Two nodes of one bus never share the COB-ID of a PDO: neither gets the other's commands."""

from __future__ import annotations

from pdgw.ds301.node.node import NodeStatus
from pdgw.dsp402.states import State
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
