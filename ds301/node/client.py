"""The client of one CANopen node: brings it into operation on a bus and keeps watching it.

Source: CiA DS 301 (NMT, heartbeat, EMCY, SDO, PDO), docs/translation.md "Losses". The cyclic side (``refresh``) never
waits; identity check, PDO configuration and user SDO jobs run in the node's own task on the loop. A device profile derives
from ``NodeClient`` and adds its images and what it configures.
"""

from __future__ import annotations

import abc
import logging
import struct
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import partial
from types import MappingProxyType
from typing import ClassVar, Final, Generic, Self, TypeVar

import canopen

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import CanopenError, SdoAbortedError, SdoCommunicationError
from pdgw.ds301.bus.network import CanNetwork, PdoCallback
from pdgw.ds301.communication import (
    DEVICE_TYPE,
    EMCY_COB_ID,
    ERROR_CONTROL,
    IDENTITY,
    NMT,
    SDO_REQUEST,
    SYNC_COB_ID,
    SYNC_COUNTER,
    NmtCommand,
)
from pdgw.ds301.emcy import emcy_text
from pdgw.ds301.loop.jobs import Jobs
from pdgw.ds301.loop.loop import Event, Task
from pdgw.ds301.node.configuring import ConfiguringAccess, DeviceKind
from pdgw.ds301.node.confirmation import FIRST_SIGN_NS, Confirmation
from pdgw.ds301.node.device_values import DeviceConfiguration, ValueWriter
from pdgw.ds301.node.emergencies import Emergencies
from pdgw.ds301.node.heartbeat import OFTEN, Heartbeat
from pdgw.ds301.node.losses import Losses
from pdgw.ds301.node.mapping import PdoMapper
from pdgw.ds301.node.node import Cause, Loss, Lost, NodeNotice, NodeSettings, NodeStatus, Notice, TpdoSlot
from pdgw.ds301.node.operation import NEVER, Operation, Part, Unconfirmed, planned
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.planner import Findings
from pdgw.ds301.node.polled import PolledObjects
from pdgw.ds301.node.polling import Polling
from pdgw.ds301.pdo import PdoCapabilities, PdoDirection, PdoLayout, PdoReceiver
from pdgw.ds301.values import KnownDevice

log = logging.getLogger("gateway")

T = TypeVar("T")


S = TypeVar("S", bound=NodeSettings)


_RETRY_ABSENT_NS: Final = 500 * MS
_RETRY_REFUSED_NS: Final = 5 * SECOND
_RECHECK_NS: Final = 5 * MS
_CHECK_AFTER_NS: Final = 200 * MS
"""A configuration is written object by object: it is checked this time after the last one."""
_DISCOVERY: Final = 200
"""Usual number of objects that are read of a device without a data sheet,"""
_CONFIGURATION: Final = 100
"""and of accesses that configure a known device."""
_TOOL: Final = "disconnect the other tool, or have it only read"
_CHECKED: Final = "another tool wrote to its configuration"
_NOT_STARTED: Final = "not started"
_ONLINE: Final = NodeStatus.ONLINE
_NOTICES: Final = {
    NodeStatus.OFFLINE: Notice.ABSENT,
    NodeStatus.CONFIGURING: Notice.PROGRESS,
    NodeStatus.ONLINE: Notice.ONLINE,
    NodeStatus.REFUSED: Notice.REFUSED,
}
"""What a status is to the owner; a loss is that of the node or of its bus."""


