"""Listen whether a master works on a bus: two masters would disturb each other."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import can

from pdgw.base.durations import SECOND
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import ERROR_CONTROL, HEARTBEAT_STATE, NMT, SDO_REQUEST, SYNC, NmtState
from pdgw.ds301.pdo import PdoDirection
from pdgw.gateway.base.errors import GatewayError

_RPDO_BASES: Final = frozenset(PdoDirection.RPDO.cob_id(number, 0) for number in range(1, 5))
_SCAN: Final = "allowed during a scan: none. End it, or query it instead (pdgw status, pdgw param)"
ALONE: Final = "allowed: none. End the gateway or master, and repeat the command"
"""Instead of it, for a command that changes something."""


class MasterWatch:
    """``allowed``: the end of the message. ``sync``: a SYNC counts too."""

    def __init__(self, network: CanNetwork, allowed: str = _SCAN, *, sync: bool = False) -> None:
        self._network = network
        self._allowed = allowed
        self._sync = sync
        self._found = ""
        self.states: dict[int, int] = {}
        """NMT state in the last heartbeat, by node-ID."""

    def see(self, message: can.Message) -> None:
        """A frame that was sent or received."""
        if not message.is_rx or message.is_extended_id or message.is_remote_frame:
            return
        can_id = message.arbitration_id
        base, node_id = can_id & ~0x7F, can_id & 0x7F
        if base == ERROR_CONTROL and node_id and message.data:
            self.states[node_id] = message.data[0] & HEARTBEAT_STATE
            if node_id == self._network.node_id and self.states[node_id] == NmtState.OPERATIONAL:
                self._found = f"the heartbeat of a gateway (node {node_id})"
        elif can_id == NMT:
            self._found = "an NMT command"
        elif can_id == SYNC and self._sync:
            self._found = "SYNC"
        elif base == SDO_REQUEST and node_id:
            self._found = f"an SDO request to node {node_id}"
        elif node_id and base in _RPDO_BASES:
            self._found = f"process data for node {node_id} (COB-ID {can_id:03X}h)"

    def refuse(self) -> None:
        """GatewayError when a master was heard."""
        if self._found:
            raise GatewayError(f"CAN bus {self._network.name}: a master sends {self._found}; {self._allowed}")

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Listen, in a task, until the end of the block, at which a master is refused, too."""
        self._network.listeners.append(self.see)
        try:
            self._network.loop.sleep(SECOND)
            self.refuse()
            yield
            self.refuse()
        finally:
            self._network.listeners.remove(self.see)
