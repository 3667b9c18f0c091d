"""A drive object (DO) of the gateway, drive or encoder: a machine, a node, and the transfer of values between them.

No rules here: the machine decides (``gateway.axis``). ``step`` computes the actual values, ``transmit`` sends the RPDOs; neither
waits. SDO work runs beside the exchange.
"""

from __future__ import annotations

import abc
import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import Any, ClassVar

from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import CONSUMER_HEARTBEAT, NMT, PRODUCER_HEARTBEAT, NmtCommand
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.node.node import NodeNotice, NodeStatus, Notice
from pdgw.ds301.node.sdo import DISCONNECT
from pdgw.gateway.axis.values import (
    Events,
    FaultRecord,
    News,
    Outputs,
    RestartAsked,
    SdoAnswer,
    SdoWrite,
    gateway_fault,
    is_answer,
)
from pdgw.gateway.base.fault_numbers import DEVICE_WARNING, By, FaultNumber
from pdgw.gateway.base.reasons import AxisState, Finding, Reason
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.configuration.devices import EncoderConfig
from pdgw.gateway.objects.enable_status import EnableStatus
from pdgw.gateway.objects.fault_buffer import FaultLog, ReportedFault
from pdgw.gateway.objects.happenings import KEPT, Happening
from pdgw.gateway.objects.origins import Origins
from pdgw.gateway.objects.totals import Totals
from pdgw.profidrive.telegrams import Telegram

log = logging.getLogger("gateway")

OWNED = frozenset({(CONSUMER_HEARTBEAT, 1), (PRODUCER_HEARTBEAT, 0)})
"""Objects of the mutual monitoring of gateway and device."""


