"""Plot a chapter from its capture: setpoints, actual values, states and the notes of the scenario."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.frame import IOPS_GOOD
from pdgw.profidrive.telegrams import Direction
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.export.trace_page import FAULT, OFF, OPERATION, States
from pdgw.tools.decoder.frames.engine import Decoder
from pdgw.tools.decoder.frames.records import ProcessData
from pdgw.tools.demo.chapters import Chapter, Curve, Panel
from pdgw.tools.recording.recordings import known_from

_SAMPLE_NS = 4 * MS
_STATE_S = 0.08
"""Shortest drawn fault, in seconds: one that is acknowledged at once stays visible."""
_COLOURS = {True: ("#f58518", "#b279a2"), False: ("#4c78a8", "#54a24b")}
"""Colours of setpoints (True) and of actual values (False)."""
_STATE_COLOURS = {OPERATION: ("#72b7b2", 0.16), FAULT: ("#e45756", 0.35)}
"""Colour and opacity of the background."""
_OF_EVERY_AXIS = "PLC"
"""Prefix of a note that belongs to all panels."""
_TEXT_BELOW = 0.62


@dataclass
class _Recorded:
    """The captured data of one axis: values with times in seconds, and the states."""

    newest: dict[str, int] = field(default_factory=dict)
    times: list[float] = field(default_factory=list)
    values: list[dict[str, int]] = field(default_factory=list)
    states: States = field(default_factory=States)
    sampled_ns: int = -_SAMPLE_NS

    def take(self, unit: ProcessData, now_ns: int) -> None:
        """Add an axis' part of a frame, unless its IOPS is BAD."""
        if unit.layout.direction is Direction.ACTUAL and not (unit.iops or 0) & IOPS_GOOD:
            return
        self.states.add("", now_ns / SECOND, unit)
        self.newest |= {item.name: int(raw) for item, raw in unit.items() if not isinstance(raw, bytes)}
        if unit.layout.direction is Direction.ACTUAL and now_ns - self.sampled_ns >= _SAMPLE_NS:
            self.sampled_ns = now_ns
            self.times.append(now_ns / SECOND)
            self.values.append(dict(self.newest))


def _recorded(capture: Path, config: Path, begin_s: float) -> Mapping[int, _Recorded]:
    """Read each axis of a capture by its place in the frame. Times count from ``begin_s`` (seconds of the epoch)."""
    decoder = Decoder(known_from(config, [], []).settings)
    begin_ns = round(begin_s * SECOND)
    found: dict[int, _Recorded] = defaultdict(_Recorded)
    with open_source(str(capture)) as source:
        for packet in source.packets:
            for unit in decoder.decode(packet).units:
                found[unit.axis].take(unit, packet.time_ns - begin_ns)
            decoder.notices.clear()
    return found


def plot(
    chapter: Chapter, capture: Path, config: Path, begin_s: float, notes: list[tuple[float, str]], picture: Path
) -> None:
    """Plot a chapter as PNG, where matplotlib is installed. ``begin_s``: start of its scenario.

    GatewayError when the picture cannot be written.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415

        mpl.use("Agg")  # without a screen
        from matplotlib import pyplot  # noqa: PLC0415
    except ImportError:
        return
    seen = _recorded(capture, config, begin_s)
    figure, places = pyplot.subplots(
        len(chapter.panels),
        1,
        figsize=(15, 1 + 3.3 * len(chapter.panels)),
        sharex=True,
        squeeze=False,
        constrained_layout=True,
    )
    for number, (place, panel) in enumerate(zip(places[:, 0], chapter.panels, strict=True)):
        _draw(place, panel, seen[panel.axis])
        # The texts are beside the first panel they belong to.
        first = panel.notes not in {other.notes for other in chapter.panels[:number]}
        _mark(place, _belonging(panel, notes), texts=first)
    places[-1, 0].set_xlabel("time in s")
    places[-1, 0].margins(x=0.01)
    figure.suptitle(f"PLC -> gateway -> CANopen: {chapter.about}", fontsize=13)
    try:
        figure.savefig(picture, format="png", dpi=90)
    except OSError as error:
        raise GatewayError(f"the picture {picture}: cannot be written ({error.strerror or error})") from error
    finally:
        pyplot.close(figure)


def _belonging(panel: Panel, notes: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """The notes of a panel, without their prefix."""
    begin = f"{panel.notes}: "
    return sorted((when, note.removeprefix(begin)) for when, note in notes if note.startswith((begin, _OF_EVERY_AXIS)))


def _shade(place: Any, spans: Sequence[tuple[float, float, str]]) -> None:
    """The states of an axis in the background of its curves, each at least ``_STATE_S`` long."""
    labels = {OPERATION, FAULT}
    for begin, end, state in spans:
        if state != OFF:
            colour, opacity = _STATE_COLOURS[state]
            label = state if state in labels else ""
            labels.discard(state)
            last = max(end, begin + _STATE_S)
            place.axvspan(begin, last, color=colour, alpha=opacity, lw=0, label=label)


def _draw(place: Any, panel: Panel, seen: _Recorded) -> None:
    drawn = {True: 0, False: 0}
    for curve in panel.curves:
        colours = _COLOURS[curve.setpoint]
        _draw_curve(place, curve, seen, colours[drawn[curve.setpoint] % len(colours)])
        drawn[curve.setpoint] += 1
    _shade(place, seen.states.spans.get("", ()))
    place.set_title(panel.title, loc="left", fontsize=11, fontweight="bold", pad=24)
    place.set_ylabel(panel.unit)
    place.grid(alpha=0.3)
    place.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), fontsize=8, frameon=False)


def _mark(place: Any, notes: list[tuple[float, str]], *, texts: bool) -> None:
    """Draw numbers above the panel and their texts beside it, so that no text covers a curve."""
    for number, (when, _) in enumerate(notes, 1):
        place.axvline(when, color="#555555", lw=0.8, ls=":")
        place.annotate(
            str(number),
            (when, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 3 + 7 * (number % 2)),
            textcoords="offset points",
            ha="center",
            fontsize=7,
            color="#222222",
        )
    if texts:
        lines = "\n".join(f"{number}  {text}" for number, (_, text) in enumerate(notes, 1))
        place.text(1.01, _TEXT_BELOW, lines, transform=place.transAxes, va="top", fontsize=7, color="#222222")


def _draw_curve(place: Any, curve: Curve, seen: _Recorded, colour: str) -> None:
    values = [curve.value(values) for values in seen.values]
    if curve.setpoint:
        place.step(seen.times, values, where="post", color=colour, lw=1.2, label=curve.label)
    else:
        place.plot(seen.times, values, color=colour, lw=1.6, label=curve.label)
