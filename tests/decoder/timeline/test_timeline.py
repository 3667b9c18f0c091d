"""Timelines of small recordings: causes, latencies, repeated events, the offset of two clocks, and the reviewed one.

``python -m tests.decoder.timeline.test_timeline`` writes the golden file again. Read the difference before you commit it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.profidrive.frame import TICK, TRAILER
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.decoder.frames.fields import half_fields
from pdgw.tools.decoder.timeline.clocks import Clocks, correlate
from pdgw.tools.decoder.timeline.entries import Anomaly, AnomalyKind, Edge, Event, Latency, Summary, WordKind
from pdgw.tools.decoder.timeline.text import Repetitions, entry_lines, summary_lines
from pdgw.tools.recording.recordings import Part, followed, look_ahead
from tests.support.axis.recorded import CYCLE_NS, RIGS, RecordedRig, speed
from tests.support.readers.timeline import Timeline, edges, entries_of, timeline

GOLDEN = Path(__file__).parents[1] / "golden" / "timeline.txt"


# -- causes and latencies ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("clock_ns", [0, 7_000_000_000])
def test_an_edge_is_followed_over_both_buses(clock_ns: int, tmp_path: Path) -> None:
    found = timeline(speed(), tmp_path, clock_ns=clock_ns)
    on = next(edge for edge in edges(found, WordKind.CONTROL) if edge.after == 0x047F)
    begin = on.time_ns - (MS if clock_ns else 0)
    chain = [edge for edge in found.entries if isinstance(edge, Edge) and begin <= edge.time_ns][:7]
    shown = [(edge.kind, edge.after & 0x6F, edge.cause.kind if edge.cause else None) for edge in chain]
    expected = [
        (WordKind.CONTROL, 0x6F, None),
        (WordKind.CONTROLWORD, 0x07, WordKind.CONTROL),
        (WordKind.STATUSWORD, 0x23, WordKind.CONTROLWORD),
        (WordKind.CONTROLWORD, 0x0F, WordKind.STATUSWORD),
        (WordKind.STATUS, 0x23, WordKind.STATUSWORD),
        (WordKind.STATUSWORD, 0x27, WordKind.CONTROLWORD),
        (WordKind.STATUS, 0x27, WordKind.STATUSWORD),
    ]
    if clock_ns:  # edges of different buses may change places within the uncertainty
        assert {item[:2] for item in shown} == {item[:2] for item in expected}
        return
    assert shown == expected
    assert not on.result
    latencies = [edge.latency_ns for edge in chain if edge is not on]
    assert all(latency is not None and 0 < latency < 3 * CYCLE_NS for latency in latencies)
    assert latencies[:3] == [100_000, 500_000, 3_500_000]


def test_latencies_are_shown_for_each_hop(tmp_path: Path) -> None:
    found = timeline(speed(), tmp_path).summary.latencies
    assert found["STW1 -> Controlword"].rank(50) == 100_000
    assert found["Controlword -> Statusword"].rank(100) < CYCLE_NS
    assert found["Statusword -> ZSW1"].count >= 5
    assert found["STW1 -> ZSW1"].rank(50) == 300_000  # the ramp stop is the gateway's own
    assert found["STW1 -> ... -> ZSW1"].rank(100) < 3 * CYCLE_NS


def test_percentiles_are_those_of_the_nearest_rank() -> None:
    latency = Latency()
    latency.add(7_000)
    assert latency.document() == {"count": 1, "p50_ns": 7_000, "p99_ns": 7_000, "max_ns": 7_000}
    for value in (item * 1_000 for item in range(1, 201) if item != 7):
        latency.add(value)
    assert (latency.count, latency.rank(50), latency.rank(99), latency.rank(100)) == (200, 100_000, 198_000, 200_000)


def test_latencies_are_rounded_to_a_microsecond() -> None:
    latency = Latency()
    for value in range(1_000_000, 1_001_000):
        latency.add(value)
    assert (latency.count, latency.rank(50), latency.rank(100)) == (1000, 1_000_000, 1_001_000)


@pytest.mark.parametrize(("limit_ns", "more"), [(24 * MS, ", limit 24 ms"), (None, "")])
def test_the_age_of_frames_is_shown_with_its_limit(limit_ns: int | None, more: str, tmp_path: Path) -> None:
    rig = speed()
    place = slice(-TICK.size - TRAILER.size, -TRAILER.size)
    now, frame = rig.frames.plc[30]
    _, older = rig.frames.plc[28]
    rig.frames.plc[30] = now, frame[: place.start] + older[place] + frame[place.stop :]
    opening = rig.open(tmp_path)
    summary = Summary(limit_ns)
    for item in followed(opening):
        summary.add(item)
    count = len(rig.frames.plc) - 1
    text = f"age of {count} frames of the PLC (round trip): p50 3.700 ms, p99 3.700 ms, max 11.700 ms{more}"
    assert text in list(summary_lines(summary, opening.clocks))
    assert summary.document()["age"]["limit_ns"] == limit_ns
    assert summary.document()["age"]["max_ns"] == 11_700_000


def test_an_ordinary_run_has_no_anomalies(tmp_path: Path) -> None:
    for rig in RIGS.values():
        assert not timeline(rig(), tmp_path).summary.anomalies


def test_a_part_of_the_timeline_has_its_own_summary(tmp_path: Path) -> None:
    whole = timeline(speed(), tmp_path)
    on = next(edge for edge in edges(whole, WordKind.CONTROL) if edge.after == 0x047F)
    chosen = Part(on.time_ns, on.time_ns + 10 * MS)
    part = Timeline(whole.opening, entries_of(whole.opening, chosen))
    assert all(on.time_ns <= entry.time_ns <= on.time_ns + 10 * MS for entry in part.entries)
    assert part.summary.latencies["STW1 -> Controlword"].count == 1
    assert all(item.do_id == 0 for item in entries_of(whole.opening, Part(do_ids=frozenset({2}))))


# -- golden -----------------------------------------------------------------------------------------------------------


def golden_lines() -> Iterator[str]:
    """ON without OFF, a start, a task, an intermediate stop, a drive that faults, a silence of the PLC."""
    rig = RecordedRig(9)
    rig.stw(0x043F)
    rig.enable()
    rig.values |= {"SATZANW": 0x8000, "MDI_TARPOS": 0x10000000, "MDI_VELOCITY": 0x40000000, "MDI_MOD": 1}
    rig.values |= {"MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
    rig.stw(0x047F, 40)
    rig.stw(0x045F, 40)
    rig.stw(0x047F, 30)
    rig.node.model.inject(7)
    rig.step(40)
    rig.step(6, plc=False)
    rig.stw(0x043E)
    with tempfile.TemporaryDirectory() as folder:
        found = timeline(rig, Path(folder), clock_ns=1_500_000_000)
    for entry in found.entries:
        yield from entry_lines(entry, found.opening.begin_ns)
    yield from summary_lines(found.summary, found.opening.clocks, found.opening.assumed)


def test_timeline_equals_the_reviewed_text() -> None:
    assert list(golden_lines()) == GOLDEN.read_text().splitlines()


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


@pytest.fixture(scope="module", params=RIGS)
def rig(request: pytest.FixtureRequest) -> RecordedRig:
    return RIGS[request.param]()


@pytest.mark.parametrize("offset_ns", [-3600 * SECOND, -250 * MS, 37 * MS, 12 * SECOND + 345_678])
def test_the_offset_is_found_within_a_cycle(rig: RecordedRig, offset_ns: int, tmp_path: Path) -> None:
    clocks = rig.open(tmp_path, clock_ns=offset_ns, jitter_ns=MS).clocks
    assert clocks.origin == "correlated"
    assert abs(clocks.offset_ns - offset_ns) < CYCLE_NS
    assert clocks.pairs >= 4
    assert not clocks.ambiguous
    assert f"{clocks.pairs} of {clocks.edges} edges match" in clocks.text


def test_one_clock_is_taken_as_one_clock(rig: RecordedRig, tmp_path: Path) -> None:
    clocks = rig.open(tmp_path).clocks
    assert clocks.offset_ns == 0
    assert clocks.text.startswith("the clocks match: ")


def test_an_offset_that_is_given_is_taken(tmp_path: Path) -> None:
    rig = RIGS["telegram 1"]()
    clocks = look_ahead(rig.frames.write(tmp_path, offset_ns=5 * SECOND), rig.known, 5 * SECOND, lambda _: None).clocks
    assert clocks == Clocks(5 * SECOND)
    assert clocks.text == "the CAN clock differs by +5.000000 s from the clock of the PLC's frames, as given"


WORD = half_fields(telegram(1).setpoints)[0]


def toggling(kind: WordKind, times: list[int], bit: int = 1) -> list[Edge]:
    """A word whose bit changes at these times."""
    return [Edge(now, 1, kind, WORD, bit * (i % 2), bit * (1 - i % 2)) for i, now in enumerate(times)]


def test_without_edges_in_common_the_offset_is_not_known() -> None:
    clocks = correlate(toggling(WordKind.CONTROL, [5]), CYCLE_NS)
    assert (clocks.offset_ns, clocks.origin) == (0, "not known")
    assert "unknown" in clocks.text


def test_edges_of_one_direction_leave_the_delay_in_the_offset() -> None:
    times = [100 * MS, 450 * MS, 1100 * MS, 1900 * MS]
    late = toggling(WordKind.CONTROLWORD, [now + SECOND + MS for now in times])
    clocks = correlate([*toggling(WordKind.CONTROL, times), *late], CYCLE_NS)
    assert clocks.offset_ns == SECOND + MS
    assert clocks.uncertainty_ns == CYCLE_NS
    assert (clocks.pairs, clocks.edges) == (4, 4)


def test_regular_rhythm_is_reported_as_ambiguous() -> None:
    times = [100 * MS * i for i in range(1, 41)]
    late = toggling(WordKind.CONTROLWORD, [now + SECOND for now in times])
    clocks = correlate([*toggling(WordKind.CONTROL, times), *late], CYCLE_NS)
    assert clocks.ambiguous
    assert "AMBIGUOUS" in clocks.text


def test_commands_without_effect_do_not_disturb_the_offset() -> None:
    times = [100 * MS, 450 * MS, 1100 * MS, 1900 * MS, 2050 * MS, 3000 * MS]
    passed = times[:4]
    edges = [
        *toggling(WordKind.CONTROL, times),
        *toggling(WordKind.CONTROLWORD, [now - SECOND + MS for now in passed]),
        *toggling(WordKind.STATUSWORD, [now - SECOND + 2 * MS for now in passed], 2),
        *toggling(WordKind.STATUS, [now + 5 * MS for now in passed], 2),
    ]
    clocks = correlate(edges, CYCLE_NS)
    assert abs(clocks.offset_ns + SECOND) <= clocks.uncertainty_ns <= CYCLE_NS
    assert (clocks.pairs, clocks.edges) == (8, 10)


if __name__ == "__main__":
    GOLDEN.write_text("\n".join(golden_lines()) + "\n")
