"""A recording of both buses: records of the captures sorted by axis, as input of replay.

``Collector`` takes the records of all captures in any order of the files; ``recording`` converts the CAN side to the PLC's
clock. Inputs and outputs of the gateway are kept as plain tuples; memory grows with the captures. Not here: frames of several
PLCs (all count as one sender), nodes without an axis.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

from pdgw.decoder.frames.canopen.pdo_mapping import recorded_rpdo
from pdgw.decoder.frames.canopen.records import CanRecord, HeartbeatRecord, NmtRecord, PdoRecord, SdoRecord
from pdgw.decoder.frames.profinet.connect import Connection
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.decoder.frames.profinet.endpoint import ProfinetEndpoint
from pdgw.decoder.frames.profinet.records import AlarmRecord, Change, RelationRecord
from pdgw.decoder.frames.records import CyclicRecord, Record
from pdgw.decoder.replay.cycles import median_cycle_ns
from pdgw.decoder.replay.plc_inputs import USED, Frame, PlcInputs, Relation, receive_frames, receive_profinet
from pdgw.decoder.replay.recorded import (
    Answer,
    AxisRecording,
    Feedback,
    Learned,
    ProbeTransfer,
    SdoResult,
    Sent,
    Setpoints,
)
from pdgw.decoder.replay.recorded_drive import RecordedDrive, sdo_result
from pdgw.ds301.nmt import NmtCommand, NmtState
from pdgw.ds301.pdo import Pdo, PdoDirection
from pdgw.dsp402.drive import touch_probe
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.configuration.tables.defaults import WATCHDOG_FACTOR
from pdgw.profidrive.frame import IOPS_GOOD
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Direction, telegram

_PROBE: Final = frozenset({touch_probe.FUNCTION, touch_probe.STATUS, *touch_probe.POSITIONS})


@dataclass
class Recording:
    """Both captures on one clock, in nanoseconds of the PLC's capture."""

    axes: list[AxisRecording]
    plc: PlcInputs
    cycle_ns: int
    begin_ns: int
    """The first cyclic frame."""


@dataclass
class _Node:
    """The data of the CAN side about one axis, on its own clock."""

    axis: Axis
    feedback: list[Feedback] = field(default_factory=list)
    sdo: list[SdoResult] = field(default_factory=list)
    probe: list[ProbeTransfer] = field(default_factory=list)
    configured: list[Learned] = field(default_factory=list)
    sent: dict[int, list[Sent]] = field(default_factory=dict)
    online: list[tuple[int, bool]] = field(default_factory=list)
    drive: RecordedDrive = field(default_factory=RecordedDrive)
    rpdos: dict[int, Pdo | None] = field(default_factory=dict)
    end_ns: int = 0


