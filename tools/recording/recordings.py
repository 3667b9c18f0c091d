"""Open captures of both buses for the timeline, and recordings of the gateway for the replay.

Axes come from the configuration, from given telegrams and nodes, or are inferred from the frames. Each file has its own clock
unless it contains both buses.
"""

from __future__ import annotations

import heapq
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import NODE_IDS
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.defaults import USUAL_CYCLE_MS, WATCHDOG_FACTOR
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.pcapng import Description
from pdgw.gateway.trace.reader import Cycle, Frame, Parser
from pdgw.profidrive.telegrams import Direction
from pdgw.tools.decoder.capture.knowledge import configured_settings
from pdgw.tools.decoder.capture.pcap import CaptureError, configuration_in, head_of, unpacked
from pdgw.tools.decoder.capture.source import STANDARD_INPUT, Source, open_source, unreadable
from pdgw.tools.decoder.frames.canopen.can_records import CanRecord
from pdgw.tools.decoder.frames.engine import Axis, CanPacket, Decoder, Packet, Settings, given_axes
from pdgw.tools.decoder.frames.records import BusKind, CyclicRecord, Record
from pdgw.tools.decoder.timeline.builder import HOLD_NS, Steps, TimelineBuilder
from pdgw.tools.decoder.timeline.clocks import ONE_CLOCK, Clocks, correlate
from pdgw.tools.decoder.timeline.entries import Edge, Entry
from pdgw.tools.recording.progress import with_progress
from pdgw.tools.recording.recorder import CONFIGURATION

if TYPE_CHECKING:
    from pdgw.tools.decoder.step_replay import Replayed

INFER_FROM = 20_000
"""Packets of a file that are searched for the telegrams."""
_CYCLES = 2000
"""Cycles whose length is measured."""
_AT_ONCE = 1 << 20
"""Bytes of a recording that are read in one piece."""
_AXIS_NODE = re.compile(r"(?:(\d{1,3})=)?(\d{1,3})")

Notify = Callable[[str], None]


@dataclass(frozen=True)
class Known:
    """Known facts; ``cycle_ns`` None: measured."""

    settings: Settings = field(default_factory=Settings)
    cycle_ns: int | None = None
    watchdog_factor: int = WATCHDOG_FACTOR
    age_limit_ns: int | None = None


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
        return _known_of(config, "", telegrams, nodes)
    if telegrams:
        return Known(Settings(_with_nodes(given_axes(telegrams), nodes), "--telegram and --node"))
    if nodes:
        raise GatewayError("--node: give --telegram for each axis too, or --config")
    for file in files:
        text = configuration_in(Path(file))
        if text:
            print_notice(f"the configuration of the gateway is read from {file}")
            return _known_of(Path(file), text, telegrams, nodes)
    for file in files:
        beside = Path(file).parent / CONFIGURATION
        if beside.is_file():
            print_notice(f"the configuration of the gateway is read from {beside}")
            return _known_of(beside, "", telegrams, nodes)
    return Known()


def _known_of(file: Path, text: str, telegrams: Sequence[int], nodes: Sequence[str]) -> Known:
    """From the configuration in a file; ``text``: that of a recording."""
    from pdgw.gateway.configuration.file import load_config, parse_config  # noqa: PLC0415 (loads the whole gateway)

    loaded = parse_config(text, f"{file}: its configuration") if text else load_config(file)
    settings = configured_settings(loaded, telegrams)
    transport = loaded.transport
    return Known(
        replace(settings, axes=_with_nodes(settings.axes, nodes)),
        int(transport.cycle_time_ms * MS),
        transport.watchdog_factor,
        transport.age_limit_ns,
    )


def _with_nodes(given: Sequence[Axis], nodes: Sequence[str]) -> list[Axis]:
    axes = list(given)
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
class Opening:
    """Result of the first pass through captures, enough to read them from the start in a second one."""

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

    def records(self) -> Iterator[Record | Steps]:
        """All packets of all files in the order of time, on the PLC's clock, and the steps of the gateway."""
        with ExitStack() as closing:
            sources = [closing.enter_context(open_source(file)) for file in self.files]
            parts: list[Iterator[Record | Steps]] = [*map(self._records, sources), *map(_steps, self.files)]
            merged = heapq.merge(*parts, key=_time)
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
    """Find axes, cycle and clocks; GatewayError for unusable captures. ``followed`` reports damage after the first packet.

    Of one file only the begin is read, several are read to their end: the offset of their clocks needs edges of both.
    """
    if STANDARD_INPUT in files:
        raise GatewayError("-: captures of both buses are read more than once; give files instead of standard input")
    assumed = []
    if not known.settings.axes:
        known = replace(known, settings=replace(known.settings, axes=_inferred(files, known, notify)))
        assumed.append("telegrams from the frame lengths; the axis number is the node-ID")
    if known.cycle_ns is None:
        assumed.append(f"a watchdog of {known.watchdog_factor} cycles of the PLC")
    edges: list[Edge] = []
    times: list[int] = []
    first: list[int] = []
    buses: dict[str, set[BusKind]] = {file: set() for file in files}
    for file in files:
        words = TimelineBuilder(known.settings.axes, cycle_ns=USUAL_CYCLE_MS * MS)
        with open_source(file) as source:
            packets = _until_damage(source.packets)
            if len(files) == 1:
                packets = islice(packets, INFER_FROM)
            for record in _decoded_from(packets, known.settings, notify):
                first = first or [record.time_ns]
                if isinstance(record, CyclicRecord | CanRecord):
                    buses[file].add(record.bus)
                if len(files) > 1:
                    edges += (entry for entry in words.add(record) if isinstance(entry, Edge))
                is_frame = isinstance(record, CyclicRecord) and (not times or record.direction is Direction.SETPOINT)
                if is_frame and len(times) < _CYCLES:
                    times.append(record.time_ns)
        edges += (entry for entry in words.finish() if isinstance(entry, Edge))
    seen = set[BusKind]().union(*buses.values())
    if not first:
        raise GatewayError(f"{', '.join(files)}: no packets")
    cycle_ns = known.cycle_ns or _median_ns(times)
    if offset_ns is not None:
        clocks = Clocks(offset_ns)
    elif len(files) == 1 or len(seen) < len(BusKind) or any(len(found) > 1 for found in buses.values()):
        clocks = Clocks(0, origin=ONE_CLOCK)
    else:
        clocks = correlate(edges, cycle_ns)
    shifted = frozenset(file for file, found in buses.items() if BusKind.PLC not in found)
    return Opening(tuple(files), known, clocks, cycle_ns, (times or first)[0], shifted, tuple(assumed))


