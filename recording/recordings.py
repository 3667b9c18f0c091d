"""Open captures of both buses for the timeline (as a stream) and for replay (as one ``Recording``).

Axes come from the configuration, from given telegrams and nodes, or are inferred from the frames. Each file has its own clock
unless it contains both buses.
"""

from __future__ import annotations

import heapq
import os
import re
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import overload

from pdgw.decoder.capture.axes import configured_axes
from pdgw.decoder.capture.dictionary import dictionary_of
from pdgw.decoder.capture.pcapng_file import configuration_in
from pdgw.decoder.capture.source import STANDARD_INPUT, Source, open_source
from pdgw.decoder.export.trace_page import TracePage
from pdgw.decoder.frames.engine import Axis, Decoder, Settings, given_axes
from pdgw.decoder.frames.records import BusKind, Record
from pdgw.decoder.replay.recording import Collector, Recording
from pdgw.decoder.replay.replay import Replayer
from pdgw.decoder.replay.result import AxisReplay
from pdgw.decoder.timeline.builder import HOLD_NS, TimelineBuilder
from pdgw.decoder.timeline.clocks import ONE_CLOCK, Clocks
from pdgw.decoder.timeline.entries import Entry
from pdgw.decoder.timeline.lookahead import Lookahead, is_of
from pdgw.ds301.connection_set import NODE_IDS
from pdgw.durations import MS, SECOND
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import load_config, parse_config
from pdgw.gateway.errors import GatewayError
from pdgw.recording.defaults import TOLERANCE_NS
from pdgw.recording.progress import with_progress

INFER_FROM = 20_000
"""Packets of a file that are searched for the telegrams."""
_MIN_TOLERANCE_CYCLES = 4
CONFIGURATION = "gateway.toml"
"""Beside captures: the configuration they were made with."""
_STRETCH_NS = 2 * SECOND
"""Part of each capture that is read in turn before a timeline begins."""
_LOOK_AT = 50_000
_FEW_CHANGES = 4
"""After this number of packets, this smaller number of changes of words is enough."""
_EVIDENCE = {BusKind.PLC: "cyclic frames", BusKind.CAN: "CAN frames"}
_AXIS_NODE = re.compile(r"(?:(\d{1,3})=)?(\d{1,3})")

Notify = Callable[[str], None]


@dataclass(frozen=True)
class Known:
    """Known facts; ``cycle_ns`` and ``watchdog_factor`` None: measured. ``choices``: the user's settings for each axis, by
    DO-ID."""

    settings: Settings = field(default_factory=Settings)
    choices: dict[int, AxisSettings] = field(default_factory=dict)
    cycle_ns: int | None = None
    watchdog_factor: int | None = None


def known_from(
    config: Path | None, telegrams: Sequence[int], nodes: Sequence[str], files: Sequence[str] = (), station: str = ""
) -> Known:
    """From ``--config``, ``--telegram``, ``--node`` ([AXIS=]NODE) and ``--station``; GatewayError for what does not fit together.

    Without any of the first three the configuration is looked for in the ``files`` (a comment of `pdgw run --record`), then
    beside them.
    """
    known = _known_from(config, telegrams, nodes, files)
    return replace(known, settings=replace(known.settings, station=station))


def _known_from(config: Path | None, telegrams: Sequence[int], nodes: Sequence[str], files: Sequence[str]) -> Known:
    if config is not None:
        return _known_of(load_config(config), telegrams, nodes)
    if telegrams:
        return Known(Settings(_with_nodes(list(given_axes(telegrams)), nodes), "--telegram and --node"))
    if nodes:
        raise GatewayError("--node: give --telegram for each axis too, or --config")
    for file in files:
        text = configuration_in(Path(file))
        if text:
            print_notice(f"the configuration of the gateway is read from {file}")
            return _known_of(parse_config(text, f"{file}: its configuration"), telegrams, nodes)
    for file in files:
        beside = Path(file).parent / CONFIGURATION
        if beside.is_file():
            print_notice(f"the configuration of the gateway is read from {beside}")
            return _known_of(load_config(beside), telegrams, nodes)
    return Known()


