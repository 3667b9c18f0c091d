"""The offset of two clocks, found again within a cycle."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.durations import MS, SECOND
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.decoder.frames.fields import half_fields
from pdgw.tools.decoder.timeline.clocks import Clocks, correlate
from pdgw.tools.decoder.timeline.entries import Edge, WordKind
from pdgw.tools.recording.recordings import look_ahead
from tests.support.axis.recorded import CYCLE_NS, RIGS, RecordedRig


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
