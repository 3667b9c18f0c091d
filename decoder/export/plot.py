"""The picture of a capture: chosen names over time, what belongs together in one panel, the states of the axes below."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from pdgw.decoder.frames.fields import Field
from pdgw.decoder.frames.records import ProcessData, ProcessDataLayout, Record
from pdgw.decoder.view.columns import Columns
from pdgw.decoder.view.names import Names
from pdgw.dsp402.states import STATE_OF_STATUS, State
from pdgw.durations import SECOND
from pdgw.extras import missing
from pdgw.gateway.axis.supervision.drive_events import FAULTY
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.signals import CATALOGUE

MAX_POINTS: Final = 1 << 19
_QUANTITIES: Final = {item.identifier: item.quantity.value for item in CATALOGUE if item.quantity is not None}
"""Setpoints and actual values of one quantity share a panel if they have one unit. Objects of a drive have
the names of telegram 100."""
_STATUS_NAMES: Final = ("statusword", "zsw1", "zsw2_enc")
_OPERATION, _FAULT, _OTHER = "operation", "fault", "off"
_COLOURS: Final = {_OPERATION: "#72b7b2", _FAULT: "#e45756", _OTHER: "#dddddd"}
_OPACITY: Final = {_OPERATION: 0.16, _FAULT: 0.35, _OTHER: 0.0}
"""Background of the curves."""

Units = tuple[ProcessData, ...] | None


class Curve:
    """Points of one curve; beyond ``most`` every second one is dropped, repeatedly."""

    def __init__(self, most: int = MAX_POINTS) -> None:
        self._most = most
        self.times = array("d")
        self.values = array("d")
        self._stride = 1
        self._skipped = 0

    def add(self, seconds: float, value: float) -> None:
        self._skipped += 1
        if self._skipped < self._stride:
            return
        self._skipped = 0
        self.times.append(seconds)
        self.values.append(value)
        if len(self.times) >= self._most:
            self.times, self.values = self.times[::2], self.values[::2]
            self._stride *= 2


class Panel:
    """Curves that share an axis: (title, whose) to points."""

    def __init__(self, heading: str, unit: str) -> None:
        self.heading = heading
        self.unit = unit
        self.curves: dict[tuple[str, str], Curve] = {}

    def add(self, title: str, whose: str, seconds: float, value: float) -> None:
        key = (title, whose)
        curve = self.curves.get(key)
        if curve is None:
            curve = self.curves[key] = Curve()
        curve.add(seconds, value)


def quantity_of(name: str) -> str:
    """The quantity of a setpoint or actual value with this identifier; empty for any other."""
    return _QUANTITIES.get(name, "")


def panels_of(titles: Sequence[str], names: Names) -> list[Panel]:
    """The panel of each title: set and actual values of one quantity and unit together, any other alone."""
    panels: dict[tuple[str, str], Panel] = {}
    found = []
    for title in titles:
        name, part = names.split(title)
        unit = names.unit(title)
        quantity = quantity_of(name) if not part else ""
        found.append(panels.setdefault((quantity or title, unit), Panel(quantity or title, unit)))
    return found


def _state_of(layout: ProcessDataLayout) -> Callable[[Sequence[Any]], str] | None:
    """A function that reads the state of an axis from a unit; None without a status word."""
    for name in _STATUS_NAMES:
        position = layout.positions.get(name)
        if position is not None:
            return _reader(layout.fields[position], position)
    return None


def _reader(field: Field, position: int) -> Callable[[Sequence[Any]], str]:
    if field.explain is not None:

        def of_statusword(values: Sequence[Any]) -> str:
            state = STATE_OF_STATUS[values[position] & 0x7F]
            return _FAULT if state in FAULTY else _OPERATION if state is State.OPERATION_ENABLED else _OTHER

        return of_statusword
    fault, operation = (bit.mask if (bit := field.bit(name)) else 0 for name in ("fault", "operation_enabled"))

    def of_word(values: Sequence[Any]) -> str:
        word = values[position]
        return _FAULT if word & fault else _OPERATION if word & operation else _OTHER

    return of_word


class States:
    """When an axis was in operation, in fault, or off: (begin, end, state) in seconds."""

    def __init__(self) -> None:
        self.spans: dict[str, list[tuple[float, float, str]]] = {}
        self._readers: dict[ProcessDataLayout, Callable[[Sequence[Any]], str] | None] = {}

    def add(self, whose: str, seconds: float, unit: ProcessData) -> None:
        layout = unit.layout
        if layout not in self._readers:
            self._readers[layout] = _state_of(layout)
        reader = self._readers[layout]
        if reader is None:
            return
        state = reader(unit.values)
        spans = self.spans.setdefault(whose, [])
        if spans and spans[-1][2] == state:
            spans[-1] = (spans[-1][0], seconds, state)
        else:
            if spans:
                spans[-1] = (spans[-1][0], seconds, spans[-1][2])
            spans.append((seconds, seconds, state))


def pyplot_for(what: str) -> Any:
    """matplotlib's pyplot, without a screen; GatewayError names the extra that ``what`` needs."""
    try:
        import matplotlib as mpl  # noqa: PLC0415

        mpl.use("Agg")
        from matplotlib import pyplot  # noqa: PLC0415
    except ImportError as error:
        raise GatewayError(missing("matplotlib", what)) from error
    return pyplot


