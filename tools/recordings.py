"""Captures of both buses to one ``Recording``: what timeline and replay have in common.

Axes come from the configuration, from telegrams and nodes given by hand, or are inferred from the frames. Each file has a clock
of its own unless it holds both buses.
"""

from __future__ import annotations

import heapq
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

from pdgw.decoder.capture.axes import configured_axes
from pdgw.decoder.capture.dictionary import dictionary_of
from pdgw.decoder.capture.source import STANDARD_INPUT, open_source
from pdgw.decoder.clocks import Clocks, correlate
from pdgw.decoder.engine import Axis, Decoder, Settings, given_axes
from pdgw.decoder.recording import Collector, Recording
from pdgw.decoder.records import BusKind, CanRecord, CyclicRecord, Record
from pdgw.decoder.replay import AxisReplay, Replayer
from pdgw.gateway.config import load_config
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.translator.base import TranslatorSettings
from pdgw.gateway.translator.factory import DRIVE_TELEGRAM_NUMBERS

INFER_FROM = 20_000
"""Packets of a file that are looked at for the telegrams."""
TOLERANCE_NS = 50_000_000
"""So far recorded times may be off in a replay: a busy machine lets a recorder or the gateway's reader wait for some cycles."""
_MIN_TOLERANCE_CYCLES = 4
_AXIS_NODE = re.compile(r"(?:(\d{1,3})=)?(\d{1,3})")

Notify = Callable[[str], None]


@dataclass(frozen=True)
class Known:
    """What is known beforehand; ``cycle_ns`` and ``watchdog_factor`` None: measured.

    ``translators``: the user's choices by DO-ID.
    """

    settings: Settings = field(default_factory=Settings)
    translators: dict[int, TranslatorSettings] = field(default_factory=dict)
    cycle_ns: int | None = None
    watchdog_factor: int | None = None


def known_from(config: Path | None, telegrams: Sequence[int], nodes: Sequence[str]) -> Known:
    """From ``--config``, ``--telegram`` and ``--node`` ([AXIS=]NODE); GatewayError for what does not fit together."""
    if config is None:
        axes = _with_nodes(list(given_axes(telegrams)), nodes) if telegrams else []
        if nodes and not axes:
            raise GatewayError("--node: give --telegram for each axis too, or --config")
        return Known(Settings(axes, "--telegram and --node"))
    loaded = load_config(config)
    axes = _with_nodes(configured_axes(loaded, telegrams), nodes)
    files = {axis.node_id: axis.eds for axis in loaded.axis if axis.eds}
    settings = Settings(axes, dictionary=dictionary_of(files) if files else None)
    transport = loaded.transport
    return Known(
        replace(
            settings,
            cyclic_ports=settings.cyclic_ports | {transport.cyclic_port},
            acyclic_ports=settings.acyclic_ports | {transport.acyclic_port} - {0},
        ),
        {axis.do_id: axis.translator_settings for axis in loaded.axis},
        int(transport.cycle_time_ms * 1_000_000),
        transport.watchdog_factor,
    )


def _with_nodes(axes: list[Axis], nodes: Sequence[str]) -> list[Axis]:
    for position, text in enumerate(nodes):
        match = _AXIS_NODE.fullmatch(text)
        if match is None or not 1 <= int(match[2]) <= 127:
            raise GatewayError(f"--node {text}: expected NODE or AXIS=NODE, node-ID 1..127")
        do_id = int(match[1]) if match[1] else position + 1
        found = [i for i, axis in enumerate(axes) if axis.do_id == do_id]
        if not found:
            raise GatewayError(f"--node {text}: axis {do_id} is none of {', '.join(str(a.do_id) for a in axes)}")
        axes[found[0]] = replace(axes[found[0]], node=int(match[2]))
    return axes