def _known_of(loaded: GatewayConfig, telegrams: Sequence[int], nodes: Sequence[str]) -> Known:
    axes = _with_nodes(configured_axes(loaded, telegrams), nodes)
    files = {axis.node_id: axis.eds for axis in loaded.axis if axis.eds and axis.eds.is_file()}
    settings = Settings(axes, dictionary=dictionary_of(files) if files else None)
    transport = loaded.transport
    return Known(
        replace(
            settings,
            cyclic_ports=settings.cyclic_ports | {transport.cyclic_port},
            acyclic_ports=settings.acyclic_ports | {transport.acyclic_port} - {0},
        ),
        {axis.do_id: axis.settings_at(transport.cycle_time_ms) for axis in loaded.axis},
        int(transport.cycle_time_ms * MS),
        transport.watchdog_factor,
    )


def _with_nodes(axes: list[Axis], nodes: Sequence[str]) -> list[Axis]:
    for position, text in enumerate(nodes):
        match = _AXIS_NODE.fullmatch(text)
        if match is None or int(match[2]) not in NODE_IDS:
            raise GatewayError(f"--node {text}: expected NODE or AXIS=NODE, node-ID 1..127")
        do_id = int(match[1]) if match[1] else position + 1
        found = [i for i, axis in enumerate(axes) if axis.do_id == do_id]
        if not found:
            known = ", ".join(str(axis.do_id) for axis in axes)
            raise GatewayError(f"--node {text}: there is no axis {do_id}, expected one of {known}")
        axes[found[0]] = replace(axes[found[0]], node=int(match[2]))
    return axes


@dataclass(frozen=True)
class Loaded:
    """Both captures on one clock."""

    recording: Recording
    clocks: Clocks
    files: tuple[str, ...]

    def replay(self, *, tolerance_ns: int = TOLERANCE_NS, first_only: bool = False) -> list[AxisReplay]:
        """Today's gateway on the recorded inputs of the drives; GatewayError where there is no drive."""
        drives = [axis for axis in self.recording.axes if axis.telegram.number in DRIVE_TELEGRAM_NUMBERS]
        if not drives:
            raise GatewayError(
                f"{', '.join(self.files)}: the capture has no drive telegram; encoders cannot be replayed"
            )
        cycle_ns = self.recording.cycle_ns
        tolerance_ns = max(tolerance_ns, _MIN_TOLERANCE_CYCLES * cycle_ns) + self.clocks.uncertainty_ns
        replayers = [Replayer(axis, cycle_ns=cycle_ns, tolerance_ns=tolerance_ns) for axis in drives]
        return [replayer.run(first_only=first_only) for replayer in replayers]


@dataclass(frozen=True)
class Opening:
    """Result of the first part of captures, enough to read them from the start in one pass."""

    files: tuple[str, ...]
    known: Known
    clocks: Clocks
    cycle_ns: int
    begin_ns: int
    """The first cyclic frame, on the PLC's clock; where there is none, the first packet."""
    shifted: frozenset[str]
    """The files whose clock is not the PLC's."""
    assumed: tuple[str, ...] = ()
    """Facts that neither the user nor the captures contain."""

    def records(self) -> Iterator[Record]:
        """All packets of all files in the order of time, on the PLC's clock."""
        with ExitStack() as closing:
            sources = [closing.enter_context(open_source(file)) for file in self.files]
            parts = [self._records(source) for source in sources]
            merged = heapq.merge(*parts, key=_time) if len(parts) > 1 else parts[0]
            size = sum(source.size or 0 for source in sources)
            yield from with_progress(merged, "following", size, lambda: sum(s.position() for s in sources))

    def _records(self, source: Source) -> Iterator[Record]:
        decoder = Decoder(self.known.settings)
        offset_ns = self.clocks.offset_ns if source.name in self.shifted else 0
        for packet in source.packets:
            record = decoder.decode(packet)
            record.time_ns -= offset_ns
            yield record
            decoder.notices.clear()


_time = attrgetter("time_ns")


