"""Reports of events of a device: each once, with its number, without losing the first cause.

Source: docs/safety.md, docs/parameter-channel.md "Fault buffer".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final, Generic, TypeVar

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.emcy import GENERIC_ERROR, emcy_text
from pdgw.ds301.node.node import Loss, NodeNotice, Notice
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import DriveFault
from pdgw.dsp402.states import STATE_OF_STATUS, State, StatusBit
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.power_states import CONTROLWORDS, Action
from pdgw.gateway.axis.values import CANOPEN_ERRORS, FaultRead, FaultRecord, Outputs, gateway_fault
from pdgw.gateway.base.fault_numbers import INTERNAL_FAULT, By, FaultNumber

K = TypeVar("K")
SAME_EVENT_NS: Final = SECOND
"""A repeated event is reported once in this time, so that a loose contact does not push the first cause out of the fault buffer.
"""
ACKNOWLEDGE_NS: Final = SECOND
"""Longest time in which a device leaves its fault."""
EMERGENCY_PATIENCE_NS: Final = 200 * MS
"""Longest time between an EMCY and the Statusword that shows its fault, in either order."""
EMERGENCIES_KEPT: Final = 64
"""Number of different EMCY that are distinguished at a time."""
CANOPEN_FAULT: Final = 12
"""Number of the manufacturer's table for faults of the communication without their own number."""
_CLASS: Final = 0xFF00
_STAGE_TEMPERATURE: Final = 0x4200
_MOTOR_TEMPERATURE: Final = 0x4300
"""EMCY classes 42xxh temperature of the device and 43xxh of the drive (CiA 402)."""
_VALUE_BYTES: Final = 4
"""Number of an EMCY's manufacturer bytes in P949."""
FAULTY: Final = (State.FAULT, State.FAULT_REACTION_ACTIVE)
POWERED: Final = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
"""The power stage is on."""
_SUPPLIED: Final[Mapping[State | None, int]] = {
    State.NOT_READY_TO_SWITCH_ON: 0,
    State.SWITCH_ON_DISABLED: 1,
    State.FAULT: 1,
    State.READY_TO_SWITCH_ON: 2,
    State.SWITCHED_ON: 3,
}
"""States without power. A drive that shows its supply (Statusword.4) in one of them does so in those above it; many show it in
some of them, or only with their power stage."""
_FAULTS: Final = {
    Notice.BOOT: FaultNumber.NODE_RESTARTED,
    Notice.SET_POINT_REFUSED: FaultNumber.SET_POINT,
    Notice.LOST: FaultNumber.NODE_LOST,
    Notice.BUS_LOST: FaultNumber.BUS_LOST,
}
"""Notices that are a fault each time."""
_BY: Final = {
    None: None,
    Loss.OWN_STOP: By.GATEWAY,
    Loss.OTHER_MASTER: By.OTHER_MASTER,
    Loss.OTHER_TOOL: By.OTHER_MASTER,
}
_RESTARTING: Final = (Notice.BOOT, Notice.LOST, Notice.BUS_LOST)
_REJECTIONS: Final = (Notice.REFUSED, Notice.TWO_DEVICES)
_LOCAL: Final = "switch off what enables the drive: its panel, another tool, or enable at power-on"
_BELOW: Final = (
    State.NOT_READY_TO_SWITCH_ON,
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
)
_PROOF: Final = (*FAULTY, None)
"""A drive that shows one of these has a fault; None: no state of CiA 402."""
_COMMAND: Final = CONTROLWORDS[Action.ENABLE_OPERATION]