@dataclass(frozen=True)
class Loaded:
    """Both captures on one clock."""

    recording: Recording
    clocks: Clocks
    known: Known
    files: tuple[str, ...]
    shifted: frozenset[str]
    """The files whose clock is not the PLC's."""

    def replay(self, *, tolerance_ns: int = TOLERANCE_NS, first_only: bool = False) -> list[AxisReplay]:
        """Today's translators on the recorded inputs of the drives; GatewayError where there is no drive."""
        drives = [axis for axis in self.recording.axes if axis.telegram.number in DRIVE_TELEGRAM_NUMBERS]
        if not drives:
            raise GatewayError(f"{', '.join(self.files)}: no drive telegram among the axes; encoders are not replayed")
        cycle_ns = self.recording.cycle_ns
        tolerance_ns = max(tolerance_ns, _MIN_TOLERANCE_CYCLES * cycle_ns) + self.clocks.uncertainty_ns
        replayers = [Replayer(axis, cycle_ns=cycle_ns, tolerance_ns=tolerance_ns) for axis in drives]
        return [replayer.run(first_only=first_only) for replayer in replayers]

    def records(self, notify: Notify) -> Iterator[Record]:
        """All packets of all files in the order of time, on the PLC's clock; the files are read once more."""
        parts = [self._records(file, notify) for file in self.files]
        return heapq.merge(*parts, key=lambda record: record.time_ns)

    def _records(self, file: str, notify: Notify) -> Iterator[Record]:
        offset_ns = self.clocks.offset_ns if file in self.shifted else 0
        for record in _decoded(file, self.known.settings, notify):
            record.time_ns -= offset_ns
            yield record


def load(files: Sequence[str], known: Known, offset_ns: int | None, notify: Notify) -> Loaded:
    """Read the captures and bring them on one clock; CaptureError for damaged ones, GatewayError for unusable ones."""
    if STANDARD_INPUT in files:
        raise GatewayError("-: captures of both buses are read more than once, give files")
    if not known.settings.axes:
        known = replace(known, settings=replace(known.settings, axes=_inferred(files, known, notify)))
    axes = known.settings.axes
    collector = Collector(axes, known.translators)
    buses: dict[str, set[BusKind]] = {}
    for file in files:
        buses[file] = set()
        for record in _decoded(file, known.settings, notify):
            collector.add(record)
            if isinstance(record, CyclicRecord | CanRecord):
                buses[file].add(record.bus)
    seen = set().union(*buses.values())
    for bus, what in ((BusKind.PLC, "cyclic frames"), (BusKind.CAN, "CAN frames")):
        if bus not in seen:
            raise GatewayError(f"{', '.join(files)}: no {what}, both buses are needed")
    cycle_ns = known.cycle_ns or collector.measured_cycle_ns
    watchdog_factor = known.watchdog_factor or collector.measured_watchdog_factor(cycle_ns)
    one_clock = any(len(found) > 1 for found in buses.values())
    if offset_ns is not None:
        clocks = Clocks(offset_ns)
    elif one_clock:
        clocks = Clocks(0, origin="one clock")
    else:
        clocks = correlate(collector.words(), {axis.do_id: axis.telegram for axis in axes}, cycle_ns)
    recording = collector.recording(clocks.offset_ns, cycle_ns=cycle_ns, watchdog_factor=watchdog_factor)
    shifted = frozenset(file for file, found in buses.items() if BusKind.PLC not in found)
    return Loaded(recording, clocks, known, tuple(files), shifted)


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
    raise GatewayError(f"{', '.join(files)}: the telegrams cannot be told from the frames, give --telegram or --config")


def _decoded(file: str, settings: Settings, notify: Notify) -> Iterator[Record]:
    decoder = Decoder(settings)
    with open_source(file) as source:
        for packet in source.packets:
            yield decoder.decode(packet)
            for notice in decoder.notices:
                notify(notice)
            decoder.notices.clear()


# -- the edges of the commands ------------------------------------------------------------------------------------------


def nanoseconds(seconds: float | None) -> int | None:
    """An option in seconds; None stays None. GatewayError for what is no time."""
    if seconds is None:
        return None
    try:
        return round(seconds * 1e9)
    except (ValueError, OverflowError):
        raise GatewayError(f"--offset {seconds}: expected a finite number of seconds") from None


def tell(notice: str) -> None:
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
