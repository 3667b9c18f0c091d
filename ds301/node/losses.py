"""Why a node that is online counts as lost, and by whom. Nothing here changes anything. Source: docs/translation.md "Losses"."""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import NmtState
from pdgw.ds301.loop.loop import Event
from pdgw.ds301.node.confirmation import TPDO_REMEDY
from pdgw.ds301.node.emergencies import Emergencies
from pdgw.ds301.node.heartbeat import Heartbeat
from pdgw.ds301.node.node import Cause, Loss, Lost, NodeSettings
from pdgw.ds301.node.operation import Operation
from pdgw.ds301.node.polled import PolledObjects
from pdgw.ds301.node.polling import Polling
from pdgw.ds301.node.sdo import SdoAccess

_MASTER: Final = "switch the other master off, or have it leave this node alone"
_DEVICE: Final = "check the device: its error behaviour 1029h, and the cause of its EMCY"


class Losses:
    """Of one node. ``booted`` is set by its boot-up message."""

    def __init__(
        self,
        node_id: int,
        network: CanNetwork,
        sdo: SdoAccess,
        heartbeat: Heartbeat,
        emergencies: Emergencies,
        polling: Polling,
        polled: PolledObjects,
        booted: Event,
    ) -> None:
        self.restarted = Cause(f"node {node_id} restarted")
        self._network = network
        self._sdo = sdo
        self._heartbeat = heartbeat
        self._emergencies = emergencies
        self._polling = polling
        self._polled = polled
        self._booted = booted

    def find(self, settings: NodeSettings, operation: Operation, now: int) -> Lost | None:
        """Why the node is lost; None if it is not."""
        if self._booted.is_set():
            return self.by_other_master() or Lost(self.restarted)
        if self._sdo.doubles.proof:
            return Lost(Cause.of(self._sdo.two_devices()))
        heartbeat, oldest = self._heartbeat, now - operation.timeout_ns
        overdue = [slot for slot in operation.slots if slot.time < oldest and slot.watched]
        lost = heartbeat.lost(now, settings.heartbeat_limit_ns, operation.slots)
        if (overdue or lost) and heartbeat.expected:
            newest = max([heartbeat.time, *(slot.time for slot in operation.slots)])
            if now - newest > settings.heartbeat_ms * MS:
                return Lost(Cause("silent: neither heartbeats nor TPDOs"))
        if lost:
            return Lost(lost)
        if heartbeat.expected and heartbeat.state != NmtState.OPERATIONAL:
            return self._left(operation, now)
        if overdue:
            beats = heartbeat.time > min(slot.time for slot in overdue) + operation.timeout_ns // 2
            missing = f"no {', '.join(str(slot.pdo) for slot in overdue)} for {operation.timeout_ns // MS} ms"
            return Lost(Cause(f"{missing} while its heartbeats arrive", TPDO_REMEDY) if beats else Cause(missing))
        if self._polling.objects and (unread := self._polled.unread(now)):
            return Lost(Cause(unread))
        if self.bus_failed(operation):
            outage = self._network.last_outage
            return Lost(Cause(f"bus {self._network.name}: {outage.value}", outage.remedy))
        return Lost(Cause(operation.lost)) if operation.lost else None

    def _left(self, operation: Operation, now: int) -> Lost:
        """Why the heartbeat shows another state than Operational."""
        state = NmtState.text(self._heartbeat.state)
        if operation.stopped:
            return Lost(Cause(f"{state}: the gateway has stopped it (NMT)"), Loss.OWN_STOP)
        if (other := self.by_other_master()) is not None:
            return other._replace(cause=other.cause._replace(evidence=f"{state}: {other.cause.evidence}"))
        after = self._emergencies.after(now - SECOND)
        return Lost(Cause(f"{state}: it has left Operational by itself{after}", _DEVICE))

    def by_other_master(self) -> Lost | None:
        """That another master took the node out of Operational by an NMT command; None if none did."""
        if not (command := self._heartbeat.foreign):
            return None
        return Lost(Cause(f"another master has sent NMT command {command:02X}h", _MASTER), Loss.OTHER_MASTER)

    def bus_failed(self, operation: Operation) -> bool:
        """Whether the bus failed while the node was online. It may work again now, but frames may have been lost meanwhile."""
        return self._network.health.failures != operation.bus_failures or not self._network.healthy