class Repetitions(Generic[K]):
    """Time of each report; the oldest is removed when there are too many."""

    def __init__(self) -> None:
        self._reported: dict[K, int] = {}
        self._repeated: dict[K, int] = {}
        """Number of repetitions since the last report."""

    def is_new(self, what: K, now: int) -> bool:
        """Return whether this was not reported within the last second, and store the report."""
        reported = self._reported
        last = reported.get(what)
        if last is not None and now - last < SAME_EVENT_NS:
            self._repeated[what] = self._repeated.get(what, 0) + 1
            return False
        reported.pop(what, None)
        reported[what] = now
        if len(reported) > EMERGENCIES_KEPT:
            oldest = next(iter(reported))
            del reported[oldest]
            self._repeated.pop(oldest, None)
        return True

    def take_repeated(self, what: K) -> int:
        """The number of repetitions since the last report, which is counted from 0 again."""
        return self._repeated.pop(what, 0)

    def clear(self) -> list[tuple[K, int]]:
        """Everything is new again. Returns what was repeated since its last report, and how often."""
        repeated = list(self._repeated.items())
        self._reported.clear()
        self._repeated.clear()
        return repeated


class NodeWatch:
    """The notices of a node to fault records and lines of the log.

    ``proven``: an EMCY with an error proves a fault. An encoder shows its faults by nothing else. A drive may stay in operation
    after one, so it is a warning until the drive shows a fault or leaves operation by itself.
    """

    def __init__(self, outputs: Outputs, *, proven: bool) -> None:
        self._outputs = outputs
        self.proven = proven
        self.unproven: list[FaultRecord] = []
        """EMCY whose fault the drive may still show, the oldest first."""
        self.warnings: dict[int, FaultRecord] = {}
        """EMCY that are warnings, by error code, each as it came last: until the device reports the end of its errors, or an
        acknowledge."""
        self.set_drive(MappingProxyType({}), MappingProxyType({}))
        self._absent = False
        self._refusal = ""
        self.restart_asked = False
        """The gateway itself restarts the node."""
        self._emergencies: Repetitions[tuple[int, bool]] = Repetitions()
        self.last_fault = -SAME_EVENT_NS
        """When the last EMCY that is a fault came."""

    def set_drive(self, faults: Mapping[int, DriveFault], fault_of_emcy: Mapping[int, DriveFault]) -> None:
        """Set the manufacturer's faults of the drive by number, and by EMCY error code."""
        self.fault_of_number, self.fault_of_emcy = faults, fault_of_emcy

    def report_to(self, outputs: Outputs) -> None:
        """The outputs of another machine take over."""
        before, self._outputs = self._outputs, outputs
        outputs.motor_hot, outputs.stage_hot, outputs.drive_error = (
            before.motor_hot,
            before.stage_hot,
            before.drive_error,
        )

    def acknowledged(self) -> None:
        """The fault buffer has moved on: an EMCY that comes again is a new fault."""
        self._emergencies.clear()
        self.warnings.clear()

    def process(self, notice: NodeNotice) -> None:
        """One notice of the node."""
        what = notice.notice
        if what is Notice.EMERGENCY:
            self._emergency(notice)
        elif self.restart_asked and what in _RESTARTING:
            self._log("restarts, as commanded: " + notice.text)
        elif what in _FAULTS:
            self._raise(_FAULTS[what], notice)
        elif what in _REJECTIONS:
            # Repeated every few seconds: the same rejection is one fault.
            if notice.text != self._refusal:
                self._refusal = notice.text
                self._raise(FaultNumber.NODE_REFUSED, notice)
        elif what is Notice.ONLINE:
            self._refusal = ""
            self.restart_asked = self._absent = False
            self._log(notice.text)
        elif what is Notice.ABSENT:
            # Queried every half second: the same missing answer is one fault.
            if not self._absent:
                self._absent = True
                self._raise(FaultNumber.NODE_ABSENT, notice)
        elif not self._refusal and not self._absent:
            self._log(notice.text)

    def _log(self, text: str) -> None:
        self._outputs.happened().log_lines.append(f"node {text}")

    def _raise(self, number: FaultNumber, notice: NodeNotice) -> None:
        self._outputs.fault(gateway_fault(number, notice.text, notice.time_ns, _BY[notice.by], notice.remedy))

    def set_error_code(self, code: int) -> None:
        """An error code of the drive, by EMCY or read."""
        outputs, kind = self._outputs, code & _CLASS
        outputs.drive_error = code
        outputs.motor_hot |= kind == _MOTOR_TEMPERATURE
        outputs.stage_hot |= kind == _STAGE_TEMPERATURE

    def _emergency(self, notice: NodeNotice) -> None:
        """An EMCY: its fault or warning, or the end of all errors."""
        code, now = notice.code, notice.time_ns
        if code == 0 and notice.register:
            self._log(notice.text)  # one error has ended, and others are there
            return
        if code == 0:
            self.step(None)
            self.warnings.clear()
            ended = [f"EMCY {kind[0]:04X}h: {_more(count)}" for kind, count in self._emergencies.clear()]
            self._outputs.no_drive_error()
            self._log(notice.text + (f" ({', '.join(ended)})" if ended else ""))
            return
        self.set_error_code(code)
        if code in self.warnings:
            self.warnings[code] = replace(self.warnings[code], time_ns=now)
        # The data may be a counter: another one is not another fault.
        kind = code, self.proven and notice.register != 0
        if not self._emergencies.is_new(kind, now):
            if code not in self.warnings:
                self.last_fault = now
            return
        number, text = CANOPEN_FAULT if code in CANOPEN_ERRORS else INTERNAL_FAULT, notice.text
        fault = self.fault_of_emcy.get(code)
        if fault is not None:
            number, text = fault.number, f"EMCY {code:04X}h {fault.name}"
        if repeated := self._emergencies.take_repeated(kind):
            text = f"{text} ({_more(repeated)})"
        value = int.from_bytes(notice.data[:_VALUE_BYTES], "little")
        record = FaultRecord(number, code, value, text, now, is_warning=not kind[1])
        if self.proven:
            self._report(record)
        else:
            self.unproven.append(record)

    def _report(self, record: FaultRecord) -> None:
        if not record.is_warning:
            self.last_fault = record.time_ns
        else:
            self.warnings.pop(record.code, None)
            self.warnings[record.code] = record
            if len(self.warnings) > EMERGENCIES_KEPT:
                del self.warnings[next(iter(self.warnings))]
        self._outputs.fault(record)

    def step(self, now: int | None) -> None:
        """EMCY whose fault the drive has not shown in time are warnings; with None all of them are."""
        waiting = self.unproven
        while waiting and (now is None or now - waiting[0].time_ns >= EMERGENCY_PATIENCE_NS):
            self._report(waiting.pop(0))

    def prove(self, since: int) -> None:
        """The drive shows a fault: the EMCY that came last after ``since`` are faults."""
        shown = [*self.unproven, *(record for record in self.warnings.values() if record.time_ns >= since)]
        self.unproven.clear()
        for record in shown:
            self.warnings.pop(record.code, None)
            self._emergencies.is_new((record.code, True), record.time_ns)
            self._report(replace(record, is_warning=False))


