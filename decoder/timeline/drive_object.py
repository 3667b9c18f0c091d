"""One drive object of a timeline: its words on both buses with their causes, events of its node, and what the gateway decided.

Without I/O.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from pdgw.decoder.frames.canopen.records import CanRecord, EmcyRecord, HeartbeatRecord, NmtRecord, PdoRecord, SdoRecord
from pdgw.decoder.frames.fields import Field, entry_field, half_fields
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.decoder.timeline.entries import Anomaly, AnomalyKind, Edge, Entry, Event, ReasonChange, WordKind
from pdgw.dsp402.identification.overlay import all_families
from pdgw.dsp402.modes import MODE_CONFIRM_NS
from pdgw.dsp402.objects import (
    CONTROL_ATTRIBUTE,
    CONTROLWORD,
    DRIVE_OBJECTS,
    MODE,
    MODE_DISPLAY,
    STATUS_ATTRIBUTE,
    STATUSWORD,
)
from pdgw.dsp402.states import STATE_BITS, Command, ControlBit, State, StatusBit, next_state, state_of
from pdgw.durations import MS, SECOND
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.reasons import GATEWAY_FAULTS, AxisState, Reason
from pdgw.gateway.trace.blocks import TracedObject
from pdgw.gateway.trace.codec import from_json
from pdgw.gateway.trace.reader import Step
from pdgw.profidrive.telegrams import Direction, telegram

SETTLE_NS: Final = 100 * MS
"""The result of an edge is its reason after this time, or at the next edge; of an ON that of when the drive has followed it."""
RESPONSE_NS: Final = SECOND
"""A drive that has not answered a Controlword within this time has missed it."""
NOT_VALID: Final = "not evaluated: no valid frame (stale, stopped, or IOPS BAD)"
OVERTAKEN: Final = "not evaluated: the frame was overtaken by a newer one, or waited for one that confirms it"
_RESET: Final = 0
"""EMCY error code "error reset or no error"."""
_CYCLES: Final = 2
"""A word follows its cause within this number of cycles."""
_CAUSES: Final = {
    WordKind.CONTROLWORD: (WordKind.CONTROL, WordKind.STATUSWORD),
    WordKind.STATUS: (WordKind.STATUSWORD, WordKind.CONTROL),
}
"""The words that the gateway reads before it sends a word."""
_DRIVES: Final = frozenset(DRIVE_TELEGRAM_NUMBERS)
_LEAVING: Final = {State.OPERATION_ENABLED, State.FAULT, State.FAULT_REACTION_ACTIVE}


@dataclass(frozen=True)
class _Command:
    """A Controlword that the drive must answer with a change of one of the ``bits`` of its Statusword."""

    edge: Edge
    bits: int
    statusword: int


class ObjectFollower:
    """Follows one drive object. ``put`` takes the entries, whose details may still change for ``RESPONSE_NS``.
    ``uncertainty_ns``: of the clocks of both buses."""

    def __init__(self, axis: Axis, put: Callable[[Entry], None], cycle_ns: int, uncertainty_ns: int) -> None:
        self.axis = axis
        self.has_frames = False
        """Whether a frame of the node has arrived."""
        self._put = put
        self._window = _CYCLES * cycle_ns
        self._early = uncertainty_ns
        self._bad_since: dict[Direction, int] = {}
        """Process data that is marked as bad."""
        chosen, families = telegram(axis.telegram), all_families()
        self._fields: dict[WordKind, Field] = {
            WordKind.CONTROL: half_fields(chosen.setpoints)[0],
            WordKind.STATUS: half_fields(chosen.actuals)[0],
            WordKind.CONTROLWORD: entry_field(DRIVE_OBJECTS.attribute(CONTROL_ATTRIBUTE), families),
            WordKind.STATUSWORD: entry_field(DRIVE_OBJECTS.attribute(STATUS_ATTRIBUTE), families),
        }
        self._values: dict[WordKind, int] = {}
        self._newest: dict[WordKind, Edge] = {}
        self._command: _Command | None = None
        self._mode_asked: int | None = None
        self._mode_shown: int | None = None
        self._mode_since: int | None = None
        self._control: Edge | None = None
        """An edge of the PLC that no step has used yet."""
        self._settling: Edge | None = None
        """An edge of the PLC without its final result."""
        self._reason: Reason | str | None = ""

    # -- words and their causes ---------------------------------------------------------------------------------------

    def word(self, kind: WordKind, now: int, value: int) -> None:
        """A word as it was sent."""
        before = self._values.get(kind)
        self._values[kind] = value
        if before is None or before == value:
            return
        edge = Edge(now, self.axis.do_id, kind, self._fields[kind], before, value)
        self._put(edge)
        if self._early:
            self._follow_up(edge)
        if kind is WordKind.CONTROL:
            self._settling = None
            self._control = edge
        elif kind is WordKind.STATUSWORD:
            self._answered(edge)
        else:
            edge.cause = self._cause(kind, now)
            if kind is WordKind.CONTROLWORD:
                self._commanded(edge)
        self._newest[kind] = edge

    def _follow_up(self, cause: Edge) -> None:
        """Words of the other bus may seem to come before their cause."""
        for kind, causes in _CAUSES.items():
            effect = self._newest.get(kind)
            if cause.kind not in causes or effect is None or effect.cause is not None:
                continue
            if cause.time_ns - effect.time_ns <= self._early:
                effect.cause = cause
                cause.effects.add(kind)

    def _cause(self, kind: WordKind, now: int) -> Edge | None:
        """The newest edge that the gateway can have read for this word and for no earlier one."""
        found = [edge for cause in _CAUSES[kind] if (edge := self._newest.get(cause)) is not None]
        found = [edge for edge in found if now - edge.time_ns <= self._window and kind not in edge.effects]
        cause = max(found, key=lambda edge: edge.time_ns, default=None)
        if cause is not None:
            cause.effects.add(kind)
        return cause

    def _commanded(self, edge: Edge) -> None:
        statusword = self._values.get(WordKind.STATUSWORD)
        bits = None if statusword is None else _expectation(statusword, edge)
        self._command = None if bits is None or statusword is None else _Command(edge, bits, statusword)

    def _answered(self, edge: Edge) -> None:
        command = self._command
        if command is not None and (edge.before ^ edge.after) & command.bits:
            edge.cause = command.edge
            self._command = None
            return
        leaves = state_of(edge.before) is State.OPERATION_ENABLED and state_of(edge.after) not in _LEAVING
        if leaves and Command.ENABLE_OPERATION.matches(self._values.get(WordKind.CONTROLWORD, 0)):
            text = f"{edge.field.text(edge.after)} while Enable Operation was commanded"
            self._put(Anomaly(edge.time_ns, self.axis.do_id, AnomalyKind.LEFT_OPERATION, text))

    # -- CAN ----------------------------------------------------------------------------------------------------------

    def take(self, record: CanRecord) -> None:
        """A frame of the node or to it."""
        now, do_id = record.time_ns, self.axis.do_id
        if isinstance(record, PdoRecord):
            self._pdo(record)
        elif isinstance(record, SdoRecord):
            if (record.index, record.subindex) == MODE and record.from_client and record.value:
                self._ask_mode(now, int.from_bytes(record.value, "little", signed=True))
        elif isinstance(record, NmtRecord):
            self._put(Event(now, do_id, "NMT", record.text))
        elif isinstance(record, HeartbeatRecord):
            if record.changed:
                self._put(Event(now, do_id, "state", f"node {record.node}: {record.text}"))
        elif isinstance(record, EmcyRecord):
            text = f"node {record.node}: {record.text}"
            if record.code == _RESET:
                self._put(Event(now, do_id, "EMCY", text))
            else:
                self._put(Anomaly(now, do_id, AnomalyKind.EMERGENCY, text))

    def _pdo(self, record: PdoRecord) -> None:
        if self.axis.telegram not in _DRIVES:
            return
        addresses, now = record.layout.addresses, record.time_ns
        values = record.layout.unpack(record.data)
        for address, kind in ((CONTROLWORD, WordKind.CONTROLWORD), (STATUSWORD, WordKind.STATUSWORD)):
            if address in addresses and isinstance(word := values[addresses.index(address)], int):
                self.word(kind, now, word)
        if MODE in addresses and isinstance(mode := values[addresses.index(MODE)], int):
            self._ask_mode(now, mode)
        if MODE_DISPLAY in addresses and isinstance(mode := values[addresses.index(MODE_DISPLAY)], int):
            self._mode_shown = mode
            if mode == self._mode_asked:
                self._mode_since = None

    def _ask_mode(self, now: int, mode: int) -> None:
        if mode != self._mode_asked:
            self._mode_asked = mode
            self._mode_since = now if mode and mode != self._mode_shown else None

    # -- what the gateway decided ---------------------------------------------------------------------------------------

    def step(self, now: int, step: Step, traced: TracedObject, reasons: tuple[str, ...]) -> None:
        """A recorded step. ``reasons``: their names, code 1 is the first."""
        code = step.decided[traced.groups["decided"].index("reason")]
        reason = Reason.__members__.get(reasons[code - 1]) if code else None
        stops = traced.place("flags", "gateway_stops")
        if stops is not None and step.flags[stops] and reason is Reason.PLC_LOST:
            reason = Reason.GATEWAY_STOPS
        for item in step.events.get("faults", ()):
            fault = from_json(item)
            if isinstance(fault, FaultRecord) and fault.number in GATEWAY_FAULTS:
                text = f"{fault.number} {fault.text}"
                self._put(Anomaly(now, self.axis.do_id, AnomalyKind.GATEWAY_FAULT, text))
        control, self._control = self._control, None
        settling = self._settling
        if settling is not None and now > settling.time_ns + _result_after(settling.outcome):
            settling = None
        if control is not None:
            settling = None
            if step.setpoints is None:
                control.note = NOT_VALID
            elif step.setpoints[0] != control.after:
                control.note = OVERTAKEN
            else:
                settling = control
        if settling is not None:
            settling.decide(reason)
        self._settling = settling
        if reason is not self._reason:
            self._reason = reason
            self._put(ReasonChange(now, self.axis.do_id, reason, settling is not None))

    # -- time -----------------------------------------------------------------------------------------------------------

    def quality(self, now: int, direction: Direction, *, good: bool) -> None:
        """Whether the process data of one direction are marked good."""
        since = self._bad_since.get(direction)
        if good is (since is None):
            return
        who = "of the PLC" if direction is Direction.SETPOINT else "of the gateway"
        if since is None:
            self._bad_since[direction] = now
            self._put(Anomaly(now, self.axis.do_id, AnomalyKind.IOPS_BAD, f"data {who} bad"))
        else:
            del self._bad_since[direction]
            text = f"data {who} good again after {(now - since) / MS:.1f} ms"
            self._put(Event(now, self.axis.do_id, "IOPS", text))

    def tick(self, now: int) -> None:
        """Report overdue answers."""
        command = self._command
        if command is not None and now > command.edge.time_ns + RESPONSE_NS:
            self._command = None
            status = self._fields[WordKind.STATUSWORD].text(command.statusword)
            text = f"{command.edge.field.text(command.edge.after)}: the drive did not respond within 1 s, {status}"
            self._put(Anomaly(command.edge.time_ns, self.axis.do_id, AnomalyKind.HANDSHAKE, text))
        if self._mode_since is not None and now > self._mode_since + MODE_CONFIRM_NS:
            if self._mode_shown is not None:
                text = f"6060h = {self._mode_asked}, 6061h = {self._mode_shown} for 1 s"
                self._put(Anomaly(self._mode_since, self.axis.do_id, AnomalyKind.MODE, text))
            self._mode_since = None


def _result_after(reason: Reason | None) -> int:
    """Time from an edge to its result: a drive that starts has as long as for any answer."""
    return RESPONSE_NS if reason is not None and reason.state is AxisState.STARTING else SETTLE_NS


def _expectation(statusword: int, command: Edge) -> int | None:
    """Statusword bits of which one has to change for a Controlword; None when the drive has nothing to answer."""
    state = state_of(statusword)
    if state is not None and next_state(state, command.after, command.before) is not state:
        return STATE_BITS
    raised = command.after & ~command.before & ControlBit.NEW_SETPOINT
    lowered = command.before & ~command.after & ControlBit.NEW_SETPOINT
    acknowledged = bool(statusword & StatusBit.MODE_12)
    if state is State.OPERATION_ENABLED and ((raised and not acknowledged) or (lowered and acknowledged)):
        return StatusBit.MODE_12
    return None