def look_ahead(files: Sequence[str], known: Known, offset_ns: int | None, notify: Notify) -> Opening:
    """Read the captures until clocks, axes and cycle are known; CaptureError for damaged ones, GatewayError for unusable ones."""
    known, assumed = _with_axes(files, known, notify)
    looking = Lookahead(known.settings.axes)
    buses: dict[str, set[BusKind]] = {file: set() for file in files}
    one_clock = False
    with ExitStack() as closing:
        parts = {file: _Reading(closing.enter_context(open_source(file)), known.settings, notify) for file in files}
        count = 0
        while not all(part.ended for part in parts.values()):
            for file, part in parts.items():
                for record in part.advance():
                    looking.add(record)
                    count += 1
                    bus = is_of(record)
                    if bus is not None:
                        buses[file].add(bus)
            one_clock = any(len(found) > 1 for found in buses.values())
            sure = offset_ns is not None or one_clock or looking.enough
            few = min(looking.changes.values()) >= _FEW_CHANGES and count >= _LOOK_AT
            alone = len(parts) == 1 and (known.cycle_ns or looking.begin_ns is not None) and count >= _LOOK_AT
            if alone or (len(_seen(buses)) == len(BusKind) and (sure or few)):
                break
    if not _seen(buses):
        raise GatewayError(f"{', '.join(files)}: neither {' nor '.join(_EVIDENCE.values())}")
    one_clock |= len(_seen(buses)) == 1 or len(files) == 1
    cycle_ns = known.cycle_ns or looking.cycle_ns
    clocks = _clocks(offset_ns, one_clock, looking, cycle_ns)
    shifted = frozenset(file for file, found in buses.items() if BusKind.PLC not in found)
    begin_ns = next((time_ns for time_ns in (looking.begin_ns, looking.first_ns) if time_ns is not None), 0)
    return Opening(tuple(files), known, clocks, cycle_ns, begin_ns, shifted, tuple(assumed))


@dataclass(frozen=True)
class Part:
    """A part of a timeline: times (both included) in nanoseconds of the PLC's clock, DO-IDs (none: all)."""

    begin_ns: int | None = None
    end_ns: int | None = None
    do_ids: frozenset[int] = frozenset()

    def has(self, time_ns: int, do_id: int) -> bool:
        """Whether something of this time and drive object (0: of all) belongs to it."""
        return (
            (self.begin_ns is None or time_ns >= self.begin_ns)
            and (self.end_ns is None or time_ns <= self.end_ns)
            and (not self.do_ids or do_id in self.do_ids or not do_id)
        )


@overload
def followed(opening: Opening, part: Part = ...) -> Iterator[Entry]: ...
@overload
def followed(opening: Opening, part: Part = ..., *, packets: bool) -> Iterator[Entry | Record]: ...


def followed(opening: Opening, part: Part = Part(), *, packets: bool = False) -> Iterator[Entry | Record]:
    """The timeline of a part, in the order of time; with ``packets`` every packet of that time too."""
    builder = TimelineBuilder(
        opening.known.settings.axes,
        opening.known.choices,
        cycle_ns=opening.cycle_ns,
        watchdog_factor=opening.known.watchdog_factor,
        one_clock=opening.clocks.exact,
    )
    waiting: deque[Record] = deque()
    stop_ns = None if part.end_ns is None else part.end_ns + HOLD_NS

    def before(time_ns: int | None) -> Iterator[Record]:
        while waiting and (time_ns is None or waiting[0].time_ns <= time_ns):
            yield waiting.popleft()

    def given(entries: Sequence[Entry]) -> Iterator[Entry | Record]:
        for entry in entries:
            if part.has(entry.time_ns, entry.do_id):
                yield from before(entry.time_ns)
                yield entry

    for record in opening.records():
        if stop_ns is not None and record.time_ns > stop_ns:
            break
        if packets and part.has(record.time_ns, 0):
            waiting.append(record)
        entries = builder.add(record)
        if entries:
            yield from given(entries)
        if waiting and builder.horizon_ns is not None:
            yield from before(builder.horizon_ns)
    yield from given(builder.finish())
    yield from before(None)


def write_page(opening: Opening, part: Part, path: Path) -> None:
    """The timeline of a part as an HTML page with its curves; GatewayError when it cannot be written."""
    page = TracePage(" ".join(Path(file).name for file in opening.files), opening.begin_ns)
    for item in followed(opening, part, packets=True):
        page.take(item)
    page.write(path)


class _Reading:
    """One capture, read in stretches of recorded time."""

    def __init__(self, source: Source, settings: Settings, notify: Notify) -> None:
        self.ended = False
        self._records = _decoded_from(source, settings, notify)
        self._until: int | None = None
        self._next: Record | None = None

    def advance(self) -> Iterator[Record]:
        """The next stretch."""
        record = self._next or next(self._records, None)
        if record is not None:
            self._until = max(self._until or 0, record.time_ns) + _STRETCH_NS
        while record is not None and self._until is not None and record.time_ns <= self._until:
            yield record
            record = next(self._records, None)
        self._next = record
        self.ended = record is None


