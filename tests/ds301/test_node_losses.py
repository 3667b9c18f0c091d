"""The loss of a node: who caused it, what is sent until it is configured again, and what another master writes meanwhile."""

from __future__ import annotations

import can

from pdgw.base.durations import MS
from pdgw.ds301.communication import NMT, NmtCommand
from pdgw.ds301.node.node import Loss, NodeStatus
from pdgw.dsp402.drive.client import DriveClient
from pdgw.dsp402.states import Command
from tests.support.drives.plant import NODE, Plant
from tests.support.gateways import site

LEAVE = bytes((NmtCommand.ENTER_PRE_OPERATIONAL, NODE))
RPDO1 = 0x200 + NODE


def _lost(client: DriveClient) -> str:
    site.wait_for(lambda: client.status is NodeStatus.LOST, "lost")
    return client.status_text


def test_each_loss_has_its_own_cause(plant: Plant) -> None:
    """A drive that leaves Operational after a stop by the gateway, or by another master, does it by itself the next time."""
    drive = plant.power_on()
    client = plant.connected()
    other = site.other()
    causes = (
        (client.stop_node, Loss.OWN_STOP, "the gateway has stopped it (NMT)"),
        (lambda: drive.do(lambda node: node.receive(NMT, LEAVE, node.now)), None, "it has left Operational by itself"),
        (lambda: other.send(NMT, LEAVE), Loss.OTHER_MASTER, "another master has sent NMT command 80h"),
        (lambda: drive.do(lambda node: node.receive(NMT, LEAVE, node.now)), None, "it has left Operational by itself"),
    )
    for generation, (lose, loss, text) in enumerate(causes, 1):
        plant.online(generation)
        lose()
        assert text in _lost(client)
        assert client.loss is loss


def test_lost_node_gets_its_stop_until_it_answers_and_no_rpdo_while_it_is_configured(plant: Plant) -> None:
    drive = plant.power_on()
    client = plant.connected()
    sent: list[tuple[NodeStatus, int]] = []

    def observe(message: can.Message) -> None:
        if message.arbitration_id == RPDO1 and not message.is_rx:
            sent.append((client.status, message.data[4]))

    plant.run([0x06, 0x07, 0x0F], 100)
    plant.network.listeners.append(observe)
    drive.do(lambda node: node.start_fault("sdo-timeout"))
    site.other().send(NMT, LEAVE)
    _lost(client)
    plant.run([Command.QUICK_STOP.word], 400)  # it has begun to ask
    sent.clear()
    plant.run([Command.QUICK_STOP.word], 300)
    assert {*sent} == {(NodeStatus.LOST, Command.QUICK_STOP.word)}
    drive.do(lambda node: node.end_fault())
    for speed in range(200):  # each command is another one
        plant.run([Command.QUICK_STOP.word], 4, target_velocity=speed)
    assert {status for status, _ in sent} == {NodeStatus.LOST, NodeStatus.ONLINE}


def test_write_of_another_master_begins_the_bring_up_again_also_during_it(plant: Plant) -> None:
    plant.power_on()
    client = plant.connect()
    site.wait_for(lambda: client.status is NodeStatus.CONFIGURING, "configured")
    client.distrust("another tool writes 6060h/0")
    used: list[bool] = []
    site.wait_for(lambda: client.generation == 2 or used.append(client.refresh(site.now())), "brought up again")
    assert not any(used)
    assert "another tool writes 6060h/0" in [event.text for event in plant.events]
    site.pass_time(500 * MS)
    assert (client.refresh(site.now()), client.generation) == (True, 2)
    client.distrust("another tool writes 1017h/0")
    assert (client.refresh(site.now()), client.status) == (False, NodeStatus.LOST)
    plant.online(3)


def test_check_after_a_write_is_not_forgotten_after_another_write(plant: Plant) -> None:
    """The second object needs no check; the node is not used before that of the first one."""
    plant.power_on()
    client = plant.connected()

    def write_twice(node: DriveClient) -> None:
        for check in (True, False):
            node.hold("a client writes")
            node.unhold(check=check)

    site.result(client.submit(write_twice))
    used: list[bool] = []
    site.wait_for(lambda: client.generation == 2 or used.append(client.refresh(site.now())), "brought up again")
    assert used
    assert not any(used)
    assert "configuring: another tool wrote to its configuration" in [event.text for event in plant.events]
