"""A recording of both buses: records of the captures sorted by axis, as replay and timeline need them.

``Collector`` takes the records of all captures in any order of the files; ``recording`` puts the CAN side on the PLC's clock.
Kept is what the gateway took in and sent out, as plain tuples; memory grows with the captures. Left out: frames of several
PLCs (all count as one sender), nodes that belong to no axis.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Final, NamedTuple

from pdgw.decoder.cyclic import Axis
from pdgw.decoder.records import (
    CanRecord,
    CyclicRecord,
    EmcyRecord,
    HeartbeatRecord,
    NmtRecord,
    PdoRecord,
    Record,
    SdoRecord,
)
from pdgw.decoder.replay import (
    Answer,
    AxisRecording,
    Configured,
    Feedback,
    PlcInputs,
    SdoResult,
    Sent,
    Setpoints,
    receive_frames,
)
from pdgw.ds301.aborts import abort_text
from pdgw.ds301.nmt import NmtCommand, NmtState
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.images import REFERENCE_OBJECTS, References
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.gateway.translator.base import TranslatorSettings
from pdgw.gateway.transport.cyclic import Verdict
from pdgw.profidrive.frame import IOPS_GOOD
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Direction, telegram

_HOMING_METHOD: Final = (0x6098, 0)
_CONTROLWORD: Final = 0x6040
_STATUSWORD: Final = 0x6041
_WATCHDOG_FACTOR = 3
_REFERENCE = {(index, subindex): name for name, index, subindex in REFERENCE_OBJECTS}


class Word(NamedTuple):
    """A control or status word that differs from the one before."""

    time_ns: int
    value: int


class Note(NamedTuple):
    """An event of a node in words: EMCY, boot-up, NMT command, change of state."""

    time_ns: int
    kind: str
    text: str


def changes(words: Sequence[Word]) -> Iterator[tuple[Word, Word]]:
    """The words that differ from the one before, each with that one; the first word is none, it was there before."""
    return ((before, word) for before, word in pairwise(words) if before.value != word.value)


@dataclass
class AxisWords:
    """The words of one axis as both buses carried them, every frame."""

    control: list[Word] = field(default_factory=list)
    """First signal of the PLC's frames (STW1, Controlword)."""
    status: list[Word] = field(default_factory=list)
    """First signal of the gateway's frames (ZSW1, Statusword)."""
    controlword: list[Word] = field(default_factory=list)
    statusword: list[Word] = field(default_factory=list)
    mode: list[Word] = field(default_factory=list)
    """6060h as the gateway sent it."""
    mode_display: list[Word] = field(default_factory=list)
    """6061h as the drive sent it."""
    notes: list[Note] = field(default_factory=list)
    iops_bad: list[tuple[int, int, str]] = field(default_factory=list)
    """From, to and who: the PLC's or the gateway's data of this axis were marked bad."""


class Frame(NamedTuple):
    """A cyclic frame of either direction."""

    time_ns: int
    counter: int
    data: bytes


@dataclass
class Recording:
    """Both captures on one clock, in nanoseconds of the PLC's capture."""

    axes: list[AxisRecording]
    words: dict[int, AxisWords]
    """By DO-ID."""
    plc: PlcInputs
    frames: dict[Direction, list[Frame]]
    cycle_ns: int
    begin_ns: int
    end_ns: int


def _shifted(words: Sequence[Word], offset_ns: int) -> list[Word]:
    return sorted(Word(word.time_ns - offset_ns, word.value) for word in words)


@dataclass
class _Node:
    """What the CAN side said about one axis, on its own clock."""

    axis: Axis
    feedback: list[Feedback] = field(default_factory=list)
    sdo: list[SdoResult] = field(default_factory=list)
    configured: list[Configured] = field(default_factory=list)
    sent: dict[int, list[Sent]] = field(default_factory=dict)
    online: list[tuple[int, bool]] = field(default_factory=list)
    words: AxisWords = field(default_factory=AxisWords)
    references: dict[str, int] = field(default_factory=dict)
    homing_method: int = 0
    started: bool = True
    """Until an NMT command says otherwise: a recording may begin in operation."""
    last: dict[int, bytes] = field(default_factory=dict)
    end_ns: int = 0

    def known_references(self) -> References:
        return replace(References(), **self.references)