def save(figure: Any, path: Path, what: str, *, dpi: int = 100) -> None:
    """Write a figure in the format of the file's ending, and close it; GatewayError says that ``what`` cannot be written."""
    try:
        # Without a file extension matplotlib would add one and write another file.
        figure.savefig(path, format=path.suffix[1:] or "png", dpi=dpi)
    except (OSError, ValueError) as error:  # ValueError: the file extension names an unknown picture format
        reason = getattr(error, "strerror", None) or error
        raise GatewayError(f"{what} {path}: cannot be written ({reason})") from error
    finally:
        pyplot_for(what).close(figure)


def shade(place: Any, spans: Sequence[tuple[float, float, str]], shortest_s: float = 0.0) -> None:
    """The states of an axis in the background of its curves, each at least ``shortest_s`` long."""
    labels = {_OPERATION, _FAULT}
    for begin, end, state in spans:
        if state != _OTHER:
            label = state if state in labels else ""
            labels.discard(state)
            last = max(end, begin + shortest_s)
            place.axvspan(begin, last, color=_COLOURS[state], alpha=_OPACITY[state], lw=0, label=label)


class PlotWriter:
    """Draws the chosen names; GatewayError when matplotlib is not installed.

    ``zero_ns``: the time the axis counts from, the first packet's unless set before.
    """

    def __init__(self, path: Path, titles: Sequence[str], names: Names) -> None:
        self._pyplot = pyplot_for("--plot")
        if not titles:
            raise GatewayError("--plot: name the signals to draw, like --signal NSOLL_A --signal NIST_A")
        self.zero_ns: int | None = None
        self._path = path
        self._titles = list(titles)
        self._columns = Columns(titles, names)
        self._panels = panels_of(titles, names)
        self._states = States()

    def take(self, record: Record, units: Units) -> None:
        zero = self.zero_ns
        if zero is None:
            zero = self.zero_ns = record.time_ns
        seconds = (record.time_ns - zero) / SECOND
        rows = self._columns.rows(record) if units is None else self._columns.unit_rows(record, units)
        for unit, row in rows:
            whose = _whose(unit)
            for panel, title, value in zip(self._panels, self._titles, row, strict=True):
                if isinstance(value, int | float):
                    panel.add(title, whose, seconds, value)
        for unit in record.units:
            self._states.add(_whose(unit), seconds, unit)

    def finish(self) -> None:
        panels = list(dict.fromkeys(self._panels))
        if not any(panel.curves for panel in panels):
            raise GatewayError(f"--plot {self._path}: nothing to draw: no chosen packet has {', '.join(self._titles)}")
        shown = {whose for panel in panels for _, whose in panel.curves}
        spans = {whose: found for whose, found in sorted(self._states.spans.items()) if whose in shown}
        heights = [2.4] * len(panels) + ([0.4 + 0.3 * len(spans)] if spans else [])
        figure, grid = self._pyplot.subplots(
            len(heights),
            1,
            figsize=(12, 1 + sum(heights)),
            sharex=True,
            squeeze=False,
            constrained_layout=True,
            height_ratios=heights,
        )
        for place, panel in zip(grid[:, 0], panels, strict=False):
            _draw(place, panel)
            # Draw the states of a single axis under its curves; those of several axes would overlap.
            shade(place, next(iter(spans.values())) if len(spans) == 1 else ())
        if spans:
            _draw_states(grid[-1, 0], spans)
        grid[-1, 0].set_xlabel("time in s")
        save(figure, self._path, "--plot")


def _draw(place: Any, panel: Panel) -> None:
    alone = len({title for title, _ in panel.curves}) <= 1
    for (title, whose), curve in sorted(panel.curves.items()):
        label = whose if alone else f"{title}, {whose}"
        place.step(curve.times, curve.values, where="post", label=label, lw=1.2)
    titles = list(dict.fromkeys(title for title, _ in panel.curves))
    place.set_title(", ".join(titles) or panel.heading, loc="left", fontsize=10, fontweight="bold")
    if panel.unit:
        place.set_ylabel(panel.unit)
    place.grid(alpha=0.3)
    if panel.curves:
        place.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
    else:
        place.text(0.5, 0.5, "not in the capture", ha="center", va="center", transform=place.transAxes)


def _draw_states(place: Any, spans: dict[str, list[tuple[float, float, str]]]) -> None:
    for row, found in enumerate(spans.values()):
        for state, colour in _COLOURS.items():
            bars = [(begin, end - begin) for begin, end, kind in found if kind == state]
            place.broken_barh(bars, (row - 0.4, 0.8), color=colour, label=state if not row else None)
    place.set_yticks(range(len(spans)), list(spans), fontsize=8)
    place.set_title("states", loc="left", fontsize=10, fontweight="bold")
    place.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)


def _whose(unit: ProcessData | None) -> str:
    if unit is None:
        return "packets"
    if unit.layout.direction is None:
        return f"axis {unit.axis} (CAN)" if unit.axis else f"node {unit.node}"
    return f"axis {unit.axis}"
