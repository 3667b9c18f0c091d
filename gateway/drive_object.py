"""What a drive object (DO) of the gateway is, drive or encoder: a translator, a node, their faults, and who watches both.

Its cyclic side (``step``) never waits; SDO work a translator asks for runs in the node's task and is answered in a later
cycle. Source: docs/translation.md "Loss and doubt".
"""

from __future__ import annotations

import abc
import logging
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from types import MappingProxyType
from typing import Any, ClassVar

from pdgw.ds301.client import NodeClient, NodeEvent, NodeStatus
from pdgw.ds301.configuration import CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT
from pdgw.ds301.network import CanNetwork
from pdgw.ds301.nmt import NmtCommand
from pdgw.gateway.config import AxisConfig, EncoderConfig
from pdgw.gateway.faults import FaultLog, FaultRecord
from pdgw.gateway.reasons import GATEWAY_FAULTS, Reason
from pdgw.gateway.translator.base import BaseTranslator, SdoWrite
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Telegram

log = logging.getLogger("gateway")

_ACKNOWLEDGE = signal("STW1").bit("FAULT_ACKNOWLEDGE").mask
_ACKNOWLEDGE_NS = 1_000_000_000
"""So long may a device take to leave its fault."""
_CANOPEN_ERRORS = range(0x8100, 0x8300)
"""EMCY classes 81xxh communication and 82xxh protocol error."""
_SAME_EVENT_NS = 1_000_000_000
"""What repeats is told once in this time: a loose contact must not push the first cause out of the fault buffer."""
OWNED = frozenset({CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT})
"""What guards gateway and device against each other."""
INTERNAL_FAULT = 10
CANOPEN_FAULT = 12