class Collector:
    """Call ``add`` with every record of both captures.

    ``axes``: in the order of the frame, with their node-IDs; ``settings``: the user's settings by DO-ID. ``in_order``: the
    records are in the order in which the gateway processed them, as in its own recording: a frame that had waited in the
    kernel has an earlier time than the record before it, and counts from its place.
    """

    def __init__(
        self, axes: Sequence[Axis], settings: Mapping[int, AxisSettings] | None = None, *, in_order: bool = False
    ) -> None:
        self.axes = tuple(axes)
        self._in_order = in_order
        self._dealt_with = 0
        self._settings = dict(settings or {})
        self._nodes = [_Node(axis) for axis in self.axes]
        self._happened: list[Frame | Relation] = []
        self._link: ProfinetEndpoint | None = None
        """Over PROFINET: whether the relationship is confirmed."""
        self._valid: set[int] = set()
        """Drive objects with valid data in the present relationship: before, nothing is in the frame yet."""
        self._answers: dict[int, list[Answer]] = {axis.do_id: [] for axis in self.axes}
        self._begin_ns: int | None = None

    def add(self, record: Record) -> None:
        """One more record, in the order of its capture."""
        received_ns = record.time_ns
        if self._in_order:
            record.time_ns = self._dealt_with = max(self._dealt_with + 1, received_ns)
        if isinstance(record, CyclicRecord):
            if self._begin_ns is None:
                self._begin_ns = record.time_ns
            if record.direction is Direction.SETPOINT:
                self._happened.append(Frame(record.time_ns, record.data, received_ns))
            elif record.direction is Direction.ACTUAL:
                self._actual(record)
        elif isinstance(record, RelationRecord):
            self._relate(record.time_ns, record.change, record.connection)
        elif isinstance(record, AlarmRecord):
            if record.ended is not None:
                self._relate(record.time_ns, Change.ENDED, record.ended)
        elif isinstance(record, CanRecord):
            for node in self._nodes:
                to_all = isinstance(record, NmtRecord) and not record.node
                if (to_all or record.node == node.axis.node) and node.axis.bus in {"", record.channel}:
                    _take(node, record)

    # -- the PLC's side -----------------------------------------------------------------------------------------------

    def _relate(self, time_ns: int, change: Change, connection: Connection) -> None:
        if self._link is None:
            self._link = ProfinetEndpoint(self.axes, WATCHDOG_FACTOR)
        self._link.relate(change, connection)
        self._valid.clear()
        self._happened.append(Relation(time_ns, change, connection))

    def _actual(self, record: CyclicRecord) -> None:
        if self._link is not None and not self._link.ready:
            return
        for unit in record.units:
            good = bool((unit.iops or 0) & IOPS_GOOD)
            if good:
                self._valid.add(unit.axis)
            if unit.axis in self._answers and (self._link is None or unit.axis in self._valid):
                values = tuple(_integer(value) for value in unit.values)
                # On PROFINET, IOCS shows that the submodule is the right one, not that the PLC is connected.
                plc_ok = None if self._link is not None else bool((unit.iocs or 0) & IOPS_GOOD)
                self._answers[unit.axis].append(Answer(record.time_ns, values, good, plc_ok))

    # -- the result ---------------------------------------------------------------------------------------------------

    @property
    def _frame_times(self) -> list[int]:
        return [item.time_ns for item in self._happened if isinstance(item, Frame)]

    @cached_property
    def measured_cycle_ns(self) -> int:
        """The PLC's cycle: the median time between its frames."""
        return median_cycle_ns(self._frame_times)

    def measured_watchdog_factor(self, cycle_ns: int) -> int:
        """Cycles without a frame until the gateway's answers (IOCS) show the PLC as lost; the default where they never do."""
        if self._link is not None:
            return WATCHDOG_FACTOR
        frames = self._frame_times
        answers = next(iter(self._answers.values()), [])
        tolerated, lost = 0, None
        for answer in answers:
            position = bisect_right(frames, answer.time_ns)
            if not position:
                continue
            silent = (answer.time_ns - frames[position - 1]) // cycle_ns
            if answer.plc_ok:
                tolerated = max(tolerated, silent + 1)
            elif silent > 1 and (lost is None or silent < lost):
                lost = silent
        return lost if lost is not None and lost >= tolerated else max(WATCHDOG_FACTOR, tolerated)

    def _stopped_ns(self, watchdog_ns: int) -> int | None:
        """When the gateway itself began to stop: from then on no axis has a PLC (IOCS), and the PLC was not lost before."""
        answers = list(zip(*self._answers.values(), strict=False))
        position = len(answers)
        while position and not any(answer.plc_ok for answer in answers[position - 1]):
            position -= 1
        if not 0 < position < len(answers):
            return None
        end_ns = answers[position][0].time_ns
        frames = self._frame_times
        before = bisect_right(frames, end_ns)
        return end_ns if before and end_ns - frames[before - 1] <= watchdog_ns else None

    def recording(self, offset_ns: int, *, cycle_ns: int, watchdog_factor: int) -> Recording:
        """Everything on the PLC's clock; ``offset_ns`` is the CAN capture's clock minus the PLC's."""
        happened = sorted(self._happened, key=lambda item: item.time_ns)
        watchdog_ns = cycle_ns * watchdog_factor
        if self._link is not None:
            endpoint = ProfinetEndpoint(self.axes, watchdog_factor)
            plc = receive_profinet(happened, endpoint)
            watchdog_ns = endpoint.watchdog_ns
        else:
            plc = receive_frames(
                [item for item in happened if isinstance(item, Frame)],
                [telegram(axis.telegram) for axis in self.axes],
                cycle_ns=cycle_ns,
                watchdog_factor=watchdog_factor,
                stopped_ns=self._stopped_ns(watchdog_ns),
            )
        used = [item.time_ns for item in plc.received if item.verdict in USED]
        axes = [
            self._axis(node, plc.setpoints[position], used, offset_ns, watchdog_ns)
            for position, node in enumerate(self._nodes)
        ]
        return Recording(axes, plc, cycle_ns, self._begin_ns or 0)

    def _axis(
        self, node: _Node, setpoints: list[Setpoints], used: list[int], offset_ns: int, watchdog_ns: int
    ) -> AxisRecording:
        do_id = node.axis.do_id
        configured = [item._replace(time_ns=item.time_ns - offset_ns) for item in node.configured]
        if not any(item.configured.restarted for item in configured):
            # The recording starts in operation: values that it does not contain are the defaults of the profile.
            begin = min([used[0] if used else 0, *(item.time_ns for item in configured)])
            node.drive.homing_method = node.drive.homing_method or _shown_method(
                node.axis.telegram, self._answers[do_id]
            )
            configured.insert(0, Learned(begin, node.drive.configured(restarted=False)))
        return AxisRecording(
            do_id,
            node.axis.node,
            telegram(node.axis.telegram),
            self._settings.get(do_id, AxisSettings()),
            used,
            setpoints,
            sorted((item._replace(time_ns=item.time_ns - offset_ns) for item in node.feedback), key=_time),
            [replace(item, time_ns=item.time_ns - offset_ns) for item in node.sdo],
            [item._replace(time_ns=item.time_ns - offset_ns) for item in node.probe],
            configured,
            sorted(self._answers[do_id], key=_time),
            {
                number: sorted((Sent(item.time_ns - offset_ns, item.data) for item in frames), key=_time)
                for number, frames in node.sent.items()
            },
            [(now - offset_ns, online) for now, online in node.online],
            node.end_ns - offset_ns,
            watchdog_ns,
            self._link is not None,
            tuple(pdo for _, pdo in sorted(node.rpdos.items()) if pdo is not None),
            self._in_order,
        )