def _more(count: int) -> str:
    return f"{count} more since the last report"


class Acknowledgement:
    """When the fault buffer moves on: the PLC acknowledged, and the device has left its fault."""

    def __init__(self) -> None:
        self._seen = False
        """The bit was 1 in the last step."""
        self._until = 0
        """The drive has until then to leave its fault; 0: no acknowledgement is under way."""

    @property
    def pending(self) -> bool:
        """The PLC acknowledged, and the device is still in its fault."""
        return self._until != 0

    @property
    def waits(self) -> bool:
        """The next step counts, although nothing may be requested in it."""
        return self._seen or self._until != 0

    def step(self, asked: bool, ok: bool, faulty: bool, now: int) -> bool:
        """Process one cycle with the level of the bit; True when the fault is left. A cause that stays needs another edge."""
        if asked and not self._seen:
            self._until = now + ACKNOWLEDGE_NS
        self._seen = asked
        if not self._until or not ok:
            return False
        if not faulty:
            self._until = 0
            return True
        if now > self._until:
            self._until = 0
        return False


class DriveWatch:
    """Supervises the Statusword of a drive for changes that were not commanded."""

    def __init__(self, outputs: Outputs) -> None:
        self._outputs = outputs
        self._repetitions: Repetitions[FaultNumber] = Repetitions()
        self.fault_since = 0
        """When the drive showed a fault, left operation by itself or was lost in it, while its EMCY may still come; else 0."""
        self.fault_began = 0
        """When the Statusword showed a fault last."""
        self._is_older = False
        """That fault began before the connection: it has no EMCY."""
        self.shown = 0
        """The Statusword bits of the state as they were last, 0 without a drive."""
        self._supplied = len(_SUPPLIED)
        """The place in ``_SUPPLIED`` of the lowest state in which Statusword.4 was 1; after the last one: none."""

    def lacks_supply(self, state: State | None, *, unproven: bool) -> bool:
        """Statusword.4 = 0 in a state without power says so. ``unproven``: also of a drive that has never shown its supply."""
        if self._supplied == len(_SUPPLIED):
            return unproven
        return _SUPPLIED.get(state, 0) >= self._supplied

    def acknowledged(self) -> None:
        """The fault buffer has moved on: what is shown again is a new fault."""
        self._repetitions.clear()

    def changed(
        self, node: NodeWatch, shown: int, statusword: int, commanded: int, interlock: Interlock, now: int
    ) -> None:
        """``shown``: the bits of the state, ``commanded``: the Controlword that the drive had."""
        state, previous = STATE_OF_STATUS[shown], STATE_OF_STATUS[self.shown]
        if shown and statusword & StatusBit.VOLTAGE_ENABLED:
            self._supplied = min(self._supplied, _SUPPLIED.get(state, len(_SUPPLIED)))
        begins = state is not previous and state in _PROOF and previous not in FAULTY
        if state in FAULTY and previous not in FAULTY:
            self.fault_began = now
            self._is_older = not self.shown
        self.shown = shown
        if state is None and previous is not None:
            self._report_once(FaultNumber.STATE_UNKNOWN, f"Statusword {statusword:04X}h", now)
        elif previous is State.OPERATION_ENABLED and commanded & _COMMAND == _COMMAND:
            if state is not None and interlock.cell.fault is FaultNumber.LEFT_OPERATION:
                self._report_once(FaultNumber.LEFT_OPERATION, f"left operation, shows {state.value}", now)
                begins = state is not State.QUICK_STOP_ACTIVE
            elif not shown:
                begins = True
        elif state is State.OPERATION_ENABLED and previous in _BELOW and not interlock.expects_operation(now):
            self._report_once(FaultNumber.LEFT_OPERATION, "entered operation", now, _LOCAL)
        if begins:
            self.fault_since = now
            node.prove(now - EMERGENCY_PATIENCE_NS)
        node.proven = state in _PROOF or self.fault_since != 0

    def _report_once(self, number: FaultNumber, detail: str, now: int, remedy: str = "") -> None:
        if self._repetitions.is_new(number, now):
            self._outputs.fault(gateway_fault(number, detail, now, remedy=remedy))

    def step(self, node: NodeWatch, now: int) -> None:
        """A fault without an EMCY of its own: the EMCY that were warnings announced it, and the drive has its number and code."""
        since = self.fault_since
        if now - since >= EMERGENCY_PATIENCE_NS:
            self.fault_since = 0
            node.proven = STATE_OF_STATUS[self.shown] in _PROOF
            if self.shown and node.last_fault < since - EMERGENCY_PATIENCE_NS:
                node.prove(0)
                if since == self.fault_began:
                    self._outputs.happened().read_fault = True

    def fault_read(self, read: FaultRead, feedback: DriveFeedback, faults: Mapping[int, DriveFault], now: int) -> None:
        """The number and code that were read; ``faults``: the manufacturer's by number."""
        named = faults.get(read.number)
        why = "older than the connection" if self._is_older else "no EMCY"
        # 0 means an empty entry in P945
        code = read.code or (0 if named is None else named.error_code) or GENERIC_ERROR
        if named is not None:
            text = f"{named.name} ({why})"
        elif read.code:
            text = f"error code {read.code:04X}h {emcy_text(read.code)} (603Fh, {why})"
        else:
            text = f"Statusword {feedback.statusword:04X}h shows a fault ({why})"
        bare = named is None and not read.code
        number = read.number or INTERNAL_FAULT
        self._outputs.fault(FaultRecord(number, code, 0, text, now, is_bare=bare, is_older=self._is_older))
