"""A repeated event is one line with a count in the timeline."""

from __future__ import annotations

from pdgw.durations import MS, SECOND
from pdgw.tools.decoder.timeline.entries import Anomaly, AnomalyKind, Event
from pdgw.tools.decoder.timeline.text import Repetitions, entry_lines


def written(entries: list[Anomaly | Event]) -> list[str]:
    repetitions, lines = Repetitions(0), list[str]()
    for entry in entries:
        lines += repetitions.ended(entry.time_ns)
        if repetitions.is_new(entry):
            lines += entry_lines(entry, 0)
    return [*lines, *repetitions.ended()]


def test_absent_node_is_two_lines_for_each_of_its_events() -> None:
    entries: list[Anomaly | Event] = []
    for number in range(89):
        entries.append(Event(number * 500 * MS, 7, "NMT", "reset node 7"))
        entries.append(Anomaly(number * 500 * MS + MS, 7, AnomalyKind.EMERGENCY, "node 7"))
    lines = written(entries)
    assert len(lines) == 4
    assert lines[0].endswith("NMT: reset node 7")
    assert lines[2].endswith("NMT: reset node 7 (88 more times, the last)")
    assert lines[2].split()[0] == "44.000000"


def test_repeated_series_has_its_own_line() -> None:
    entries: list[Anomaly | Event] = [Event(time * SECOND, 1, "state", "offline") for time in (0, 1, 30)]
    lines = [line.partition("state: ")[2] for line in written(entries)]
    assert lines == ["offline", "offline (once more)", "offline"]


def test_other_axes_and_other_texts_are_other_events() -> None:
    entries: list[Anomaly | Event] = [Event(number, number, "state", "offline") for number in (1, 2, 3)]
    assert len(written(entries)) == 3
