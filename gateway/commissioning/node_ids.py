"""Look at a bus before a device gets another node-ID: no master may work on it, and the node-ID must be free."""

from __future__ import annotations

from typing import Final

from pdgw.ds301.aborts import SdoCommunicationError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import DEVICE_TYPE, IDENTITY
from pdgw.ds301.node.sdo import Inquiry
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.commissioning.master_watch import ALONE, MasterWatch

_TIMEOUT_S: Final = 0.5


def look_before(network: CanNetwork, node_id: int, old: int | None) -> tuple[int, int, int, int] | None:
    """The identity (1018h) of the device with node-ID ``old``, in a task; None without ``old``.

    GatewayError beside a master, for a node-ID that is used, or a device that does not answer.
    """
    watch = MasterWatch(network, ALONE, sync=True)
    with watch.listening():
        if node_id == network.node_id:
            raise GatewayError(f"node-ID {node_id} is that of the gateway; assign another one, or set [can] node_id")
        if node_id in watch.states or _answers(network, node_id):
            raise GatewayError(f"node-ID {node_id} is used by another device; pdgw bus scan lists the nodes")
        return None if old is None else _identity(network, old)


def _answers(network: CanNetwork, node_id: int) -> bool:
    try:
        with Inquiry(network, node_id, _TIMEOUT_S) as node:
            node.fetch(DEVICE_TYPE)
    except SdoCommunicationError:
        return False
    return True


def _identity(network: CanNetwork, node_id: int) -> tuple[int, int, int, int]:
    try:
        with Inquiry(network, node_id, _TIMEOUT_S) as node:
            vendor, product, revision, serial = (node.number(IDENTITY, subindex) or 0 for subindex in range(1, 5))
    except SdoCommunicationError as error:
        raise GatewayError(f"node {node_id} does not answer ({error}); pdgw bus scan lists the nodes") from error
    return vendor, product, revision, serial