def _time(item: Feedback | Answer | Sent) -> int:
    return item.time_ns


def _shown_method(number: int, answers: Sequence[Answer]) -> int:
    """The homing method in AKTSATZ of the first answer; 0 where the telegram has none."""
    names = telegram(number).actuals.names
    if "AKTSATZ" not in names or not answers:
        return 0
    return signal("AKTSATZ").bit("HOMING_METHOD").of(answers[0].actuals[names.index("AKTSATZ")])


def _integer(value: object) -> int:
    return value if isinstance(value, int) else 0


# -- CAN --------------------------------------------------------------------------------------------------------------


def _take(node: _Node, record: CanRecord) -> None:
    node.end_ns = max(node.end_ns, record.time_ns)
    if isinstance(record, PdoRecord):
        _pdo(node, record)
    elif isinstance(record, SdoRecord):
        _sdo(node, record)
    elif isinstance(record, NmtRecord):
        _nmt(node, record)
    elif isinstance(record, HeartbeatRecord) and record.state == NmtState.BOOT_UP:
        _offline(node, record.time_ns)


def _pdo(node: _Node, record: PdoRecord) -> None:
    layout, now, drive = record.layout, record.time_ns, node.drive
    parts = drive.parts(layout)
    if parts.direction is PdoDirection.RPDO:
        node.sent.setdefault(parts.number, []).append(Sent(now, record.data[: layout.size]))
        if parts.number not in node.rpdos:
            node.rpdos[parts.number] = recorded_rpdo(layout, drive.families)
        return
    if drive.started and (not node.online or not node.online[-1][1]):
        node.online.append((now, True))
    if drive.is_new(record):
        node.feedback.append(Feedback(now, parts.feedback(layout.unpack(record.data))))


def _sdo(node: _Node, record: SdoRecord) -> None:
    if record.index in _PROBE:
        _probe(node, record, record.index)
    result = sdo_result(record)
    if result is not None:
        node.sdo.append(result)
    elif not record.from_client and (learned := node.drive.learn(record)) is not None:
        before, value = learned
        if node.drive.started and before is not None and before != value:
            node.configured.append(Learned(record.time_ns, node.drive.configured(restarted=False)))


def _probe(node: _Node, record: SdoRecord, index: int) -> None:
    written = "download" in record.step
    if record.abort is not None:
        node.probe.append(ProbeTransfer(record.time_ns, index, 0, written, record.abort))
    elif record.value is not None and not record.from_client:
        signed = index in touch_probe.POSITIONS
        value = int.from_bytes(record.value, "little", signed=signed)
        node.probe.append(ProbeTransfer(record.time_ns, index, value, written))


def _nmt(node: _Node, record: NmtRecord) -> None:
    if record.command == NmtCommand.START:
        node.drive.started = True
        node.configured.append(Learned(record.time_ns, node.drive.configured(restarted=True)))
    else:
        _offline(node, record.time_ns)


def _offline(node: _Node, now: int) -> None:
    node.drive.stop()
    if node.online and node.online[-1][1]:
        node.online.append((now, False))
