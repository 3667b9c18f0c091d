"""The client of one CANopen node: brings it into operation on a bus and keeps watching it.

Source: CiA DS 301 (NMT, heartbeat, EMCY, SDO, PDO), docs/translation.md "Losses". The cyclic side (``refresh``) never
waits; bring-up and user SDO jobs run in the node's own task on the loop. A device profile derives from ``NodeClient`` and adds
its images and what it configures.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable
from concurrent.futures import Future
from typing import Final, Self, TypeVar

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import CanopenError, SdoAbortedError, SdoCommunicationError
from pdgw.ds301.communication import (
    DEVICE_TYPE,
    ERROR_CONTROL,
    NMT,
    SDO_REQUEST,
    NmtCommand,
)
from pdgw.ds301.loop.jobs import Jobs
from pdgw.ds301.loop.loop import Task
from pdgw.ds301.node.bring_up import NOT_STARTED, BringUp, NodeSetup, S
from pdgw.ds301.node.heartbeat import OFTEN
from pdgw.ds301.node.losses import Losses
from pdgw.ds301.node.node import Cause, Loss, Lost, NodeStatus, Notice
from pdgw.ds301.node.operation import NEVER, Unconfirmed
from pdgw.ds301.pdo import PdoDirection, PdoLayout

log = logging.getLogger("gateway")

T = TypeVar("T")

_RETRY_ABSENT_NS: Final = 500 * MS
_RETRY_REFUSED_NS: Final = 5 * SECOND
_CHECK_AFTER_NS: Final = 200 * MS
"""A configuration is written object by object: it is checked this time after the last one."""
_TOOL: Final = "disconnect the other tool, or have it only read"
_HANGS: Final = "check supply and plug of the device, then switch it off and on"
_CHECKED: Final = "another tool wrote to its configuration"
_ONLINE: Final = NodeStatus.ONLINE


class NodeClient(BringUp[S]):
    """One node, supervised."""

    def __init__(self, setup: NodeSetup[S]) -> None:
        super().__init__(setup)
        network, settings = setup.network, setup.settings
        self.command: Callable[[int, int, bytes], None] = self.sdo.write
        """In a job: SDO write of a value that the owner commands: index, subindex and data."""
        self.write_for_client: Callable[[int, int, bytes], None] = self.sdo.write
        """The same for a parameter client."""
        self.question: Callable[[int], bool] = lambda _: False
        """Begin to read an object without the task at this time, if it is due; False: it is not."""
        self._losses = Losses(
            settings.node_id,
            network,
            self.sdo,
            self.heartbeat,
            self.emergencies,
            self.polling,
            self._polled,
            self._booted,
        )
        self.loss: Loss | None = None
        """Who caused the last loss, if not the node."""
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

    # -- the owner's side ---------------------------------------------------------------------------------------------

    @property
    def length_errors(self) -> int:
        """TPDOs shorter than their mapping, ignored."""
        return self.operation.length_errors

    @property
    def is_first_request(self) -> bool:
        """The first request to the node was neither answered nor missed yet."""
        return self.cause.evidence == NOT_STARTED

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
        self.network.sync.require(self.settings.node_id, required=False)
        if self._task is not None:
            self._task = None
            self.sdo.close()
            self.emergencies.close()
            for cob_id, take in self._receivers:
                self.network.unsubscribe(cob_id, take)

    def stop_node(self) -> None:
        """NMT stop: the device does not do what its owner commands. The next bring-up starts it again."""
        self.operation.stopped = True
        self._nmt(NmtCommand.STOP)

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

    # -- trust --------------------------------------------------------------------------------------------------------

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

    # -- the node's task ----------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._live()
        except Exception:
            # The node is not supervised any more, so it must not count as online.
            self._set_status(NodeStatus.REFUSED, Cause("its task ended with an unexpected error, see the log"))
            self._jobs.fail(self._not_online)
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

    def _absent(self, text: str) -> None:
        if self.status is not NodeStatus.LOST:
            self._set_status(NodeStatus.OFFLINE, Cause(text))
        elif self.cause is self._losses.restarted:
            self.cause = Cause(f"{self.cause.evidence}, and has answered no SDO request since", _HANGS)
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

    def _supervise(self) -> None:
        """Online: run jobs, monitor heartbeat, TPDOs and boot-ups. Returns when the node must be started again."""
        if self._unconfirmed is not None:  # another tool wrote during the bring-up
            self._lose(Lost(Cause(self._unconfirmed.text, _TOOL), Loss.OTHER_TOOL))
        self.network.checks.add(self._monitor)
        try:
            self._work()
            self._jobs.fail(self._not_online)
        finally:
            self.network.checks.remove(self._monitor)

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

    def _work_parts(self, now: int) -> None:
        for part in self.operation.parts:
            if part.due(now):
                part.work(now)
        if not self.sdo.awaits_answer:
            self._ask(now)

    def _give_up(self) -> None:
        """The owner stops the device meanwhile; a node that does not answer is stopped by NMT."""
        seen = self.heartbeat.time
        if self._booted.wait(self.settings.heartbeat_ms * 2 * MS):
            return
        if self.heartbeat.time == seen:
            self._nmt(NmtCommand.STOP)

    def _not_online(self) -> CanopenError:
        return self.kind.error_type(
            f"{self.kind.name} {self.settings.node_id}", self.status.value, "online to be read or written"
        )

    # -- beside the task ----------------------------------------------------------------------------------------------

    def _monitor(self, now: int) -> None:
        """Every 20 ms, outside the task, which costs more: it is woken when there is something for it."""
        if self.sdo.doubles.begins(now):
            self.operation.compare_positions(self.sdo.doubles)
        self._watch(now)
        if self.status is _ONLINE and (self._unconfirmed is None or now < self._unconfirmed.check_at):
            for part in self.operation.parts:
                if part.due(now):
                    break
            else:
                if self._wake.awaited and not self.sdo.awaits_answer:
                    self._ask(now)
                return
        self._wake.set()

    def _ask(self, now: int) -> None:
        """Begin to read an object without the task, which has no access now, nor a question."""
        sdo = self.sdo
        if sdo.doubles.questions:
            sdo.doubles.questions -= 1
            sdo.ask(DEVICE_TYPE, 0, lambda _: None)
        else:
            self.question(now)

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
        if self._change_status(NodeStatus.LOST, lost.cause):
            notice = Notice.BUS_LOST if self._losses.bus_failed(self.operation) else Notice.LOST
            self._notify(notice, lost.cause.evidence, lost.by, lost.cause.remedy)
        self._jobs.fail(self._not_online)
        self.sdo.interrupt()
        self._wake.set()

    # -- frames of the node -------------------------------------------------------------------------------------------

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