def _clocks(offset_ns: int | None, one_clock: bool, looking: Lookahead, cycle_ns: int) -> Clocks:
    """The clocks of both buses: given, one clock, or from the edges."""
    if offset_ns is not None:
        return Clocks(offset_ns)
    return Clocks(0, origin=ONE_CLOCK) if one_clock else looking.clocks(cycle_ns)


def _seen(buses: Mapping[str, set[BusKind]]) -> set[BusKind]:
    """The buses that are in any of the files."""
    return set[BusKind]().union(*buses.values())


def _with_axes(files: Sequence[str], known: Known, notify: Notify) -> tuple[Known, list[str]]:
    """The axes, inferred if not given, with the assumptions."""
    if STANDARD_INPUT in files:
        raise GatewayError("-: captures of both buses are read more than once; give files instead of standard input")
    assumed = []
    if not known.settings.axes:
        known = replace(known, settings=replace(known.settings, axes=_inferred(files, known, notify)))
        assumed.append("telegrams from the frame lengths; the axis number is the node-ID")
    if not known.choices:
        assumed.append(
            "configuration choices (on_plc_loss, setpoint_enable ...) have their defaults; give the file with --config"
        )
    return known, assumed


def load(files: Sequence[str], known: Known, offset_ns: int | None, notify: Notify) -> Loaded:
    """Read the captures and bring them on one clock; CaptureError for damaged ones, GatewayError for unusable ones."""
    known, _ = _with_axes(files, known, notify)
    axes = known.settings.axes
    # The gateway itself writes one file, with its configuration in it.
    in_order = len(files) == 1 and bool(configuration_in(Path(files[0])))
    collector, looking = Collector(axes, known.choices, in_order=in_order), Lookahead(axes)
    buses: dict[str, set[BusKind]] = {}
    for file in files:
        buses[file] = set()
        for record in _decoded(file, known.settings, notify):
            looking.add(record)
            collector.add(record)
            bus = is_of(record)
            if bus is not None:
                buses[file].add(bus)
    for bus in BusKind:
        if bus not in _seen(buses):
            raise GatewayError(
                f"{', '.join(files)}: no {_EVIDENCE[bus]}; a replay compares both buses. `pdgw timeline` shows "
                "what the capture contains"
            )
    cycle_ns = known.cycle_ns or collector.measured_cycle_ns
    watchdog_factor = known.watchdog_factor or collector.measured_watchdog_factor(cycle_ns)
    one_clock = any(len(found) > 1 for found in buses.values())
    clocks = _clocks(offset_ns, one_clock, looking, cycle_ns)
    recording = collector.recording(clocks.offset_ns, cycle_ns=cycle_ns, watchdog_factor=watchdog_factor)
    return Loaded(recording, clocks, tuple(files))


def _inferred(files: Sequence[str], known: Known, notify: Notify) -> Sequence[Axis]:
    """The axes as the frames themselves show them, each with its number as node-ID."""
    for file in files:
        with open_source(file) as source:
            decoder = Decoder(known.settings)
            for packet in islice(source.packets, INFER_FROM):
                decoder.decode(packet)
        if decoder.axes:
            for notice in decoder.notices:
                notify(notice)
            return [replace(axis, node=axis.node or axis.do_id) for axis in decoder.axes]
    raise GatewayError(
        f"{', '.join(files)}: the frames do not show the telegrams; give --telegram and --node, or --config"
    )


def _decoded(file: str, settings: Settings, notify: Notify) -> Iterator[Record]:
    with open_source(file) as source:
        yield from _decoded_from(source, settings, notify)


def _decoded_from(source: Source, settings: Settings, notify: Notify) -> Iterator[Record]:
    decoder = Decoder(settings)
    for packet in source.packets:
        yield decoder.decode(packet)
        for notice in decoder.notices:
            notify(notice)
        decoder.notices.clear()


# -- the edges of the commands ------------------------------------------------------------------------------------------


def nanoseconds(seconds: float | None) -> int | None:
    """An option in seconds; None stays None. GatewayError for an invalid time."""
    if seconds is None:
        return None
    try:
        return round(seconds * SECOND)
    except (ValueError, OverflowError):
        raise GatewayError(f"--offset {seconds}: expected a finite number of seconds") from None


def print_notice(notice: str) -> None:
    """A notice beside the output."""
    sys.stderr.write(f"note: {notice}\n")


def write_lines(lines: Iterator[str]) -> None:
    """Print until the end, or until the reader of a pipe has seen enough."""
    try:
        for line in lines:
            sys.stdout.write(line + "\n")
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
