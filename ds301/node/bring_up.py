"""The bring-up of one CANopen node: find it, identify it, give it its values, map its PDOs, start it, confirm the start.

Source: CiA DS 301 (NMT, SDO, PDO mapping), CiA 302-3. All of it runs in the node's own task, which waits for answers; an error
names what the node must have. A device profile derives from the client and adds what it reads and configures.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, ClassVar, Final, Generic, NamedTuple, TypeVar

import canopen

from pdgw.base.durations import MS
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import (
    DEVICE_TYPE,
    EMCY_COB_ID,
    IDENTITY,
    NMT,
    SYNC_COB_ID,
    SYNC_COUNTER,
    NmtCommand,
)
from pdgw.ds301.emcy import emcy_text
from pdgw.ds301.loop.loop import Event
from pdgw.ds301.node.configuring import ConfiguringAccess, DeviceKind
from pdgw.ds301.node.confirmation import FIRST_SIGN_NS, Confirmation
from pdgw.ds301.node.device_values import DeviceConfiguration, ValueWriter
from pdgw.ds301.node.emergencies import Emergencies
from pdgw.ds301.node.heartbeat import Heartbeat
from pdgw.ds301.node.mapping import PdoMapper
from pdgw.ds301.node.node import Cause, Loss, NodeNotice, NodeSettings, NodeStatus, Notice, TpdoSlot
from pdgw.ds301.node.operation import Operation, Part, Unconfirmed, planned
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.planner import Findings
from pdgw.ds301.node.polled import PolledObjects
from pdgw.ds301.node.polling import Polling
from pdgw.ds301.pdo import PdoCallback, PdoCapabilities, PdoLayout, PdoReceiver
from pdgw.ds301.values import KnownDevice

S = TypeVar("S", bound=NodeSettings)

_RECHECK_NS: Final = 5 * MS
_DISCOVERY: Final = 200
"""Usual number of objects that are read of a device without a data sheet,"""
_CONFIGURATION: Final = 100
"""and of accesses that configure a known device."""
NOT_STARTED: Final = "not started"
_NOTICES: Final = {
    NodeStatus.OFFLINE: Notice.ABSENT,
    NodeStatus.CONFIGURING: Notice.PROGRESS,
    NodeStatus.ONLINE: Notice.ONLINE,
    NodeStatus.REFUSED: Notice.REFUSED,
}
"""What a status is to the owner; a loss is that of the node or of its bus."""


class NodeSetup(NamedTuple, Generic[S]):
    """What the client of one node is made of, by its device profile."""

    network: CanNetwork
    settings: S
    layout: PdoLayout
    """The objects to transfer, with their preferred PDOs."""
    dictionary: canopen.ObjectDictionary
    """Its data sheet."""
    image: Any
    """Takes the values of its TPDOs."""
    on_event: Callable[[NodeNotice], None]
    """Called whenever something happens to the node that the owner must know."""
    emergency_text: Callable[[int], str] = emcy_text
    """The meaning of an error code in its EMCY messages."""


class BringUp(abc.ABC, Generic[S]):
    """That of one node, as often as it starts."""

    kind: ClassVar[DeviceKind]
    unknown: ClassVar[Mapping[str, int]] = MappingProxyType({})
    """Values of the image for objects that are read by SDO and old, by attribute; the others keep the last value."""

    def __init__(self, setup: NodeSetup[S]) -> None:
        network, settings = setup.network, setup.settings
        self.loop = network.loop
        self.network = network
        self.sdo = ConfiguringAccess(network, settings.node_id, setup.dictionary, self.kind)
        """Access to its objects, in its task."""
        self.sdo.set_timeout(settings.sdo_timeout_ms * MS, slow=False)
        self.configuration = DeviceConfiguration(partial(self._notify, Notice.PROGRESS))
        """The values of its files, and what is known of its device."""
        self._value_writer = ValueWriter(self.sdo)
        self.settings = settings
        self.layout = setup.layout
        self._image = setup.image
        self._mapper = PdoMapper(network, self.sdo)
        self.plan: PdoPlan | None = None
        """The PDOs of this node with their contents; None before its first start."""
        self.on_event = setup.on_event
        self.status = NodeStatus.OFFLINE
        self.cause = Cause(NOT_STARTED)
        self.refusal: Cause | None = None
        """Why the node was rejected, also during the next attempt to configure it."""
        self.generation = 0
        """Counts completed configurations, so that the owner sees each restart exactly once."""
        self.operation = Operation()
        """What it does by the plan."""
        self.polling = Polling()
        """The objects that are read by SDO."""
        self._wake = Event(self.loop)
        """Something for the node's task: a job, a loss, another layout."""
        self._polled = PolledObjects(self.sdo, self.polling, setup.image, self.unknown, self._wake.set)
        self.parts: tuple[Part, ...] = (self._polled,)
        """What is done beside the PDOs, in this order."""
        self.heartbeat = Heartbeat(network, settings.node_id, self.sdo.doubles)
        self.emergencies = Emergencies(network, settings.node_id, setup.emergency_text, setup.on_event)
        self._booted = Event(self.loop)
        self._reconfigure = False
        """The owner has another layout or other settings."""
        self._unconfirmed: Unconfirmed | None = None
        """Why the cyclic side must not use an online node; None: it may."""

    # -- the device profile's part ------------------------------------------------------------------------------------

    def _identify(self, device_type: int) -> None:
        """In the node's task, after its first SDO answer (1000h) and before anything else: it takes no RPDO from now on."""
        own = self.settings.eds is not None
        sheet = Cause("the built-in data sheet", "set the key eds to the EDS of the manufacturer")
        self.sdo.check_identity(device_type, sheet=Cause("the EDS") if own else sheet)

    @abc.abstractmethod
    def _configure(self, plan: PdoPlan) -> None:
        """Everything between the mapping of the PDOs and NMT start, in the node's task; errors refuse the node."""

    @abc.abstractmethod
    def _read_capabilities(self) -> PdoCapabilities:
        """In the node's task: the PDOs that the data sheet shows. Whatever else the plan depends on is read first."""

    @abc.abstractmethod
    def _make_plan(self, findings: Findings) -> PdoPlan:
        """Assign the objects of the layout to the PDOs of the node."""

    def _read_known(self) -> KnownDevice:
        """The device that is there, without its revision."""
        vendor_id, product_code, serial_number = (self.sdo.read_optional(IDENTITY, subindex) for subindex in (1, 2, 4))
        return KnownDevice(vendor_id, product_code, serial_number=serial_number)

    # -- status -------------------------------------------------------------------------------------------------------

    def _notify(self, notice: Notice, text: str, by: Loss | None = None, remedy: str = "") -> None:
        self.on_event(NodeNotice(notice, text, self.loop.now(), by=by, remedy=remedy))

    def _set_status(self, status: NodeStatus, cause: Cause) -> None:
        if self._change_status(status, cause):
            two = status is NodeStatus.REFUSED and self.sdo.doubles.proof
            notice = Notice.TWO_DEVICES if two else _NOTICES[status]
            self._notify(notice, f"{status.value}: {cause.evidence}", remedy=cause.remedy)

    def _change_status(self, status: NodeStatus, cause: Cause) -> bool:
        """Set the status. False if it is the same for the same cause."""
        changed = status is not self.status or cause != self.cause
        self.status = status
        self.cause = cause
        if status is not NodeStatus.CONFIGURING:
            self.refusal = cause if status is NodeStatus.REFUSED else None
        if changed and status in (NodeStatus.LOST, NodeStatus.OFFLINE):
            self.network.examine()
        return changed

    # -- bring-up -----------------------------------------------------------------------------------------------------

    def _bring_up(self) -> None:
        self.sdo.accesses, self.sdo.patient = 0, True
        self.sdo.expected = _DISCOVERY + _CONFIGURATION
        try:
            with self.network.bring_ups:
                self._prepare()
        finally:
            self.sdo.patient = False
        try:
            self._confirm()
        except CanopenError:
            self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)  # a rejected node executes NMT commands but must send no PDOs
            raise
        if self._interrupted:
            return
        self.generation += 1
        self.polling.resume(self.loop.now())
        self.operation.begin(self.parts, self.network.health.failures)
        self._set_status(NodeStatus.ONLINE, Cause(f"operational, configuration {self.generation}"))

    def _prepare(self) -> None:
        """Find the node, make it safe, configure and start it."""
        self._booted.clear()
        self._reconfigure = False
        self._unconfirmed = None
        self.sdo.resume()
        # A stopped node answers no SDO before this command; a running one may stop by its abort option. Until it has
        # answered, its state is unknown: a node that was in operation still gets its stop.
        self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        device_type = self.sdo.read_urgently(DEVICE_TYPE)
        self._end_operation()
        self._booted.clear()  # a boot-up before this answer is the expected one
        self._set_status(NodeStatus.CONFIGURING, Cause("checking identity"))
        self._identify(device_type)
        if self.network.makes_sync and self._may_have(SYNC_COB_ID) and self.sdo.stop_sync_producer():
            self._notify(
                Notice.PROGRESS, "1005h bit 30 cleared: the node has sent SYNC, which the gateway sends on this bus"
            )
        if self._may_have(EMCY_COB_ID):
            self.emergencies.find(self.sdo)
        values = self.settings.values
        self.sdo.expected = self.sdo.accesses + len(values.items) + _CONFIGURATION
        self.configuration.bring_up(values, self._read_known(), self._value_writer)
        self._set_status(NodeStatus.CONFIGURING, Cause("mapping PDOs"))
        plan = self._mapper.map(self.settings, self._read_capabilities, self._make_plan)
        self._use_plan(plan)
        if plan.needs_sync and self._may_have(SYNC_COUNTER):
            self.sdo.stop_sync_counter()
        for part in self.parts:
            part.configure(plan, self.operation)
        self._configure(plan)
        for slot in self.operation.slots:
            self.network.subscribe_pdo(slot.cob_id, self._receiver(slot))
        self._polled.read_all()
        self.heartbeat.begin(self.settings.heartbeat_ms)
        self._nmt(NmtCommand.START)

    def _may_have(self, index: int) -> bool:
        """Whether the data sheet has an object; the built-in ones do not have everything."""
        return self.settings.eds is None or index in self.sdo.dictionary

    def _use_plan(self, plan: PdoPlan) -> None:
        settings = self.settings
        self.operation = planned(plan, settings, self._image, self.sdo.doubles, self.operation.length_errors)
        for item in plan.rpdos:
            self.network.claim(item.cob_id, f"{item.pdo} of {self.kind.name} {settings.node_id}")
        self.network.sync.require(settings.node_id, required=plan.needs_sync)
        if plan != self.plan:
            self.plan = plan
            for line in plan.lines:
                self._notify(Notice.PROGRESS, line)

    def _receiver(self, slot: TpdoSlot) -> PdoReceiver | PdoCallback:
        """What takes the frames of a TPDO. Only one on SYNC has a second one: the others are also sent on change."""
        second = slot.second
        if second is None:
            return slot

        def receive(data: bytes, now: int) -> None:
            second.see(self.network.syncs)
            slot.receive(data, now)

        return receive

    def _confirm(self) -> None:
        """Wait for what a node shows after NMT start."""
        found = Confirmation(
            self.sdo, self.heartbeat, self.emergencies, self.settings, self.operation, first=not self.generation
        )
        for limit, find in (
            (FIRST_SIGN_NS, found.missing_tpdos),
            (found.heartbeat_ns, found.missing_heartbeat),
        ):
            deadline = self.loop.now() + limit
            while (missing := find()) is not None and not self._interrupted:
                if self.loop.now() > deadline:
                    raise found.explanation() or missing
                self.loop.sleep(_RECHECK_NS)

    @property
    def _interrupted(self) -> bool:
        """Whether the node has restarted during the bring-up, or its layout has changed."""
        return self._booted.is_set() or self._reconfigure

    def _end_operation(self) -> None:
        """What the node does by its plan is no longer used."""
        for slot in self.operation.slots:
            self.network.unsubscribe_pdo(slot.cob_id)
        self.operation = Operation(length_errors=self.operation.length_errors)

    def _nmt(self, command: NmtCommand) -> None:
        self.heartbeat.commanded()
        self.network.send(NMT, bytes((command, self.settings.node_id)))