class DriveObject(abc.ABC):
    """A drive object with a node, which may have several drive objects."""

    kind: ClassVar[str]
    """``axis`` or ``encoder``, in the log."""
    warning_word: ClassVar[str]
    """Where the device shows a warning."""
    telegram_numbers: tuple[int, ...]
    """Telegrams that P922 can select."""

    config: AxisConfig | EncoderConfig

    def __init__(self, do_id: int, network: CanNetwork, chosen: Telegram) -> None:
        self.do_id = do_id
        self.network = network
        self.telegram = chosen
        self.stops = False
        """The last step stops the device: ``transmit`` it before what moves others."""
        self.fault_log = FaultLog(network.loop.now())
        self.origins = Origins(network.loop.now())
        self.totals = Totals()
        self.last_setpoints: Sequence[int] | None = None
        """The last setpoints of the PLC, also after its loss."""
        self.log_event: Callable[[str, int | None, str, int], object] = lambda *_: None
        """``EventLog.add`` of the gateway."""
        self.check_chain: Callable[[], EnableStatus] = lambda: EnableStatus(AxisState.STARTING, ())
        """Checks the chain of enables (``enable_chain``)."""
        self.link_finding: Callable[[], Finding | None] = lambda: None
        """Why the PLC's frames do not count; None if they do, or if none come."""
        self.explain: Callable[[FaultRecord], FaultRecord] = lambda record: record
        """A fault with what led to it, if that is known."""
        self.supplied = False
        """The last step had setpoints of the PLC."""
        self.fresh = True
        """The setpoints of the next step came with it."""
        self._news: deque[News] = deque()
        """Events since the last step."""
        self._generation = 0
        self._reported_reason: Reason | None = None
        self._shown_reason: Reason | None = None
        """The reason logged last."""
        self._operated = False
        """Whether it was in operation then."""
        self.shown = EnableStatus(AxisState.STARTING, ())
        """As it was logged or shown last."""
        self._shown_status: NodeStatus | None = None
        self._warned = False
        """The device showed a warning in the last step."""
        self.happenings: deque[Happening] = deque(maxlen=KEPT)
        """Faults, warnings and reasons, the oldest first."""
        self.gateway_stops = False
        """The gateway is being stopped: this is not a loss of the PLC."""
        self._writes: tuple[SdoWrite, ...] | None = None
        """Writes of the last SDO job."""
        self.given: list[tuple[str, object]] | None = None
        """What the machine was given beside the values of each step; the recorder empties it. None: nothing is recorded."""
        self._future: Future[None] | None = None

    # -- the device's part ------------------------------------------------------------------------------------------------

    @property
    @abc.abstractmethod
    def client(self) -> NodeClient[Any]:
        """The client of its node."""

    @property
    @abc.abstractmethod
    def outputs(self) -> Outputs:
        """Results of the last step."""

    @abc.abstractmethod
    def step(self, setpoints: Sequence[int] | None, now: int) -> Outputs:
        """One cycle: feedback in, decide; returns ``outputs``. Nothing was sent."""

    def transmit(self, now: int) -> None:  # noqa: B027 - an encoder is sent nothing
        """Send what the last step commands."""

    @abc.abstractmethod
    def lasts(self, by: By) -> bool:
        """The cause of a fault of this part is present, or may be; the status word shows it whatever the fault buffer has."""

    @property
    @abc.abstractmethod
    def powered(self) -> bool:
        """Something may move."""

    @property
    def may_have_power(self) -> bool:
        """As ``powered``, also if the drive is lost and has not shown since then that it is off."""
        return self.powered or not self.outputs.known_off

    @property
    def released(self) -> bool:
        """See ``Outputs.released``."""
        return self.outputs.released

    @abc.abstractmethod
    def entry_size(self, index: int, subindex: int) -> tuple[int, bool]:
        """Bytes of an object the machine writes, and whether it is signed."""

    @abc.abstractmethod
    def change_telegram(self, number: int) -> None:
        """P922: another telegram, between two steps. The daemon has checked that nothing moves."""

    @abc.abstractmethod
    def owns(self, index: int, subindex: int) -> bool:
        """Whether the gateway itself writes this object, so that no client may."""

    @abc.abstractmethod
    def is_reference(self, index: int, subindex: int) -> bool:
        """The gateway has a copy of this object, which a write makes old."""

    @abc.abstractmethod
    def read_references(self, client: NodeClient[Any]) -> None:
        """Read the copies again, as a job of the node."""

    @abc.abstractmethod
    def references_changed(self) -> None:
        """The references were read again; the next cycle uses them."""

    @abc.abstractmethod
    def set_sign_of_life_tolerance(self, failures: int) -> None:
        """P925."""

    @property
    def label(self) -> str:
        """Kind, number and name for people: ``axis 3 "slide"``."""
        name = self.config.name
        return f"{self.kind} {self.do_id}" if name is None else f'{self.kind} {self.do_id} "{name}"'

    @property
    def node_id(self) -> int:
        """CANopen node-ID."""
        return self.config.node_id

    @property
    def actuals(self) -> Sequence[int]:
        """Raw actual values in telegram order."""
        return self.outputs.actuals

    @property
    def good(self) -> bool:
        """The actual values are valid: the IOPS of the drive object."""
        return self.outputs.good

    @property
    def reason(self) -> Reason | None:
        """Why it does not do what the PLC asks, None when it does."""
        return self.outputs.reason

    @property
    def faults(self) -> Sequence[FaultRecord]:
        """The latest faults and warnings, oldest first."""
        return self.fault_log.history

    def active_reports(self) -> Iterator[FaultRecord]:
        """Faults that are not acknowledged, and warnings that are active, the newest first."""
        reported = self.fault_log.reported(present=self.outputs.warning)
        return (item.record for item in reported if item.active)

    @property
    def enable_status(self) -> EnableStatus:
        """State word and chain of enables, as the last step left them."""
        return self.check_chain()

    @property
    def cause(self) -> ReportedFault | None:
        """The fault to name first, None when all are acknowledged: the origin, else the oldest."""
        origin = self.origins.present
        return self.fault_log.cause(0 if origin is None else origin.number)

    # -- around the machine's step ----------------------------------------------------------------------------------------

    def _deliver(self, news: list[News]) -> None:
        """Hand over what happened since the last step."""
        future, writes = self._future, self._writes
        if future is not None and writes is not None:
            if self.outputs.writes is not writes and future.cancel():
                self._future = None  # withdrawn before the first write
            elif future.done():
                error = future.exception()
                self._future = None
                news.append(SdoAnswer(writes, None if error is None else str(error)))
        waiting = self._news
        while waiting:
            news.append(waiting.popleft())

    def note(self, kind: str, value: object) -> None:
        """The machine is given ``value``."""
        if self.given is not None:
            self.given.append((kind, value))

    def _note_news(self, news: Sequence[News]) -> None:
        for item in news:
            self.note("answer" if is_answer(item, self.outputs) else "news", item)

    def _serve(self, outputs: Outputs) -> None:
        """Execute and report the requests of a step."""
        writes = outputs.writes
        if writes is not None and writes is not self._writes and self._future is None:
            self._writes = writes
            self._future = self.client.submit(lambda client: self._write_all(client, writes))
        if outputs.events is not None:
            self._report(outputs.events)
        self._reported_reason = outputs.reason
        self._show_reason()

    def _show_reason(self) -> None:
        """Log another reason of the chain than before."""
        enable_status = self.enable_status
        shown = enable_status.reason
        self.log_state(enable_status)
        if shown is not self._shown_reason:
            self._happened(enable_status.happening, stops=self._operated and enable_status.state is not AxisState.OBEYS)
            self._operated = enable_status.state is AxisState.OBEYS
            self._shown_reason = shown
            cause = "" if shown is None else shown.name
            self._log(logging.INFO, "reason", enable_status.sentence, reason=cause)

    def _watch_warning(self, warning: int) -> None:
        """Log the begin of a warning that the device shows. ``warning``: P953."""
        warned = warning & DEVICE_WARNING != 0
        if warned is not self._warned:
            self._warned = warned
            if warned:
                text = f"the device shows a warning ({self.warning_word})"
                self._happened(text)
                self.log_event("warning", self.do_id, text, 0)
                self._log(logging.INFO, "warning", text)

    def log_state(self, status: EnableStatus) -> None:
        """Log the event of another state or reason. A cycle without news does not see all of them; the next status does."""
        before, self.shown = self.shown, status
        if (status.state, status.reason) != (before.state, before.reason):
            self.log_event("reason", self.do_id, status.untimed.sentence, 0)

    def _report(self, events: Events) -> None:
        for record in events.faults:
            self._record(record)
        for text in events.log_lines:
            self._log(logging.INFO, "node", text)
        if events.acknowledged:
            self.fault_log.acknowledge()
            self.origins.acknowledged()

    def _happened(self, text: str, *, stops: bool = False) -> None:
        self.happenings.append(Happening(self.network.loop.now(), self.do_id, text, stops))

    def _log(self, level: int, event: str, text: str, **cause: object) -> None:
        """One line. ``cause``: the field of its budget (``log_budget``)."""
        log.log(level, "%s: %s", self.label, text, extra={"event": event, "do": self.do_id} | cause)

    def _write_all(self, client: NodeClient[Any], writes: Sequence[SdoWrite]) -> None:
        for item in writes:
            size, signed = self.entry_size(item.index, item.subindex)
            client.command(item.index, item.subindex, item.value.to_bytes(size, "little", signed=signed))

    def _telegram_changed(self, chosen: Telegram) -> None:
        self.telegram = chosen
        self.last_setpoints = None
        self._future = self._writes = None
        log.info("%s: telegram %d selected", self.label, chosen.number)

    # -- reports of others ------------------------------------------------------------------------------------------------

    def raise_fault(self, number: FaultNumber, detail: str, now: int, remedy: str = "") -> None:
        """A fault of the gateway's own table."""
        self._record(gateway_fault(number, detail, now, remedy=remedy))

    def report_unusable(self, why: str) -> None:
        """The frames of the connected PLC have no setpoints from now on."""
        self._happened(why, stops=self._operated)
        self._log(logging.WARNING, "plc", why)

    def clear_faults(self) -> None:
        """P952 := 0: what is acknowledged or gone leaves the buffer. What lasts stays, as the status word shows it."""
        by = {fault.value: fault.by for fault in FaultNumber}
        self.fault_log.clear(lambda record: self.lasts(by.get(record.number, By.DRIVE)))
        if self.fault_log.acknowledged:
            self.origins.acknowledged()

    def reset_node(self) -> None:
        """P972: restart the node. It is configured again and starts nothing."""
        self._news.append(RestartAsked())
        self.network.send(NMT, bytes((NmtCommand.RESET_NODE, self.node_id)))

    def _record(self, record: FaultRecord) -> None:
        record = self.explain(record)
        self.fault_log.enter(record)
        self.origins.enter(record)
        if not record.is_warning:
            self.totals.enter(record)
        kind = "warning" if record.is_warning else "fault"
        text = f"{kind} {record.number}: {record.line}"
        self._happened(text, stops=not record.is_warning)
        self.log_event(kind, self.do_id, text, int(record.number))
        level = logging.WARNING if record.is_warning else logging.ERROR
        text = f"fault {record.number}, code {record.code:04X}h: {record.line}"
        self._log(level, kind, text, fault=int(record.number))

    def on_node_event(self, notice: NodeNotice) -> None:
        """What has happened to the node; the next step processes it."""
        self._news.append(notice)
        if notice.notice is Notice.TWO_DEVICES:
            text = f"two devices had node-ID {self.node_id}"
            found = Finding(Reason.DRIVE_OFFLINE, text, (DISCONNECT,), since_ns=notice.time_ns, by=By.BUS)
            self.origins.prove(found)
        if (status := self.client.status) is not self._shown_status:
            self._shown_status = status
            self.log_event("node", self.do_id, f"node {self.node_id}: {status.value}", 0)