class DriveObject(abc.ABC):
    """A drive object with a node behind it, which it may share with others."""

    kind: ClassVar[str]
    """``axis`` or ``encoder``, in the log."""
    fault_of_emcy: ClassVar[Mapping[int, int]] = MappingProxyType({})
    """Fault number (P947) of an EMCY error code."""
    telegram_numbers: ClassVar[tuple[int, ...]]
    """What P922 may select."""

    config: AxisConfig | EncoderConfig

    def __init__(self, do_id: int, network: CanNetwork, chosen: Telegram) -> None:
        self.do_id = do_id
        self.network = network
        self.telegram = chosen
        self.fault_log = FaultLog(network.loop.now())
        self.actuals: Sequence[int] = (0,) * len(chosen.actuals.signals)
        self.good = False
        """The actual values are valid: the IOPS of the drive object."""
        self.last_setpoints: Sequence[int] | None = None
        """What the PLC last sent, also after its loss."""
        self._acknowledge_seen = False
        self._acknowledge_until = 0
        self._restart_expected = False
        self._generation = 0
        self._told_reason: Reason | None = None
        self._seen_reason: Reason | None = None
        self._reason_may_differ = False
        """Something else than the translator's reason changed that ``reason`` depends on."""
        self._sdo: Future[None] | None = None
        self._sdo_writes: tuple[SdoWrite, ...] | None = None
        self._refusal = ""
        self._absent = False
        self._references_changed = False
        self._last_emergency = -_SAME_EVENT_NS
        self._told: dict[object, int] = {}
        self._emergencies: dict[object, int] = {}

    # -- the device's part ------------------------------------------------------------------------------------------------

    @property
    @abc.abstractmethod
    def client(self) -> NodeClient[Any]:
        """The client of its node."""

    @property
    @abc.abstractmethod
    def _translator(self) -> BaseTranslator[Any, Any]: ...

    @abc.abstractmethod
    def step(self, setpoints: Sequence[int] | None, now: int) -> None:
        """One cycle: feedback in, translate, commands out. ``actuals`` and ``good`` are new afterwards."""

    @property
    @abc.abstractmethod
    def powered(self) -> bool:
        """Something may move."""

    @property
    def released(self) -> bool:
        """An interlock is released: an OFF does nothing but stop. What has no interlock starts nothing either."""
        return False

    @property
    @abc.abstractmethod
    def faulty(self) -> bool:
        """The device is still in fault: an acknowledge has nothing to do yet."""

    @abc.abstractmethod
    def entry_size(self, index: int, subindex: int) -> tuple[int, bool]:
        """Bytes of an object the translator writes, and whether it is signed."""

    @abc.abstractmethod
    def change_telegram(self, number: int) -> None:
        """P922: another telegram. GatewayError where it is not possible."""

    @abc.abstractmethod
    def owns(self, index: int, subindex: int) -> bool:
        """The gateway itself writes this object: nobody else may."""

    @abc.abstractmethod
    def is_reference(self, index: int, subindex: int) -> bool:
        """The gateway has a copy of this object, which a write makes old."""

    @abc.abstractmethod
    def read_references(self, client: NodeClient[Any]) -> None:
        """Read the copies anew, in the node's task."""

    @abc.abstractmethod
    def set_sign_of_life_tolerance(self, failures: int) -> None:
        """P925."""

    @property
    def node_id(self) -> int:
        """CANopen node-ID."""
        return self.config.node_id

    @property
    def reason(self) -> Reason | None:
        """Why it does not do what the PLC asks, None when it does."""
        return self._translator.reason

    @property
    def warning(self) -> bool:
        """A warning of the gateway stands."""
        return False

    # -- cyclic -------------------------------------------------------------------------------------------------------

    def _take_setpoints(self, setpoints: Sequence[int], now: int) -> None:
        """Remember them; a rising edge of bit 7, the same in STW1, STW2_ENC and the Controlword, acknowledges."""
        self.last_setpoints = setpoints
        acknowledge = bool(setpoints[0] & _ACKNOWLEDGE)
        if acknowledge and not self._acknowledge_seen:
            self._acknowledge_until = now + _ACKNOWLEDGE_NS
        self._acknowledge_seen = acknowledge

    def _after_step(self, translator: BaseTranslator[Any, Any], device_ok: bool, now: int) -> None:
        self.good = device_ok
        if self._acknowledge_until and device_ok:
            self._acknowledge(now)
        if translator.sdo_request is not None or self._sdo is not None:
            self._serve_sdo_request(translator)
        if translator.events:
            self._drain_events(translator, now)
        if translator.reason is not self._seen_reason or self._reason_may_differ:
            self._seen_reason = translator.reason
            self._reason_may_differ = False
            self._tell_reason()

    def _tell_reason(self) -> None:
        reason = self.reason
        if reason is not self._told_reason:
            self._told_reason = reason
            log.info("%s %d: %s", self.kind, self.do_id, reason.value if reason else "obeys the PLC")

    def _acknowledge(self, now: int) -> None:
        """The fault buffer moves on when the device has left its fault; a cause that stays needs another edge."""
        if not self.faulty:
            self._acknowledge_until = 0
            self.fault_log.acknowledge()
        elif now > self._acknowledge_until:
            self._acknowledge_until = 0

    def _serve_sdo_request(self, translator: BaseTranslator[Any, Any]) -> None:
        if self._sdo is None:
            writes = translator.sdo_request
            if writes is not None:
                self._sdo_writes = writes
                self._sdo = self.client.submit(lambda client: self._write_all(client, writes))
        elif self._sdo.done():
            error = self._sdo.exception()
            self._sdo = None
            # The translator may have withdrawn or replaced the request meanwhile: this is no answer to another one.
            if translator.sdo_request is self._sdo_writes:
                translator.sdo_request = None
                translator.sdo_done(None if error is None else str(error))

    def _write_all(self, client: NodeClient[Any], writes: Sequence[SdoWrite]) -> None:
        for item in writes:
            size, signed = self.entry_size(item.index, item.subindex)
            client.write(item.index, item.subindex, item.value.to_bytes(size, "little", signed=signed))

    def _drain_events(self, translator: BaseTranslator[Any, Any], now: int) -> None:
        for event in translator.events:
            self.raise_fault(event.number, event.detail, now)
        translator.events.clear()

    def _tell(self, number: int, detail: str, now: int) -> None:
        if _is_new(self._told, number, now):
            self.raise_fault(number, detail, now)

    def _telegram_changed(self, chosen: Telegram) -> None:
        self.telegram = chosen
        self.actuals = (0,) * len(chosen.actuals.signals)
        self._sdo = None
        log.info("%s %d: telegram %d selected", self.kind, self.do_id, chosen.number)

    # -- beside the cycle -----------------------------------------------------------------------------------------------

    def raise_fault(self, number: int, detail: str, now: int) -> None:
        """A fault of the gateway's own table."""
        fault = GATEWAY_FAULTS[number]
        self._record(FaultRecord(number, fault.code, 0, f"{fault.name}: {detail}", now, fault.is_warning))

    @property
    def faults(self) -> Sequence[FaultRecord]:
        """What happened lately, warnings included, oldest first."""
        return self.fault_log.history

    def reset_node(self) -> None:
        """P972: restart of the node; it is configured anew by itself and starts nothing."""
        self._restart_expected = True
        self.network.send(0, bytes((NmtCommand.RESET_NODE, self.node_id)))

    def references_changed(self) -> None:
        """The references were read anew; the next cycle takes them."""
        self._references_changed = True

    def _record(self, record: FaultRecord) -> None:
        self.fault_log.enter(record)
        log.log(
            logging.WARNING if record.is_warning else logging.ERROR,
            "%s %d: fault %d, code %04Xh: %s",
            self.kind,
            self.do_id,
            record.number,
            record.code,
            record.text,
        )

    def on_node_event(self, event: NodeEvent) -> None:
        """Something happened to the node."""
        now = event.time_ns
        status = self.client.status
        if event.kind == "emcy":
            self._emergency(event, now)
        elif self._restart_expected and (event.kind == "boot" or status is NodeStatus.LOST):
            self._tell_status("restarts, as asked: " + event.text)
        elif event.kind == "boot":
            self.raise_fault(105, event.text, now)
        elif event.kind == "refused":
            # Retried every few seconds: the same refusal is one fault.
            if event.text != self._refusal:
                self._refusal = event.text
                self.raise_fault(106, event.text, now)
        elif event.kind == "set-point":
            self.raise_fault(119, event.text, now)
        elif status is NodeStatus.LOST:
            self.raise_fault(101 if self.network.healthy else 102, event.text, now)
        elif status is NodeStatus.ONLINE:
            self._refusal = ""
            self._restart_expected = False
            self._absent = False
            self._tell_status(event.text)
        elif status is NodeStatus.OFFLINE:
            # Asked again every half second: the same silence is one fault.
            if not self._absent:
                self._absent = True
                self.raise_fault(121, event.text, now)
        elif not self._refusal and not self._absent:
            self._tell_status(event.text)

    def _tell_status(self, text: str) -> None:
        log.info("%s %d: node %s", self.kind, self.do_id, text)

    def _emergency(self, event: NodeEvent, now: int) -> None:
        """An EMCY: a fault while its error register has a bit set, else a warning."""
        if event.code == 0:
            self._emergencies.clear()
            self.fault_log.emergency_over()
            self._tell_status(event.text)
            return
        self._last_emergency = now
        if not _is_new(self._emergencies, (event.code, event.register, event.data), now):
            log.debug("%s %d: %s again", self.kind, self.do_id, event.text)
            return
        number = CANOPEN_FAULT if event.code in _CANOPEN_ERRORS else INTERNAL_FAULT
        number = self.fault_of_emcy.get(event.code, number)
        value = int.from_bytes(event.data[:4], "little")
        self._record(FaultRecord(number, event.code, value, event.text, now, is_warning=event.register == 0))


def _is_new(told: dict[object, int], what: object, now: int) -> bool:
    """Whether this was not told within the last second; ``told`` takes note of it."""
    if now - told.get(what, now - _SAME_EVENT_NS) < _SAME_EVENT_NS:
        return False
    told[what] = now
    return True
