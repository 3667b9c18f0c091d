"""The CAN buses of a gateway: which of them have SYNC, how much room their PDOs leave, and what explains a fault on them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any, Final

from pdgw.base.durations import MS
from pdgw.ds301.bus.load import DEFAULT_BITRATE, bus_load, sdo_gap_ns
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import SYNC
from pdgw.ds301.emcy import HEARTBEAT_ERROR
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.node.node import Cause
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.fault_numbers import By
from pdgw.gateway.base.platform import Platform
from pdgw.gateway.base.reasons import Finding, Reason
from pdgw.gateway.configuration.bus_load import HEARTBEATS
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.gateway.daemon.masters import SameNodeId, SyncOfNodes, watch_for_masters, watch_for_writes
from pdgw.gateway.daemon.sync import SyncProducer
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.parameters.objects import relies_on
from pdgw.gateway.service.events import EventLog

log = logging.getLogger("gateway")

_NOT_STARTED: Final = "the gateway sent no heartbeat before its start"
_IF_IT_RAN: Final = "if the gateway had not ended, check CAN cable, termination and bit rate"


class Buses:
    """All buses of one configuration. CanopenError from the constructor if an interface cannot be opened."""

    def __init__(self, config: GatewayConfig, platform: Platform, events: EventLog, opened: ExitStack) -> None:
        """``opened`` closes them."""
        self._loop = platform.loop
        self._events = events
        self._cycle_ns = int(config.transport.cycle_time_ms * MS)
        self.networks: dict[str, CanNetwork] = {}
        for bus in config.can:
            network = CanNetwork(self._loop, partial(platform.open_can, bus), bus.name, bus.node_id)
            opened.callback(network.close)
            network.log_event = partial(self._on_bus, network)
            network.bitrate = bus.bitrate or DEFAULT_BITRATE
            self.networks[bus.name] = network
        self.same_ids = {name: self._same_id(network) for name, network in self.networks.items()}
        self._objects: Sequence[DriveObject] = ()
        self._clients: Sequence[NodeClient[Any]] = ()
        self.sync_producers: dict[str, SyncProducer] = {}
        self.heartbeat_ns = 0
        """Period of the gateway's heartbeat."""
        self.limit_ns = 0
        """The shortest time after which a node counts as lost."""

    def connect(self, objects: Sequence[DriveObject], clients: Sequence[NodeClient[Any]]) -> None:
        """These drive objects and the clients of their nodes are on the buses."""
        self._objects, self._clients = objects, clients
        settings = [client.settings for client in clients]
        self.heartbeat_ns = min(item.heartbeat_ms for item in settings) * MS // HEARTBEATS
        self.limit_ns = min(min(item.heartbeat_limit_ns, item.tpdo_limit_ns) for item in settings)
        self.find_sync()
        for network in self.networks.values():
            network.sync.changed = self.find_sync

    def _same_id(self, network: CanNetwork) -> SameNodeId:
        def report(text: str) -> None:
            log.warning("%s", text, extra={"event": "bus", "bus": network.name})
            self._events.add("bus", None, text)

        return SameNodeId(network, report)

    def _on_bus(self, network: CanNetwork, text: str) -> None:
        """The bus is lost, for another reason, or back."""
        self._events.add("bus", None, text)
        evidence = network.disturbance
        for item in self._objects:
            if evidence is not None and item.network is network:
                text = f"bus {network.name}: {evidence.text}"
                found = Finding(Reason.BUS_LOST, text, (evidence.remedy,), since_ns=self._loop.now(), by=By.BUS)
                item.origins.prove(found)

    def explained(self, item: DriveObject, record: FaultRecord) -> FaultRecord:
        """A fault with what happened on its bus and led to it."""
        if (cause := self.same_ids[item.network.name].explains(item, record)) is not None:
            return replace(record, text=f"{record.text}: {cause.evidence}", remedy=cause.remedy)
        unknown = record.is_older and item.client.generation == 1 and not item.origins.last(self._loop)
        if unknown and record.code == HEARTBEAT_ERROR:
            return replace(record, text=f"{record.text}: {_NOT_STARTED}", remedy=_IF_IT_RAN)
        return record

    def leave_room(self, bus: CanConfig, selected: GatewayConfig) -> None:
        """Bring-ups take what the cyclic frames leave of a bus. ``selected``: the configuration with the telegrams in use."""
        frames, network, bitrate = selected.frames_of(bus), self.networks[bus.name], bus.bitrate or DEFAULT_BITRATE
        timeouts = (client.settings.sdo_timeout_ms for client in self._clients if client.network is network)
        network.leave_room(sdo_gap_ns(bus_load(frames, bitrate), bitrate), min(timeouts, default=1) * MS)

    def find_sync(self) -> None:
        """Find the SYNC producers by the name of their bus."""
        synced = {client.network.name for client in self._clients if client.settings.sync}
        synced |= {name for name, network in self.networks.items() if network.sync.required}
        axes = [item for item in self._objects if isinstance(item, Axis)]
        cyclic = [axis for axis in axes if axis.drive.settings.sync_period_us]
        for name in synced:
            self.networks[name].claim(SYNC, "SYNC (a node whose 1005h has bit 30, too)")
        for name, network in self.networks.items():
            network.makes_sync = name in synced
        self.sync_producers = {
            name: SyncProducer(
                network, self._cycle_ns, [axis for axis in cyclic if axis.network is network], self._loop.now
            )
            for name, network in self.networks.items()
            if name in synced
        }

    def listen(self, on_other_master: Callable[[Cause], None]) -> None:
        """Begin to receive; other masters and writes of other SDO clients are found from now on."""
        for name, network in self.networks.items():
            network.start()
            drives = [item.node_id for item in self._objects if isinstance(item, Axis) and item.network is network]
            clients = [client for client in self._clients if client.network is network]
            sync = SyncOfNodes(network, clients)
            watch_for_masters(network, drives, self.same_ids[name], sync, on_other_master)
        for item in self._objects:
            client = item.client
            watch_for_writes(item.network, item.node_id, partial(relies_on, item), client.distrust_write)
            watch_for_writes(item.network, item.node_id, client.configuration.has, client.configuration.other_wrote)
