"""One axis: a translator, a drive, and what watches both.

The axis owns the drive's images. Its cyclic side (``step``) never waits; SDO work a translator asks for runs on the drive's
worker and is answered in a later cycle. Source: docs/translation.md "Loss and doubt".
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from concurrent.futures import Future

from ds301.network import CanNetwork
from ds301.nmt import NmtCommand
from dsp402.drive import DriveClient, DriveEvent, DriveStatus
from dsp402.faults import DRIVE_FAULTS
from dsp402.objects import DRIVE_OBJECTS
from dsp402.pdo import LAYOUTS
from dsp402.states import STATE_OF_STATUS, Command, State, StatusBit, state_of
from gateway.config import AxisConfig
from gateway.errors import GatewayError
from gateway.faults import FaultLog, FaultRecord
from gateway.reasons import GATEWAY_FAULTS, Reason
from gateway.translator.base import SdoWrite
from gateway.translator.factory import make_translator, pdo_operation
from profidrive.signals import signal
from profidrive.telegrams import Telegram, telegram

log = logging.getLogger("gateway")

_FAULT_OF_EMCY = {fault.error_code: fault.number for fault in DRIVE_FAULTS.values()}
_INTERNAL_FAULT = 10
_ACKNOWLEDGE = signal("STW1").bit("FAULT_ACKNOWLEDGE").mask
_ACKNOWLEDGE_NS = 1_000_000_000
"""So long may a drive take to leave its fault."""
_FAULTY = (State.FAULT, State.FAULT_REACTION_ACTIVE)
_CANOPEN_FAULT = 12
_CANOPEN_ERRORS = range(0x8100, 0x8300)
"""EMCY classes 81xxh communication and 82xxh protocol error."""
_SAME_EVENT_NS = 1_000_000_000
"""What repeats is told once in this time: a loose contact must not push the first cause out of the fault buffer."""
_WATCHED = 0x7F | StatusBit.INTERNAL_LIMIT
_DISABLED = (State.SWITCHED_ON, State.READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED)
_POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)


class Axis:
    """A drive object (DO) with a drive behind it."""

    def __init__(
        self, config: AxisConfig, network: CanNetwork, cycle_time_ms: float, number: int | None = None
    ) -> None:
        self.config = config
        self.network = network
        self.do_id = config.do_id
        self.fault_log = FaultLog(time.monotonic_ns())
        self._cycle_time_ms = cycle_time_ms
        number = config.telegram if number is None else number
        self.telegram: Telegram = telegram(number)
        self.translator = make_translator(number, config.translator_settings)
        self.drive = DriveClient(
            network,
            config.drive_settings(number, cycle_time_ms),
            LAYOUTS[pdo_operation(number)],
            self._on_drive_event,
        )
        self.actuals: Sequence[int] = (0,) * len(self.telegram.actuals.signals)
        self.good = False
        """The actual values are valid: the axis' IOPS."""
        self.last_setpoints: Sequence[int] | None = None
        """What the PLC last sent, also after its loss."""
        self._acknowledge_seen = False
        self._acknowledge_until = 0
        self._restart_expected = False
        self._generation = 0
        self._reason: Reason | None = None
        self._sdo: Future[None] | None = None
        self._sdo_writes: tuple[SdoWrite, ...] | None = None
        self._refusal = ""
        self._absent = False
        self._references_changed = False
        self._shown = 0
        self._told: dict[object, int] = {}
        self._emergencies: dict[object, int] = {}

    # -- cyclic -------------------------------------------------------------------------------------------------------

    def step(self, setpoints: Sequence[int] | None, now: int) -> None:
        """One cycle: feedback in, translate, commands out. ``actuals`` and ``good`` are new afterwards."""
        drive = self.drive
        translator = self.translator
        drive_ok = drive.refresh(now)
        if drive.generation != self._generation:
            self._generation = drive.generation
            translator.drive_restarted()
            translator.set_references(drive.references, drive.homing_method)
        elif self._references_changed:
            self._references_changed = False
            translator.set_references(drive.references, drive.homing_method)
        if setpoints is not None:
            self.last_setpoints = setpoints
            self._watch_acknowledge(setpoints[0], now)
        commanded = translator.command.controlword
        self.actuals = translator.step(setpoints, drive.feedback, drive_ok, now)
        self.good = drive_ok
        if self._acknowledge_until and drive_ok:
            self._acknowledge(now)
        drive.send(translator.command, now)
        if translator.sdo_request is not None or self._sdo is not None:
            self._serve_sdo_request()
        if translator.events:
            self._drain_events(now)
        shown = drive.feedback.statusword & _WATCHED if drive_ok else 0
        if shown != self._shown:
            self._status_changed(shown, commanded, now)
        reason = self.reason
        if reason is not self._reason:
            self._reason = reason
            log.info("axis %d: %s", self.do_id, self._reason.value if self._reason else "obeys the PLC")

    def _watch_acknowledge(self, word: int, now: int) -> None:
        """A rising edge of bit 7, the same in STW1, STW2 of encoders and the Controlword."""
        acknowledge = bool(word & _ACKNOWLEDGE)
        if acknowledge and not self._acknowledge_seen:
            self._acknowledge_until = now + _ACKNOWLEDGE_NS
        self._acknowledge_seen = acknowledge

    def _acknowledge(self, now: int) -> None:
        """The fault buffer moves on when the drive has left its fault; a cause that stays needs another edge."""
        if state_of(self.drive.feedback.statusword) not in _FAULTY:
            self._acknowledge_until = 0
            self.fault_log.acknowledge()
        elif now > self._acknowledge_until:
            self._acknowledge_until = 0

    def _status_changed(self, shown: int, commanded: int, now: int) -> None:
        """Tell what the drive does of its own accord.

        ``shown``: the Statusword bits that are watched, 0 without a drive; ``commanded``: the Controlword it had.
        """
        old, self._shown = self._shown, shown
        state, previous = STATE_OF_STATUS[shown & 0x7F], STATE_OF_STATUS[old & 0x7F]
        if state is None and previous is not None:
            self._tell(107, f"Statusword {self.drive.feedback.statusword:04X}h", now)
        elif (
            previous is State.OPERATION_ENABLED
            and state in _DISABLED
            and Command.ENABLE_OPERATION.matches(commanded)
            and self.translator.reason is Reason.NEEDS_OFF
        ):
            self._tell(122, f"{state.value}, no command of the gateway", now)
        if state is State.OPERATION_ENABLED and shown & ~old & StatusBit.INTERNAL_LIMIT:
            self._tell(112, "limit switch, position or speed limit", now)

    def _tell(self, number: int, detail: str, now: int) -> None:
        if _is_new(self._told, number, now):
            self.raise_fault(number, detail, now)

    def _serve_sdo_request(self) -> None:
        translator = self.translator
        if self._sdo is None:
            writes = translator.sdo_request
            if writes is not None:
                self._sdo_writes = writes
                self._sdo = self.drive.submit(lambda drive: _write_all(drive, writes))
        elif self._sdo.done():
            error = self._sdo.exception()
            self._sdo = None
            # The translator may have withdrawn or replaced the request meanwhile: this is no answer to another one.
            if translator.sdo_request is self._sdo_writes:
                translator.sdo_request = None
                translator.sdo_done(None if error is None else str(error))

    def _drain_events(self, now: int) -> None:
        for event in self.translator.events:
            fault = GATEWAY_FAULTS[event.number]
            self.raise_fault(fault.number, event.detail, now)
        self.translator.events.clear()

    # -- any thread ---------------------------------------------------------------------------------------------------

    @property
    def powered(self) -> bool:
        """The power stage may be on."""
        return self.drive.status is DriveStatus.ONLINE and state_of(self.drive.feedback.statusword) in _POWERED

    @property
    def reason(self) -> Reason | None:
        """Why the axis does not do what the PLC asks, None when it does."""
        reason = self.translator.reason
        return Reason.INTERNAL_LIMIT if reason is None and self._shown & StatusBit.INTERNAL_LIMIT else reason

    @property
    def warning(self) -> bool:
        """A warning of the gateway stands."""
        return self.translator.warning or bool(self._shown & StatusBit.INTERNAL_LIMIT)

    def raise_fault(self, number: int, detail: str, now: int) -> None:
        """A fault of the gateway's own table."""
        fault = GATEWAY_FAULTS[number]
        self._record(FaultRecord(number, fault.code, 0, f"{fault.name}: {detail}", now, fault.is_warning))

    @property
    def faults(self) -> Sequence[FaultRecord]:
        """What happened lately, warnings included, oldest first."""
        return self.fault_log.history

    def reset_drive(self) -> None:
        """P972: restart of the node; it is configured anew by itself and starts nothing."""
        self._restart_expected = True
        self.network.send(0, bytes((NmtCommand.RESET_NODE, self.config.node_id)))

    def references_changed(self) -> None:
        """The drive's references were read anew; the next cycle takes them."""
        self._references_changed = True

    def change_telegram(self, number: int) -> None:
        """P922: another telegram. Only the cyclic thread may call it; GatewayError while the axis is in operation."""
        if self.powered:
            raise GatewayError(
                f"axis {self.do_id}: telegram {number} cannot be selected while the axis is in operation"
            )
        translator = make_translator(number, self.config.translator_settings)
        layout = LAYOUTS[pdo_operation(number)]
        self.translator = translator
        self.telegram = telegram(number)
        self.actuals = (0,) * len(self.telegram.actuals.signals)
        self._sdo = None
        self.drive.reconfigure(layout, self.config.drive_settings(number, self._cycle_time_ms))
        log.info("axis %d: telegram %d selected", self.do_id, number)

    def _record(self, record: FaultRecord) -> None:
        self.fault_log.enter(record)
        log.log(
            logging.WARNING if record.is_warning else logging.ERROR,
            "axis %d: fault %d, code %04Xh: %s",
            self.do_id,
            record.number,
            record.code,
            record.text,
        )

    def _on_drive_event(self, event: DriveEvent) -> None:
        """From the drive's worker or the bus reader."""
        now = event.time_ns or time.monotonic_ns()
        if event.kind == "emcy":
            self._emergency(event, now)
        elif self._restart_expected and (event.kind == "boot" or self.drive.status is DriveStatus.LOST):
            log.info("axis %d: drive restarts, as asked: %s", self.do_id, event.text)
        elif event.kind == "boot":
            self.raise_fault(105, event.text, now)
        elif event.kind == "refused":
            # Retried every few seconds: the same refusal is one fault.
            if event.text != self._refusal:
                self._refusal = event.text
                self.raise_fault(106, event.text, now)
        elif self.drive.status is DriveStatus.LOST:
            self.raise_fault(101 if self.network.healthy else 102, event.text, now)
        elif self.drive.status is DriveStatus.ONLINE:
            self._refusal = ""
            self._restart_expected = False
            self._absent = False
            log.info("axis %d: drive %s", self.do_id, event.text)
        elif self.drive.status is DriveStatus.OFFLINE:
            # Asked again every half second: the same silence is one fault.
            if not self._absent:
                self._absent = True
                self.raise_fault(121, event.text, now)
        elif not self._refusal and not self._absent:
            log.info("axis %d: drive %s", self.do_id, event.text)

    def _emergency(self, event: DriveEvent, now: int) -> None:
        """An EMCY: a fault while its error register has a bit set, else a warning."""
        if event.code == 0:
            self._emergencies.clear()
            log.info("axis %d: %s", self.do_id, event.text)
            return
        if not _is_new(self._emergencies, (event.code, event.register, event.data), now):
            log.debug("axis %d: %s again", self.do_id, event.text)
            return
        number = _CANOPEN_FAULT if event.code in _CANOPEN_ERRORS else _INTERNAL_FAULT
        number = _FAULT_OF_EMCY.get(event.code, number)
        value = int.from_bytes(event.data[:4], "little")
        self._record(FaultRecord(number, event.code, value, event.text, now, is_warning=event.register == 0))


def _is_new(told: dict[object, int], what: object, now: int) -> bool:
    """Whether this was not told within the last second; ``told`` takes note of it."""
    if now - told.get(what, now - _SAME_EVENT_NS) < _SAME_EVENT_NS:
        return False
    told[what] = now
    return True


def _write_all(drive: DriveClient, writes: Sequence[SdoWrite]) -> None:
    for item in writes:
        entry = DRIVE_OBJECTS.entry(item.index, item.subindex)
        size = entry.type.bits // 8
        drive.write(item.index, item.subindex, item.value.to_bytes(size, "little", signed=entry.type.char.islower()))