def _median_ns(times: Sequence[int]) -> int:
    """The PLC's cycle: the median time between its frames, the usual one where there are none."""
    gaps = sorted(later - earlier for earlier, later in pairwise(times))
    return max(1, gaps[len(gaps) // 2]) if gaps else USUAL_CYCLE_MS * MS


@dataclass(frozen=True)
class Part:
    """A part of a timeline: times (both included) in nanoseconds of the PLC's clock, DO-IDs (none: all)."""

    begin_ns: int | None = None
    end_ns: int | None = None
    do_ids: frozenset[int] = frozenset()

    def has(self, item: Entry | Record) -> bool:
        """Whether an entry or a packet belongs to it. Packets and some entries are those of all drive objects."""
        do_id = 0 if isinstance(item, Record) else item.do_id
        return (
            (self.begin_ns is None or item.time_ns >= self.begin_ns)
            and (self.end_ns is None or item.time_ns <= self.end_ns)
            and (not self.do_ids or do_id in self.do_ids or not do_id)
        )


def followed(opening: Opening, part: Part = Part()) -> Iterator[Entry | Record]:
    """The timeline of a part with every packet of that time, in the order of time."""
    known = opening.known
    builder = TimelineBuilder(
        known.settings.axes,
        cycle_ns=opening.cycle_ns,
        watchdog_factor=known.watchdog_factor,
        uncertainty_ns=opening.clocks.uncertainty_ns,
    )
    has = None if part == Part() else part.has
    try:
        for record in opening.records():
            if part.end_ns is not None and record.time_ns > part.end_ns + HOLD_NS:
                break
            yield from builder.add(record) if has is None else filter(has, builder.add(record))
    except GatewayError:
        yield from filter(part.has, builder.release())
        raise
    yield from filter(part.has, builder.finish())


def write_page(opening: Opening, part: Part, path: Path) -> None:
    """The timeline of a part as an HTML page with its curves, to its damage; GatewayError when it cannot be written."""
    from pdgw.tools.decoder.export.trace_page import TracePage  # noqa: PLC0415 (for a page only)

    page = TracePage(" ".join(Path(file).name for file in opening.files), opening.begin_ns)
    try:
        for item in followed(opening, part):
            page.take(item)
    finally:
        page.write(path)


def replayed(files: Sequence[str]) -> list[Replayed]:
    """Replay recordings of the gateway that follow each other; ReplayError for others and for damaged ones."""
    from pdgw.tools.decoder.step_replay import replay  # noqa: PLC0415 (loads the axis machine)

    return replay(_items(files))


def _items(files: Sequence[str]) -> Iterator[Description | Frame | Cycle]:
    for file in files:
        parser = Parser(file)
        try:
            with open(file, "rb") as opened:
                stream = unpacked(opened, file)
                while data := stream.read1(_AT_ONCE):
                    yield from parser.feed(data)
            parser.end()
        except OSError as error:
            raise GatewayError(f"{file}: {unreadable(Path(file), error)}") from error


def _steps(file: str) -> Iterator[Steps]:
    """The steps in a recording of the gateway; none in another capture. Each comes after the frames of its cycle."""
    if not pcapng.has_steps(head_of(Path(file), _AT_ONCE)):
        return
    description, last_ns = None, 0
    for item in _items([file]):
        if isinstance(item, Cycle):
            assert description is not None
            yield Steps(max(last_ns, item.wall_ns), description, item)
        elif isinstance(item, Frame):
            last_ns = item.wall_ns
        else:
            description = item


def _inferred(files: Sequence[str], known: Known, notify: Notify) -> Sequence[Axis]:
    """The axes as the frames themselves show them, each with its number as node-ID; none where no frame has a telegram."""
    for file in files:
        with open_source(file) as source:
            decoder = Decoder(known.settings)
            for packet in islice(_until_damage(source.packets), INFER_FROM):
                decoder.decode(packet)
        if decoder.axes:
            for notice in decoder.notices:
                notify(notice)
            return [replace(axis, node=axis.node or axis.do_id) for axis in decoder.axes]
    return ()


def _until_damage(packets: Iterator[Packet | CanPacket]) -> Iterator[Packet | CanPacket]:
    """The packets before damage; CaptureError if there are none."""
    packet = None
    try:
        for packet in packets:
            yield packet
    except CaptureError:
        if packet is None:
            raise


def _decoded_from(packets: Iterable[Packet | CanPacket], settings: Settings, notify: Notify) -> Iterator[Record]:
    decoder = Decoder(settings)
    for packet in packets:
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
