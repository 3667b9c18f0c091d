"""One drive object of a timeline: its words on both buses with their causes, events of its node, and what the gateway decided.

Without I/O.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.objects import CONTROLWORD, STATUSWORD
from pdgw.dsp402.states import STATE_BITS, Command, ControlBit, State, StatusBit, next_state, state_of
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS
from pdgw.gateway.base.reasons import AxisState, Reason
from pdgw.gateway.trace.json_values import from_json
from pdgw.gateway.trace.pcapng import TracedObject
from pdgw.gateway.trace.step_reader import Step
from pdgw.profidrive.telegrams import Direction
from pdgw.tools.decoder.frames.canopen.can_records import (
    CanRecord,
    EmcyRecord,
    HeartbeatRecord,
    NmtRecord,
    PdoRecord,
    SdoRecord,
)
from pdgw.tools.decoder.frames.fields import Field
from pdgw.tools.decoder.frames.profinet.frame_telegrams import Axis
from pdgw.tools.decoder.timeline.entries import Anomaly, AnomalyKind, Edge, Entry, Event, ReasonChange, WordKind

RESPONSE_NS: Final = SECOND
"""A drive that has not answered a Controlword, or not started, within this time has missed it."""
NOT_USED: Final = "not evaluated: the frame was not valid (old, stopped or IOPS BAD), or a newer one overtook it"
_RESET: Final = 0
"""EMCY error code "error reset or no error"."""
_CYCLES: Final = 2
"""A word follows its cause within this number of cycles."""
_CAUSES: Final = {
    WordKind.CONTROLWORD: (WordKind.CONTROL, WordKind.STATUSWORD),
    WordKind.STATUS: (WordKind.STATUSWORD, WordKind.CONTROL),
}
"""The words that the gateway reads before it sends a word."""
_WORDS: Final = {CONTROLWORD: WordKind.CONTROLWORD, STATUSWORD: WordKind.STATUSWORD}
_PENDING: Final = {AxisState.STARTING, AxisState.WAITS, AxisState.FAULT}
"""The result of an edge may change: the drive starts, accepts data, or its fault is acknowledged."""
_LEAVING: Final = {State.OPERATION_ENABLED, State.FAULT, State.FAULT_REACTION_ACTIVE}


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
        self._followed = {} if axis.telegram in ENCODER_TELEGRAM_NUMBERS else _WORDS
        self._words: dict[WordKind, tuple[int, Field]] = {}
        self._newest: dict[WordKind, Edge] = {}
        self._command: Edge | None = None
        """The newest edge of the Controlword until the drive has answered it."""
        self._control: Edge | None = None
        """An edge of the PLC that no step has used yet."""
        self._settling: Edge | None = None
        """An edge of the PLC whose result may change."""
        self._reason: Reason | str | None = ""

    # -- words and their causes ---------------------------------------------------------------------------------------

    def word(self, kind: WordKind, now: int, value: int, field: Field) -> None:
        """A word as it was sent."""
        before, _ = self._words.get(kind, (value, field))
        self._words[kind] = value, field
        if before == value:
            return
        edge = Edge(now, self.axis.do_id, kind, field, before, value)
        self._put(edge)
        for other in sorted(self._newest.values(), key=lambda item: item.time_ns, reverse=True):
            self._link(other, edge)
            if self._early:  # words of the other bus may seem to come before their cause
                self._link(edge, other)
        self._newest[kind] = edge
        if kind is WordKind.CONTROL:
            self._control, self._settling = edge, None
        elif kind is WordKind.CONTROLWORD:
            self._command = edge
        elif kind is WordKind.STATUSWORD:
            self._answered(edge)

    def _link(self, cause: Edge, effect: Edge) -> None:
        """The gateway can have read a cause for the newest word that it sends and for no earlier one."""
        is_read = cause.kind in _CAUSES.get(effect.kind, ()) and effect.kind not in cause.effects
        if is_read and effect.cause is None and -self._early <= effect.time_ns - cause.time_ns <= self._window:
            effect.cause = cause
            cause.effects.add(effect.kind)

    def _answered(self, edge: Edge) -> None:
        command = self._command
        if command is not None and (edge.before ^ edge.after) & _expectation(edge.before, command):
            edge.cause, self._command = command, None
            return
        leaves = state_of(edge.before) is State.OPERATION_ENABLED and state_of(edge.after) not in _LEAVING
        if leaves and Command.ENABLE_OPERATION.matches(self._words.get(WordKind.CONTROLWORD, (0,))[0]):
            self._report(edge.time_ns, AnomalyKind.LEFT_OPERATION, f"{edge.text} while Enable Operation was commanded")

    # -- CAN ----------------------------------------------------------------------------------------------------------

    def take(self, record: CanRecord) -> None:
        """A frame of the node or to it."""
        now, do_id = record.time_ns, self.axis.do_id
        if isinstance(record, PdoRecord):
            layout = record.layout
            self.has_frames |= layout.name.startswith(PdoDirection.TPDO.name)
            values = zip(layout.addresses, layout.unit.fields, layout.unpack(record.data), strict=True)
            for address, field, value in values:
                if address in self._followed and isinstance(value, int):
                    self.word(self._followed[address], now, value, field)
        elif isinstance(record, SdoRecord):
            self.has_frames |= not record.from_client
        elif isinstance(record, NmtRecord):
            self._put(Event(now, do_id, "NMT", record.text))
        elif isinstance(record, HeartbeatRecord):
            self.has_frames = True
            if record.changed:
                self._put(Event(now, do_id, "state", f"node {record.node}: {record.text}"))
        elif isinstance(record, EmcyRecord):
            self.has_frames = True
            text = f"node {record.node}: {record.text}"
            if record.code == _RESET:
                self._put(Event(now, do_id, "EMCY", text))
            else:
                self._report(now, AnomalyKind.EMERGENCY, text)

    # -- what the gateway decided ---------------------------------------------------------------------------------------

    def step(self, now: int, step: Step, traced: TracedObject, name: Callable[[int], str]) -> None:
        """A recorded step. ``name``: of a recorded reason."""
        reason = Reason.__members__.get(name(step.decided[traced.groups["decided"].index("reason")]))
        stops = traced.place("flags", "gateway_stops")
        if stops is not None and step.flags[stops] and reason is Reason.PLC_LOST:
            reason = Reason.GATEWAY_STOPS
        for item in step.events.get("faults", ()):
            fault = from_json(item)
            if isinstance(fault, FaultRecord) and fault.number in GATEWAY_FAULTS:
                self._report(now, AnomalyKind.GATEWAY_FAULT, f"{fault.number} {fault.text}")
        control, self._control = self._control, None
        settling, self._settling = self._settling, None
        if control is not None:
            control.result = NOT_USED
            is_used = step.setpoints is not None and step.setpoints[0] == control.after
            settling = control if is_used else None
        elif settling is not None and now > settling.time_ns + RESPONSE_NS:
            settling = None
        if settling is not None:
            settling.outcome, settling.result = reason, reason.value if reason else "executed"
            if reason is not None and reason.state in _PENDING:
                self._settling = settling
        if reason is not self._reason:
            self._reason = reason
            text = reason.value if reason else "in operation"
            self._put(ReasonChange(now, self.axis.do_id, "reason", text, reason, settling is not None))

    # -- time -----------------------------------------------------------------------------------------------------------

    def quality(self, now: int, direction: Direction, *, good: bool) -> None:
        """Whether the process data of one direction are marked good."""
        since = self._bad_since.get(direction)
        if good is (since is None):
            return
        who = "of the PLC" if direction is Direction.SETPOINT else "of the gateway"
        if since is None:
            self._bad_since[direction] = now
            self._report(now, AnomalyKind.IOPS_BAD, f"data {who} bad")
        else:
            del self._bad_since[direction]
            text = f"data {who} good again after {(now - since) / MS:.1f} ms"
            self._put(Event(now, self.axis.do_id, "IOPS", text))

    def tick(self, now: int) -> None:
        """Report an overdue answer."""
        command, (status, field) = self._command, self._words.get(WordKind.STATUSWORD, (0, None))
        if command is not None and now > command.time_ns + RESPONSE_NS:
            self._command = None
            if field is not None and _expectation(status, command):
                text = f"{command.text}: the drive did not respond within 1 s, {field.text(status)}"
                self._report(command.time_ns, AnomalyKind.HANDSHAKE, text)

    def _report(self, now: int, kind: AnomalyKind, text: str) -> None:
        self._put(Anomaly(now, self.axis.do_id, kind, text))


def _expectation(statusword: int, command: Edge) -> int:
    """Statusword bits of which one has to change for a Controlword; 0 when the drive has nothing to answer."""
    state = state_of(statusword)
    if state is not None and next_state(state, command.after, command.before) is not state:
        return STATE_BITS
    if state is State.OPERATION_ENABLED and (command.before ^ command.after) & ControlBit.NEW_SETPOINT:
        is_answered = bool(command.after & ControlBit.NEW_SETPOINT) is bool(statusword & StatusBit.MODE_12)
        return 0 if is_answered else StatusBit.MODE_12
    return 0
