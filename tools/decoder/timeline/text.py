"""A timeline as text: one line for each edge, reason and anomaly; a table at the end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pdgw.base.durations import MS, SECOND
from pdgw.tools.decoder.timeline.clocks import Clocks
from pdgw.tools.decoder.timeline.entries import Anomaly, Edge, Event, ReasonChange, Summary
from pdgw.tools.decoder.timeline.entries import Entry as TimelineEntry

_INDENT = " " * 24
_SERIES_NS = 10 * SECOND
"""Longest time between two equal events that are shown as one line with a count."""


def entry_lines(entry: TimelineEntry, zero_ns: int, *, verbose: bool = False) -> Iterator[str]:
    """The lines of one entry; none for a reason that is shown with its edge (unless ``verbose``)."""
    who = f"axis {entry.do_id}" if entry.do_id else "all"
    head = f"{(entry.time_ns - zero_ns) / SECOND:12.6f}  {who:<8}"
    if isinstance(entry, Edge):
        yield f"{head}{edge_text(entry)}"
        if entry.result:
            yield f"{_INDENT}-> {entry.result}"
    elif not isinstance(entry, ReasonChange):
        yield f"{head}{'!! ' if isinstance(entry, Anomaly) else ''}{entry.kind}: {entry.text}"
    elif verbose or not entry.settling:
        yield f"{head}-- {entry.text}"


class Repetitions:
    """Events and anomalies that repeat: the first is a line, the others are one line with their count."""

    def __init__(self, zero_ns: int) -> None:
        self._zero_ns = zero_ns
        self._series: dict[tuple[str, int, str], tuple[int, Event]] = {}
        """By repeated event: its number since its line, and the last one."""

    def ended(self, now: int | None = None) -> Iterator[str]:
        """The counts of the series that have ended by ``now``; None: all."""
        for key, (count, last) in list(self._series.items()):
            if now is None or now - last.time_ns > _SERIES_NS:
                del self._series[key]
                if count:
                    again = "once more" if count == 1 else f"{count} more times, the last"
                    (line,) = entry_lines(last, self._zero_ns)
                    yield f"{line} ({again})"

    def is_new(self, entry: TimelineEntry) -> bool:
        """Whether the entry has a line of its own; what repeats is counted."""
        if isinstance(entry, Edge | ReasonChange):
            return True
        key = entry.kind, entry.do_id, entry.text
        known = self._series.get(key)
        self._series[key] = (0 if known is None else known[0] + 1), entry
        return known is None


def edge_text(edge: Edge) -> str:
    """Word, values, bits, meaning, and the time since the cause."""
    raised, lowered = edge.bits
    parts = [f"{edge.name:<15} {edge.before:04X}h -> {edge.after:04X}h"]
    if edge.field.explain and (word := edge.field.explain(edge.after)):
        parts.append(f"[{word}]")
    parts += [f"+{name}" for name in raised] + [f"-{name}" for name in lowered]
    if edge.cause is not None and edge.latency_ns is not None:
        parts.append(f"({edge.latency_ns / MS:.3f} ms after {edge.cause.name})")
    return " ".join(parts)


def summary_lines(summary: Summary, clocks: Clocks, assumed: Sequence[str] = ()) -> Iterator[str]:
    """Clocks, assumptions, latencies of each hop, results of the PLC's edges, anomalies."""
    yield f"clocks: {clocks.text}"
    for text in assumed:
        yield f"assumed: {text}"
    if summary.latencies:
        yield f"{'latency, ms':<28}{'count':>7}{'p50':>10}{'p99':>10}{'max':>10}"
    for hop, latency in summary.latencies.items():
        values = "".join(f"{latency.rank(percent) / MS:>10.3f}" for percent in (50, 99, 100))
        yield f"{hop:<28}{latency.count:>7}{values}"
    if summary.ages.count:
        p50, p99, longest = (f"{summary.ages.rank(percent) / MS:.3f} ms" for percent in (50, 99, 100))
        limit = f", limit {summary.age_limit_ns / MS:g} ms" if summary.age_limit_ns else ""
        yield f"age of {summary.ages.count} frames of the PLC (round trip): p50 {p50}, p99 {p99}, max {longest}{limit}"
    for reason, count in summary.refusals.items():
        yield f"commands without effect: {reason.value}: {count}"
    if not summary.anomalies:
        yield "anomalies: none"
    for kind, count in summary.anomalies.items():
        yield f"anomalies: {kind.value}: {count}"