class NodeClient(abc.ABC, Generic[S]):
    """One node. ``on_event`` is called whenever something happens to it that the owner must know."""

    kind: ClassVar[DeviceKind]
    unknown: ClassVar[Mapping[str, int]] = MappingProxyType({})
    """Values of the image for objects that are read by SDO and old, by attribute; the others keep the last value."""

    def __init__(
        self,
        network: CanNetwork,
        settings: S,
        layout: PdoLayout,
        dictionary: canopen.ObjectDictionary,
        image: object,
        on_event: Callable[[NodeNotice], None],
        emergency_text: Callable[[int], str] = emcy_text,
    ) -> None:
        self.loop = network.loop
        self.network = network
        self.sdo = ConfiguringAccess(network, settings.node_id, dictionary, self.kind)
        """Access to its objects, in its task."""
        self.command: Callable[[int, int, bytes], None] = self.sdo.write
        """In a job: SDO write of a value that the owner commands: index, subindex and data."""
        self.write_for_client: Callable[[int, int, bytes], None] = self.sdo.write
        """The same for a parameter client."""
        self.configuration = DeviceConfiguration(partial(self._notify, Notice.PROGRESS))
        """The values of its files, and what is known of its device."""
        self._value_writer = ValueWriter(self.sdo)
        self.settings = settings
        self.layout = layout
        """The objects to transfer, with their preferred PDOs."""
        self._image = image
        """Takes the values of its TPDOs."""
        self._mapper = PdoMapper(network, self.sdo)
        self.plan: PdoPlan | None = None
        """The PDOs of this node with their contents; None before its first start."""
        self.on_event = on_event
        self.status = NodeStatus.OFFLINE
        self.cause = Cause(_NOT_STARTED)
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
        self._polled = PolledObjects(self.sdo, self.polling, image, self.unknown, self._wake.set)
        self.parts: tuple[Part, ...] = (self._polled,)
        """What is done beside the PDOs, in this order."""
        self.question: Callable[[int], bool] = lambda _: False
        """Begin to read an object without the task at this time, if it is due; False: it is not."""
        self.heartbeat = Heartbeat(network, settings.node_id, self.sdo.doubles)
        self.emergencies = Emergencies(network, settings.node_id, emergency_text, on_event)
        self._booted = Event(self.loop)
        self._losses = Losses(network, self.sdo, self.heartbeat, self.emergencies, self._polled, self._booted)
        self._reconfigure = False
        self.loss: Loss | None = None
        """Who caused the last loss, if not the node."""
        self._unconfirmed: Unconfirmed | None = None
        """Why the cyclic side must not use an online node; None: it may."""
        self._jobs = Jobs()
        self._task: Task | None = None
        self._receivers: list[tuple[int, Callable[[bytes, int], None]]] = [
            (NMT, self.heartbeat.commanded),
            (ERROR_CONTROL + settings.node_id, self._on_heartbeat),
            (SDO_REQUEST + settings.node_id, self._on_other_request),
        ]
        for direction in PdoDirection:
            for cob_id in direction.predefined(settings.node_id):
                network.node_of_pdo(cob_id, settings.node_id)
        part = f"node {settings.node_id} on {network.name}"
        add = self.loop.counters.add
        add(part, "length_errors", "frames", "TPDOs shorter than their mapping, ignored", lambda: self.length_errors)
        add(part, "generation", "times", "configured and started", lambda: self.generation)
        add(
            part,
            "early",
            "frames",
            "heartbeats before their time and second TPDOs for one SYNC: two devices with one node-ID?",
            lambda: self.sdo.doubles.early,
        )
        add(part, "sdo_aborts", "answers", "nodes that reject an access by SDO", lambda: self.sdo.aborts)
        self.sdo.set_timeout(settings.sdo_timeout_ms * MS, slow=False)

    # -- the device profile's part --------------------------------------------------------------------------------

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

    # -- the owner's side -----------------------------------------------------------------------------------------------

    @property
    def length_errors(self) -> int:
        """TPDOs shorter than their mapping, ignored."""
        return self.operation.length_errors

    @property
    def is_first_request(self) -> bool:
        """The first request to the node was neither answered nor missed yet."""
        return self.cause.evidence == _NOT_STARTED

    @property
    def status_text(self) -> str:
        """Why it has its status."""
        return self.cause.text

    @property
    def unconfirmed(self) -> str:
        """Why the cyclic side must not use an online node. Empty: it may."""
        return "" if self._unconfirmed is None else self._unconfirmed.text

    @property
    def progress(self) -> str:
        """How far the configuration of the node is; empty if it is not configured now."""
        if self.status is not NodeStatus.CONFIGURING or not self.sdo.patient:
            return ""
        slow = (
            f"; answers take more than {self.settings.sdo_timeout_ms} ms: set sdo_timeout_ms"
            if self.sdo.slow_ns
            else ""
        )
        return self.sdo.progress + slow

    @property
    def received_ns(self) -> int:
        """Time of the node's last TPDO or heartbeat; 0: never."""
        return max([self.heartbeat.time, *(slot.time for slot in self.operation.slots)])

    @property
    def shown_values(self) -> list[tuple[int, str, list[str]]]:
        """The TPDOs in the order in which their values are taken: COB-ID, format, image attributes.

        An empty attribute: the value is also read by SDO.
        """
        read = {item.entry.attribute for item in self.polling.objects}
        return [
            (slot.cob_id, slot.pdo.struct.format, ["" if name in read else name for name in slot.pdo.attributes])
            for slot in self.operation.slots
        ]

    def start(self) -> None:
        """Start the task: waits for the node, checks identity, configures, goes operational, supervises."""
        self.sdo.open()
        self.emergencies.open()
        for cob_id, take in self._receivers:
            self.network.subscribe(cob_id, take)
        self._task = self.loop.spawn(self._run, f"{self.kind.name} {self.settings.node_id}")

    def submit(self, job: Callable[[Self], T]) -> Future[T]:
        """Run a job with SDO access in the node's task; never delays the cyclic side.

        The future fails with the package's error at once when the node is not online.
        """
        if self.status is not NodeStatus.ONLINE:
            failed: Future[T] = Future()
            failed.set_exception(self._not_online())
            return failed
        future = self._jobs.add(lambda: job(self))
        self._wake.set()
        return future

    def stop(self) -> None:
        """NMT pre-operational and end of the task. The caller must have stopped the device before."""
        if self._task is not None:
            self._task.kill()
        self._end_operation()
        self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        self.status = NodeStatus.OFFLINE
        self.cause = Cause("stopped")
        self._jobs.fail(self._not_online)
        self.network.require_sync(self.settings.node_id, required=False)
        if self._task is not None:
            self._task = None
            self.sdo.close()
            self.emergencies.close()
            for cob_id, take in self._receivers:
                self.network.unsubscribe(cob_id, take)

    def reconfigure(self, layout: PdoLayout, settings: S) -> None:
        """Map other PDOs with other settings; the device must not be in operation."""
        self.operation.sends = False
        self.layout = layout
        self.settings = settings
        self.sdo.set_timeout(settings.sdo_timeout_ms * MS, slow=False)
        self._reconfigure = True
        self._wake.set()
        self._booted.set()  # do not wait for the next attempt of a rejected node

    # -- cyclic -------------------------------------------------------------------------------------------------------

    def refresh(self, now: int) -> bool:
        """Cyclic: take the newest TPDO data into the feedback; True while the node is trusted and no TPDO is overdue.

        A loss changes ``status`` at once (``_lose``), although the task may wait for an answer.
        """
        fresh = self.status is _ONLINE and self._unconfirmed is None
        operation = self.operation
        oldest = now - operation.timeout_ns
        for slot in operation.slots:
            data = slot.data
            if data is not slot.taken:
                slot.taken = data
                if data is not None:
                    slot.pdo.unpack_into(data, slot.image)
            if slot.time < oldest and slot.watched:
                fresh = False
        return fresh

    # -- the node's task ------------------------------------------------------------------------------------------------

    def hold(self, text: str) -> None:
        """In a job: what the gateway relies on is about to change; ``text`` says how. To the cyclic side the node is not online
        until ``unhold``. A node that is silent meanwhile, as while it stores parameters, is not lost.
        """
        self._unconfirmed = Unconfirmed(text, self._check_at)

    def unhold(self, *, check: bool) -> None:
        """In a job: the end of ``hold``. ``check``: the node is brought up again first, when no more was written for a moment."""
        now = self.loop.now()
        check_at = now + _CHECK_AFTER_NS if check else self._check_at
        self._unconfirmed = Unconfirmed(_CHECKED, check_at) if check_at != NEVER else None
        self._watch(now)

    @property
    def _check_at(self) -> int:
        """When the node is brought up again because its configuration was written to."""
        return NEVER if self._unconfirmed is None else self._unconfirmed.check_at

    def distrust(self, text: str) -> None:
        """Another master has changed what the gateway relies on: the node is lost, and configured again."""
        self._unconfirmed = Unconfirmed(text)
        if self.status is _ONLINE:
            self._lose(Lost(Cause(text, _TOOL), Loss.OTHER_TOOL))

    def distrust_write(self, index: int, subindex: int) -> None:
        """Another tool writes an object that the gateway relies on."""
        self.distrust(f"another tool writes {index:04X}h/{subindex}")

    def _end_operation(self) -> None:
        """What the node does by its plan is no longer used."""
        for slot in self.operation.slots:
            self.network.unsubscribe_pdo(slot.cob_id)
        self.operation = Operation(length_errors=self.operation.length_errors)

    def _run(self) -> None:
        try:
            self._live()
        except Exception:
            # The node is not supervised any more, so it must not count as online.
            self._set_status(NodeStatus.REFUSED, Cause("its task ended with an unexpected error, see the log"))
            raise

    def _live(self) -> None:
        while True:
            try:
                self._bring_up()
                # If the layout has changed or the node has restarted meanwhile, the bring-up is repeated.
                if self.status is NodeStatus.ONLINE:
                    self._supervise()
            except SdoCommunicationError as error:
                self._absent(f"no answer from node {self.settings.node_id} ({error})")
            except SdoAbortedError as error:
                self._refuse(Cause(f"aborted the configuration: {error}"))
            except CanopenError as error:
                self._refuse(Cause.of(error))
            except (struct.error, ValueError) as error:  # of another length than expected
                self._refuse(Cause(f"node {self.settings.node_id} sent an SDO answer that cannot be decoded ({error})"))

    def _not_online(self) -> CanopenError:
        return self.kind.error_type(
            f"{self.kind.name} {self.settings.node_id}", self.status.value, "online to be read or written"
        )

    def _notify(self, notice: Notice, text: str, by: Loss | None = None, remedy: str = "") -> None:
        self.on_event(NodeNotice(notice, text, self.loop.now(), by=by, remedy=remedy))

    def _set_status(self, status: NodeStatus, cause: Cause) -> None:
        changed = status is not self.status or cause != self.cause
        self.status = status
        self.cause = cause
        if status is not NodeStatus.CONFIGURING:
            self.refusal = cause if status is NodeStatus.REFUSED else None
        if status is not NodeStatus.ONLINE:
            self._jobs.fail(self._not_online)
        if not changed:
            return
        if status in (NodeStatus.LOST, NodeStatus.OFFLINE):
            self.network.examine()
        if status is NodeStatus.LOST:
            notice = Notice.BUS_LOST if self._losses.bus_failed(self.operation) else Notice.LOST
            self._notify(notice, cause.evidence, self.loss, cause.remedy)
        else:
            two = status is NodeStatus.REFUSED and self.sdo.doubles.proof
            notice = Notice.TWO_DEVICES if two else _NOTICES[status]
            self._notify(notice, f"{status.value}: {cause.evidence}", remedy=cause.remedy)

    def _absent(self, text: str) -> None:
        if self.status is not NodeStatus.LOST:
            self._set_status(NodeStatus.OFFLINE, Cause(text))
        self._wait(_RETRY_ABSENT_NS)
        if self.sdo.double_timeout():
            timeout = f"the timeout is now {self.sdo.timeout_ns // MS} ms; set sdo_timeout_ms"
            self._notify(Notice.PROGRESS, f"answers SDO late: {timeout}")

    def _refuse(self, cause: Cause) -> None:
        self._set_status(NodeStatus.REFUSED, cause)
        self._wait(_RETRY_REFUSED_NS)

    def _wait(self, nanoseconds: int) -> None:
        """Until the node boots or the time is over."""
        self._booted.wait(nanoseconds)
        self._booted.clear()

    def stop_node(self) -> None:
        """NMT stop: the device does not do what its owner commands. The next bring-up starts it again."""
        self.operation.stopped = True
        self._nmt(NmtCommand.STOP)

    def _nmt(self, command: NmtCommand) -> None:
        self.heartbeat.commanded()
        self.network.send(NMT, bytes((command, self.settings.node_id)))

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

    def _read_known(self) -> KnownDevice:
        """The device that is there, without its revision."""
        vendor_id, product_code, serial_number = (self.sdo.read_optional(IDENTITY, subindex) for subindex in (1, 2, 4))
        return KnownDevice(vendor_id, product_code, serial_number=serial_number)

    def _may_have(self, index: int) -> bool:
        """Whether the data sheet has an object; the built-in ones do not have everything."""
        return self.settings.eds is None or index in self.sdo.dictionary

    def _receiver(self, slot: TpdoSlot) -> PdoReceiver | PdoCallback:
        """What takes the frames of a TPDO. Only one on SYNC has a second one: the others are also sent on change."""
        second = slot.second
        if second is None:
            return slot

        def receive(data: bytes, now: int) -> None:
            second.see(self.network.syncs)
            slot.receive(data, now)

        return receive

    def _use_plan(self, plan: PdoPlan) -> None:
        settings = self.settings
        self.operation = planned(plan, settings, self._image, self.sdo.doubles, self.length_errors)
        for item in plan.rpdos:
            self.network.claim(item.cob_id, f"{item.pdo} of {self.kind.name} {settings.node_id}")
        self.network.require_sync(settings.node_id, required=plan.needs_sync)
        if plan != self.plan:
            self.plan = plan
            for line in plan.lines:
                self._notify(Notice.PROGRESS, line)

    @property
    def _interrupted(self) -> bool:
        """Whether the node has restarted during the bring-up, or its layout has changed."""
        return self._booted.is_set() or self._reconfigure

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

    def _supervise(self) -> None:
        """Online: run jobs, monitor heartbeat, TPDOs and boot-ups. Returns when the node must be started again."""
        if self._unconfirmed is not None:  # another tool wrote during the bring-up
            self._lose(Lost(Cause(self._unconfirmed.text, _TOOL), Loss.OTHER_TOOL))
        self.network.watch(self._monitor)
        try:
            self._work()
        finally:
            self.network.unwatch(self._monitor)

    def _monitor(self, now: int) -> None:
        """Every 20 ms, outside the task, which costs more: it is woken when there is something for it."""
        if self.sdo.doubles.begins(now):
            self.operation.compare_positions(self.sdo.doubles)
        self._watch(now)
        if self.status is _ONLINE and now < self._check_at:
            for part in self.operation.parts:
                if part.due(now):
                    break
            else:
                if self._wake.awaited and not self.sdo.awaits_answer:
                    self._ask(now)
                return
        self._wake.set()

    def _watch(self, now: int) -> None:
        """Lose a node that must not be trusted any more. One that a job holds is not used anyway."""
        if self.status is _ONLINE and self._unconfirmed is None:
            if self.polling.objects:
                self._polled.forget_old(now)
            if (lost := self._losses.find(self.settings, self.operation, now)) is not None:
                self._lose(lost)

    def _lose(self, lost: Lost) -> None:
        """The cyclic side uses the node no longer. Its task, whose access ends, only has to repair."""
        self.network.drop_waiting()
        self.loss = lost.by
        self._set_status(NodeStatus.LOST, lost.cause)
        self.sdo.interrupt()
        self._wake.set()

    def _ask(self, now: int) -> None:
        """Begin to read an object without the task, which has no access now, nor a question."""
        sdo = self.sdo
        if sdo.doubles.questions:
            sdo.doubles.questions -= 1
            sdo.ask(DEVICE_TYPE, 0, lambda _: None)
        else:
            self.question(now)

    def _work(self) -> None:
        failure = ""
        while True:
            self._wake.wait()
            self._wake.clear()
            if self._jobs:
                self._jobs.run_next()
                if self._jobs:
                    self._wake.set()
            now = self.loop.now()
            if self._reconfigure:
                self._set_status(NodeStatus.CONFIGURING, Cause("telegram changed"))
                return
            if self.status is not _ONLINE:
                self._give_up()
                if self.sdo.doubles.proof:
                    raise self.sdo.two_devices()
                return
            if now >= self._check_at and not self._jobs:
                self._set_status(NodeStatus.CONFIGURING, Cause(self.unconfirmed))
                return
            try:
                self._work_parts(now)
                failure = ""
            except (SdoAbortedError, SdoCommunicationError, CanopenError, struct.error, ValueError) as error:
                if self.status is _ONLINE and failure != (failure := str(error)):  # log it once until it changes
                    self._notify(Notice.PROGRESS, f"object without PDO: {failure}")

    def _give_up(self) -> None:
        """The owner stops the device meanwhile; a node that does not answer is stopped by NMT."""
        seen = self.heartbeat.time
        if self._booted.wait(self.settings.heartbeat_ms * 2 * MS):
            return
        if self.heartbeat.time == seen:
            self._nmt(NmtCommand.STOP)

    def _work_parts(self, now: int) -> None:
        for part in self.operation.parts:
            if part.due(now):
                part.work(now)
        if not self.sdo.awaits_answer:
            self._ask(now)

    # -- frames of the node ---------------------------------------------------------------------------------------------

    def _on_heartbeat(self, data: bytes, now: int) -> None:
        if self.heartbeat.receive(data, now):
            self._booted.set()
            if self.status is NodeStatus.ONLINE:
                lost = self._losses.by_other_master() or Lost(Cause("boot-up message"))
                self._notify(Notice.BOOT, lost.cause.evidence, lost.by, lost.cause.remedy)
        if self.heartbeat.in_row == OFTEN:
            period = f"{self.heartbeat.gap // MS} ms, 1017h is {self.settings.heartbeat_ms}"
            self._notify(Notice.PROGRESS, f"heartbeat comes every {period}")
        self._watch(now)

    def _on_other_request(self, data: bytes, _now: int) -> None:
        self.sdo.doubles.requested(data)