class Collector:
    """Feed ``add`` every record of both captures.

    ``axes``: in the order of the frame, with their node-IDs; ``settings`` the choices of the user by DO-ID.
    """

    def __init__(self, axes: Sequence[Axis], settings: Mapping[int, TranslatorSettings] | None = None) -> None:
        self.axes = tuple(axes)
        self._settings = dict(settings or {})
        self._nodes = [_Node(axis) for axis in self.axes]
        self._setpoint_frames: list[Frame] = []
        self._actual_frames: list[Frame] = []
        self._answers: dict[int, list[Answer]] = {axis.do_id: [] for axis in self.axes}
        self._control: dict[int, list[Word]] = {axis.do_id: [] for axis in self.axes}
        self._status: dict[int, list[Word]] = {axis.do_id: [] for axis in self.axes}
        self._bad: dict[int, list[tuple[int, int, str]]] = {axis.do_id: [] for axis in self.axes}
        self._bad_since: dict[tuple[int, Direction], int] = {}
        self.can_begin_ns: int | None = None
        self.plc_begin_ns: int | None = None

    def add(self, record: Record) -> None:
        """One more record, in the order of its capture."""
        if isinstance(record, CyclicRecord):
            if self.plc_begin_ns is None:
                self.plc_begin_ns = record.time_ns
            if record.direction is Direction.SETPOINT:
                self._setpoint(record)
            elif record.direction is Direction.ACTUAL:
                self._actual(record)
        elif isinstance(record, CanRecord):
            if self.can_begin_ns is None:
                self.can_begin_ns = record.time_ns
            for node in self._nodes:
                to_all = isinstance(record, NmtRecord) and not record.node
                if (to_all or record.node == node.axis.node) and node.axis.bus in {"", record.channel}:
                    _take(node, record)

    def words(self) -> dict[int, AxisWords]:
        """The words of each axis, either side on its own clock: what the clocks are compared by."""
        return {
            node.axis.do_id: replace(
                node.words,
                control=self._control[node.axis.do_id],
                status=self._status[node.axis.do_id],
                iops_bad=self._bad[node.axis.do_id],
            )
            for node in self._nodes
        }

    # -- the PLC's side -----------------------------------------------------------------------------------------------

    def _setpoint(self, record: CyclicRecord) -> None:
        self._setpoint_frames.append(Frame(record.time_ns, record.cycle_counter, record.data))
        for unit in record.units:
            if unit.axis in self._control:
                self._control[unit.axis].append(Word(record.time_ns, _integer(unit.values[0])))
                self._quality(record.time_ns, unit.axis, Direction.SETPOINT, unit.iops)

    def _actual(self, record: CyclicRecord) -> None:
        self._actual_frames.append(Frame(record.time_ns, record.cycle_counter, record.data))
        for unit in record.units:
            if unit.axis in self._answers:
                values = tuple(_integer(value) for value in unit.values)
                good, plc_ok = bool((unit.iops or 0) & IOPS_GOOD), bool((unit.iocs or 0) & IOPS_GOOD)
                self._answers[unit.axis].append(Answer(record.time_ns, values, good, plc_ok))
                self._status[unit.axis].append(Word(record.time_ns, values[0]))
                self._quality(record.time_ns, unit.axis, Direction.ACTUAL, unit.iops)

    def _quality(self, now: int, do_id: int, direction: Direction, iops: int | None) -> None:
        """Note for how long process data were marked bad."""
        key = (do_id, direction)
        if not (iops or 0) & IOPS_GOOD:
            self._bad_since.setdefault(key, now)
        elif key in self._bad_since:
            who = "of the PLC" if direction is Direction.SETPOINT else "of the gateway"
            self._bad[do_id].append((self._bad_since.pop(key), now, who))

    # -- the result ---------------------------------------------------------------------------------------------------

    @cached_property
    def measured_cycle_ns(self) -> int:
        """The PLC's cycle: the median time between its frames."""
        times = [frame.time_ns for frame in self._setpoint_frames]
        gaps = sorted(later - earlier for earlier, later in pairwise(times))
        return max(1, gaps[len(gaps) // 2]) if gaps else 4_000_000

    def measured_watchdog_factor(self, cycle_ns: int) -> int:
        """Cycles without a frame after which the gateway's answers (IOCS) show the PLC as lost; 3 where they never do."""
        frames = [frame.time_ns for frame in self._setpoint_frames]
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
        return lost if lost is not None and lost >= tolerated else max(_WATCHDOG_FACTOR, tolerated)

    def recording(self, offset_ns: int, *, cycle_ns: int, watchdog_factor: int) -> Recording:
        """Everything on the PLC's clock; ``offset_ns`` is the CAN capture's clock minus the PLC's."""
        frames = sorted(self._setpoint_frames, key=lambda frame: frame.time_ns)
        telegrams = [telegram(axis.telegram) for axis in self.axes]
        plc = receive_frames(
            [(frame.time_ns, frame.data) for frame in frames],
            telegrams,
            cycle_ns=cycle_ns,
            watchdog_factor=watchdog_factor,
        )
        used = [item.time_ns for item in plc.received if item.verdict in {Verdict.ACCEPTED, Verdict.PROVIDER_STOP}]
        axes = [
            self._axis(node, plc.setpoints[position], used, offset_ns, cycle_ns * watchdog_factor)
            for position, node in enumerate(self._nodes)
        ]
        words = {
            do_id: replace(
                item,
                controlword=_shifted(item.controlword, offset_ns),
                statusword=_shifted(item.statusword, offset_ns),
                mode=_shifted(item.mode, offset_ns),
                mode_display=_shifted(item.mode_display, offset_ns),
                notes=[Note(note.time_ns - offset_ns, note.kind, note.text) for note in item.notes],
            )
            for do_id, item in self.words().items()
        }
        actual = sorted(self._actual_frames, key=lambda frame: frame.time_ns)
        times = [items[i].time_ns for items in (frames, actual) if items for i in (0, -1)]
        return Recording(
            axes,
            words,
            plc,
            {Direction.SETPOINT: frames, Direction.ACTUAL: actual},
            cycle_ns,
            min(times, default=0),
            max(times, default=0),
        )

    def _axis(
        self, node: _Node, setpoints: list[Setpoints], used: list[int], offset_ns: int, watchdog_ns: int
    ) -> AxisRecording:
        do_id = node.axis.do_id
        configured = [item._replace(time_ns=item.time_ns - offset_ns) for item in node.configured]
        if not any(item.restarted for item in configured):
            # The recording begins in operation: what it does not show is taken from the defaults of the profile.
            begin = min([used[0] if used else 0, *(item.time_ns for item in configured)])
            method = node.homing_method or _shown_method(node.axis.telegram, self._answers[do_id])
            configured.insert(0, Configured(begin, node.known_references(), method, restarted=False))
        return AxisRecording(
            do_id,
            node.axis.node,
            telegram(node.axis.telegram),
            self._settings.get(do_id, TranslatorSettings()),
            used,
            setpoints,
            sorted((item._replace(time_ns=item.time_ns - offset_ns) for item in node.feedback), key=_time),
            [replace(item, time_ns=item.time_ns - offset_ns) for item in node.sdo],
            configured,
            sorted(self._answers[do_id], key=_time),
            {
                number: sorted((Sent(item.time_ns - offset_ns, item.data) for item in frames), key=_time)
                for number, frames in node.sent.items()
            },
            [(now - offset_ns, online) for now, online in node.online],
            node.end_ns - offset_ns,
            watchdog_ns,
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
    elif isinstance(record, HeartbeatRecord):
        if record.changed:
            node.words.notes.append(Note(record.time_ns, "state", f"node {record.node}: {record.text}"))
        if record.state == NmtState.BOOT_UP:
            _offline(node, record.time_ns)
    elif isinstance(record, EmcyRecord):
        node.words.notes.append(Note(record.time_ns, "EMCY", f"node {record.node}: {record.text}"))


def _pdo(node: _Node, record: PdoRecord) -> None:
    layout = record.layout
    number = int(layout.name.removeprefix(PdoDirection.RPDO.label).removeprefix(PdoDirection.TPDO.label))
    values = {
        address: value
        for address, value in zip(layout.addresses, layout.unpack(record.data), strict=True)
        if isinstance(value, int)
    }
    now, words = record.time_ns, node.words
    if layout.name.startswith(PdoDirection.RPDO.label):
        node.sent.setdefault(number, []).append(Sent(now, record.data[: layout.size]))
        _word(words.controlword, now, values.get((_CONTROLWORD, 0)))
        _word(words.mode, now, values.get((0x6060, 0)))
        return
    if node.started and (not node.online or not node.online[-1][1]):
        node.online.append((now, True))
    _word(words.statusword, now, values.get((_STATUSWORD, 0)))
    _word(words.mode_display, now, values.get((0x6061, 0)))
    if node.last.get(record.cob_id) == record.data:
        return
    node.last[record.cob_id] = record.data
    known = [(DRIVE_OBJECTS.get(*address), value) for address, value in values.items()]
    node.feedback.append(Feedback(now, tuple((entry.attribute, value) for entry, value in known if entry is not None)))


def _word(words: list[Word], now: int, value: int | None) -> None:
    if value is not None:
        words.append(Word(now, value))


def _sdo(node: _Node, record: SdoRecord) -> None:
    if record.index is None or record.subindex is None:
        return
    address = (record.index, record.subindex)
    if record.abort is not None:
        node.sdo.append(SdoResult(record.time_ns, *address, b"", abort_text(record.abort)))
    if record.from_client or record.value is None:
        return
    if "download" in record.step:
        node.sdo.append(SdoResult(record.time_ns, *address, record.value))
        if address == (0x6060, 0):
            _word(node.words.mode, record.time_ns, int.from_bytes(record.value, "little", signed=True))
        return
    if address == _HOMING_METHOD:
        node.homing_method = int.from_bytes(record.value, "little", signed=True)
    name = _REFERENCE.get(address)
    if name is None:
        return
    value = int.from_bytes(record.value, "little", signed=name.startswith("position"))
    before = node.references.get(name)
    node.references[name] = value
    if node.started and before is not None and before != value:
        node.configured.append(Configured(record.time_ns, node.known_references(), node.homing_method, restarted=False))


def _nmt(node: _Node, record: NmtRecord) -> None:
    node.words.notes.append(Note(record.time_ns, "NMT", record.text))
    if record.command == NmtCommand.START:
        node.started = True
        node.configured.append(Configured(record.time_ns, node.known_references(), node.homing_method))
    else:
        _offline(node, record.time_ns)


def _offline(node: _Node, now: int) -> None:
    node.started = False
    node.last.clear()
    if node.online and node.online[-1][1]:
        node.online.append((now, False))
