"""One axis of a timeline: its words on both buses with their causes, the results of the PLC's edges, and errors.

The axis machine of this version is stepped with the recorded inputs of the gateway. Its decisions explain the recorded words
while its Controlword is the recorded one. If the state of the gateway is unknown (a recording that begins in operation), or
the Controlwords differ for longer, no reasons are shown until they agree again. Without I/O.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from pdgw.decoder.frames.canopen.records import CanRecord, HeartbeatRecord, NmtRecord, PdoRecord, SdoRecord
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.decoder.replay.recorded import SdoResult
from pdgw.decoder.replay.recorded_drive import RecordedDrive, asks_for_off, recall, sdo_result
from pdgw.decoder.timeline.drive_object import ObjectFollower, Put
from pdgw.decoder.timeline.entries import Anomaly, AnomalyKind, Edge, ReasonChange, WordKind
from pdgw.decoder.timeline.words import Decision, Words
from pdgw.ds301.nmt import NmtCommand, NmtState
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.modes import MODE_CONFIRM_NS
from pdgw.dsp402.objects import MODE
from pdgw.dsp402.states import STATE_BITS, Command, ControlBit, State, StatusBit, next_state, state_of
from pdgw.durations import MS, SECOND
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.values import SdoAnswer, SdoWrite
from pdgw.gateway.objects.enable_chain import asks_for_operation
from pdgw.gateway.reasons import AxisState, Reason
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import ApplicationMode, telegram

SETTLE_NS: Final = 100 * MS
"""The result of an edge is judged after this time, or at the next edge; an ON when the drive has followed it."""
RESPONSE_NS: Final = SECOND
"""A drive that has not answered a Controlword within this time has missed it."""
AGREEMENT_NS: Final = 500 * MS
"""Time for which the recorded and the computed Controlword must agree, or differ, until it counts."""
NOT_VALID: Final = "not evaluated: no valid frame (stale, stopped, or IOPS BAD)"
OVERTAKEN: Final = "not evaluated: the frame was dropped or overtaken by a newer one"
NO_CONTROLWORD: Final = "not judged: the recording contains no Controlword for the drive up to here"
NOT_JUDGED: Final = "not judged: the state of the gateway before the recording is unknown until the next OFF"

_STW1 = signal("STW1")


class _Command(NamedTuple):
    """A Controlword that the drive must answer with a change of one of the ``wanted`` bits of its Statusword."""

    edge: Edge
    wanted: int
    statusword: int


@dataclass
class _Settling:
    """An edge of the PLC and the reasons it passes through."""

    edge: Edge
    reasons: dict[Reason | None, None] = field(default_factory=dict)
    last: Reason | None = None
    time_ns: int = SETTLE_NS
    """Time from the edge to its result: a drive that starts has as long as for any answer."""

    def add(self, reason: Reason | None, *, awaited: bool) -> None:
        self.reasons[reason] = None
        self.last = reason
        self.time_ns = RESPONSE_NS if awaited else SETTLE_NS

    def close(self) -> None:
        self.edge.outcome = self.last
        passed = [reason for reason in self.reasons if reason not in {None, self.last}]
        self.edge.reasons = tuple(reason for reason in (*passed, self.last) if reason is not None)


class AxisFollower(ObjectFollower):
    """Follows one axis with a drive. ``assumed``: the settings are not the user's but defaults."""

    def __init__(
        self,
        axis: Axis,
        settings: AxisSettings,
        put: Put,
        *,
        cycle_ns: int,
        hold_ns: int,
        one_clock: bool,
        assumed: bool,
    ) -> None:
        super().__init__(axis, put, hold_ns)
        self.online = False
        """The drive is there: IOPS of the answers; without any, its TPDOs come."""
        self.answered = False
        """There are answers of the gateway that show it."""
        self._assumed = assumed
        chosen = telegram(axis.telegram)
        self._transparent = chosen.setpoints.mode is ApplicationMode.TRANSPARENT
        self._words = Words(axis.do_id, chosen, 2 * cycle_ns, put, one_clock=one_clock)
        # the drive
        self._drive = RecordedDrive()
        self._image = DriveFeedback()
        self._restarted = False
        self._new_references = True
        self._written: deque[SdoResult] = deque(maxlen=64)
        # -- today's machine
        self._machine = AxisMachine(axis.telegram, settings, self._image)
        self._request: tuple[SdoWrite, ...] | None = None
        self._to_write: list[SdoWrite] = []
        self._shown: int | None = None
        self._known = False
        self._agrees = False
        self._since: int | None = None
        # -- what waits for its end
        self._control_edge: Edge | None = None
        self._status_edge: Edge | None = None
        self._settling: _Settling | None = None
        self._last_reason: Reason | str | None = ""
        self._command: _Command | None = None
        self._mode_asked: int | None = None
        self._mode_shown: int | None = None
        self._mode_since: int | None = None

    # -- the PLC's side -----------------------------------------------------------------------------------------------

    def control(self, now: int, word: int, setpoints: Sequence[int] | None) -> None:
        edge = self._words.edge(WordKind.CONTROL, now, word)
        if edge is None:
            return
        self._settled()
        if setpoints is None:
            edge.note = NOT_VALID
        elif setpoints[0] != word:
            edge.note = OVERTAKEN
        else:
            self._control_edge = edge

    def status(self, now: int, values: Sequence[int], *, good: bool) -> None:
        if not self.answered:
            self.answered = True
            self._read_homing_method(values)
        self.online = good
        edge = self._words.edge(WordKind.STATUS, now, values[0])
        if edge is not None:
            self._words.explain(WordKind.STATUS, edge)

    def _read_homing_method(self, values: Sequence[int]) -> None:
        """A recording that begins in operation shows the homing method in AKTSATZ only."""
        names = telegram(self.axis.telegram).actuals.names
        if "AKTSATZ" in names and not self._drive.homing_method:
            self._drive.homing_method = signal("AKTSATZ").bit("HOMING_METHOD").of(values[names.index("AKTSATZ")])

    # -- CAN ----------------------------------------------------------------------------------------------------------

    def take(self, record: CanRecord) -> None:
        if isinstance(record, PdoRecord):
            self._pdo(record)
        elif isinstance(record, SdoRecord):
            self._sdo(record)
        else:
            super().take(record)
            if isinstance(record, NmtRecord):
                if record.command == NmtCommand.START:
                    self._drive.started = self._restarted = True
                else:
                    self._offline()
            elif isinstance(record, HeartbeatRecord) and record.state == NmtState.BOOT_UP:
                self._offline()

    def _offline(self) -> None:
        self._drive.stop()
        if not self.answered:
            self.online = False

    def _pdo(self, record: PdoRecord) -> None:
        drive, layout, now = self._drive, record.layout, record.time_ns
        parts = drive.parts(layout)
        receives = parts.direction is PdoDirection.RPDO
        if not receives and not self.answered and drive.started:
            self.online = True
        if not drive.is_new(record):
            return
        values = layout.unpack(record.data)
        word, mode = (values[place] if place >= 0 else None for place in (parts.word, parts.mode))
        if receives:
            drive.sent[layout] = record.data[: layout.size]
            if isinstance(word, int):
                self._commanded(now, word)
            if isinstance(mode, int):
                self._ask_mode(now, mode)
            return
        for attribute, value in parts.feedback(values):
            setattr(self._image, attribute, value)
        if isinstance(word, int):
            self._statusword(now, word)
        if isinstance(mode, int):
            self._mode_shown = mode
            if mode == self._mode_asked:
                self._mode_since = None

    def _sdo(self, record: SdoRecord) -> None:
        result = sdo_result(record)
        if result is not None:
            self._written.append(result)
            if (result.index, result.subindex) == MODE and result.error is None:
                self._ask_mode(record.time_ns, int.from_bytes(result.data, "little", signed=True))
        elif not record.from_client and (learned := self._drive.learn(record)) is not None:
            before, value = learned
            self._new_references |= before != value
            self._words.are_of(self._drive.families)

    # -- words and their causes ---------------------------------------------------------------------------------------

    def _commanded(self, now: int, word: int) -> None:
        if self._shown is not None and word != self._machine.outputs.command.controlword:
            # RPDOs are the result of a step. A step of a busy gateway may have no answer of its own; then its RPDO is the
            # only record.
            self.step(self._machine.inputs.setpoints, now, fresh=False)
        edge = self._words.edge(WordKind.CONTROLWORD, now, word)
        if edge is None:
            return
        self._words.explain(WordKind.CONTROLWORD, edge)
        statusword = self._words.values.get(WordKind.STATUSWORD)
        wanted = None if statusword is None else _expectation(statusword, edge)
        self._command = None if wanted is None or statusword is None else _Command(edge, wanted, statusword)

    def _statusword(self, now: int, word: int) -> None:
        edge = self._words.edge(WordKind.STATUSWORD, now, word)
        if edge is None:
            return
        self._status_edge = edge
        command = self._command
        if command is not None and (edge.before ^ edge.after) & command.wanted:
            edge.follow(command.edge)
            self._command = None
        elif state_of(edge.before) is State.OPERATION_ENABLED:
            self._left_operation(edge)

    def _left_operation(self, edge: Edge) -> None:
        commanded = Command.ENABLE_OPERATION.matches(self._words.values.get(WordKind.CONTROLWORD, 0))
        if commanded and state_of(edge.after) not in {
            State.OPERATION_ENABLED,
            State.FAULT,
            State.FAULT_REACTION_ACTIVE,
        }:
            text = f"{edge.field.text(edge.after)} while Enable Operation was commanded"
            self._put(Anomaly(edge.time_ns, self.axis.do_id, AnomalyKind.LEFT_OPERATION, text))

    def _ask_mode(self, now: int, mode: int) -> None:
        if mode != self._mode_asked:
            self._mode_asked = mode
            self._mode_since = now if mode and mode != self._mode_shown else None

    # -- today's machine ----------------------------------------------------------------------------------------------

    def step(self, setpoints: Sequence[int] | None, now: int, *, fresh: bool = True) -> None:
        inputs, outputs = self._machine.inputs, self._machine.outputs
        inputs.now, inputs.setpoints, inputs.drive_ok = now, setpoints, self.online
        stops = inputs.gateway_stops = self.gateway_stops
        inputs.fresh = fresh and not stops
        if self.online:
            self._configure()
        commanded = outputs.command.controlword
        self._machine.step()
        actuals, word = outputs.actuals, outputs.command.controlword
        control, status = self._control_edge, self._status_edge
        self._control_edge = self._status_edge = None
        if word != commanded:
            decision = Decision(now, commanded, word, control or status)
            self._words.decided(WordKind.CONTROLWORD, decision)
        if actuals[0] != self._shown:
            if self._shown is not None:
                self._words.decided(WordKind.STATUS, Decision(now, self._shown, actuals[0], status or control))
            self._shown = actuals[0]
        self._serve_sdo(now)
        for record in outputs.faults if self._known else ():
            self._put(Anomaly(now, self.axis.do_id, AnomalyKind.GATEWAY_FAULT, f"{record.number} {record.text}"))
        self._compare(None if stops else setpoints, now)
        self._judge(control, now)

    def _configure(self) -> None:
        """Restarts of the drive and references as far as the gateway has them."""
        restarted = self._restarted
        if restarted or self._new_references:
            self._machine.inputs.news.append(self._drive.configured(restarted=restarted))
            self._known |= restarted
            self._restarted = self._new_references = False

    def _serve_sdo(self, now: int) -> None:
        """Answer the machine's SDO writes when the recorded ones were answered."""
        request = self._machine.outputs.writes
        if request is None:
            self._request = None
            return
        if request is not self._request:
            self._request, self._to_write = request, list(request)
            return
        while self._to_write and self._written:
            written = self._written.popleft()
            wanted = self._to_write[0]
            if written.time_ns < now - SETTLE_NS or (written.index, written.subindex) != (
                wanted.index,
                wanted.subindex,
            ):
                continue
            del self._to_write[0]
            if written.error is not None or not self._to_write:
                self._machine.inputs.news.append(SdoAnswer(request, written.error))
                return

    def _compare(self, setpoints: Sequence[int] | None, now: int) -> None:
        """Whether today's machine is in the state of the recorded gateway."""
        recorded = self._words.values.get(WordKind.CONTROLWORD)
        if recorded is None or not self.online:
            self._since = None
            return
        today = self._machine.outputs.command.controlword
        agrees = today == recorded
        if self._since is None or agrees is not self._agrees:
            self._agrees, self._since = agrees, now
        lasts = now - self._since >= AGREEMENT_NS
        if agrees and lasts:
            self._known = True
        elif self._known and lasts:
            self._known = False
            choices = " with the default choices" if self._assumed else ""
            text = (
                f"Controlword {recorded:04X}h on the bus, {today:04X}h by the rules of this version{choices}: "
                "no reasons until an OFF"
            )
            self._put(Anomaly(self._since, self.axis.do_id, AnomalyKind.DIFFERENCE, text))
        elif not self._known and setpoints is not None:
            self._recognise(setpoints)

    def _recognise(self, setpoints: Sequence[int]) -> None:
        """With an OFF while the drive is not powered, the machine's state follows from the recording."""
        if not asks_for_off(setpoints[0], self._image.statusword, transparent=self._transparent):
            return
        self._known = True
        self._since = None
        recall(self._machine, self._drive.rpdos(), self._words.values.get(WordKind.STATUS))

    def _judge(self, control: Edge | None, now: int) -> None:
        """Report the results of the PLC's edges, and reasons that start or end."""
        reason = self._machine.outputs.reason
        if self.gateway_stops and reason is Reason.PLC_LOST:
            reason = Reason.GATEWAY_STOPS
        if control is not None:
            self._settled()
            if self._known:
                self._settling = _Settling(control)
            else:
                control.note = NOT_JUDGED if WordKind.CONTROLWORD in self._words.values else NO_CONTROLWORD
        settling = self._settling
        if settling is not None and settling.reasons and now > settling.edge.time_ns + settling.time_ns:
            self._settled()
            settling = None
        if settling is not None:
            starting = reason is not None and reason.state is AxisState.STARTING
            settling.add(reason, awaited=starting and asks_for_operation(self._machine.demand))
        if self._known and reason is not self._last_reason:
            self._last_reason = reason
            self._put(ReasonChange(now, self.axis.do_id, reason, settling is not None))

    def _settled(self) -> None:
        if self._settling is not None:
            self._settling.close()
            self._settling = None

    # -- time ---------------------------------------------------------------------------------------------------------

    def tick(self, now: int) -> None:
        super().tick(now)
        command = self._command
        if command is not None and now > command.edge.time_ns + RESPONSE_NS:
            self._command = None
            status = self._words.fields[WordKind.STATUSWORD].text(command.statusword)
            text = f"{command.edge.field.text(command.edge.after)}: the drive did not respond within 1 s, {status}"
            self._put(Anomaly(command.edge.time_ns, self.axis.do_id, AnomalyKind.HANDSHAKE, text))
        if self._mode_since is not None and now > self._mode_since + MODE_CONFIRM_NS:
            if self._mode_shown is not None:
                text = f"6060h = {self._mode_asked}, 6061h = {self._mode_shown} for 1 s"
                self._put(Anomaly(self._mode_since, self.axis.do_id, AnomalyKind.MODE, text))
            self._mode_since = None
        settling = self._settling
        if settling is not None and now > settling.edge.time_ns + max(settling.time_ns, 2 * SETTLE_NS):
            self._settled()  # the gateway has made no step since then

    def finish(self) -> None:
        self._settled()


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
