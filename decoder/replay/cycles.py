"""The cycles of a recording: the PLC's cycle time, and when the gateway stepped, as far as the frames show it."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from pdgw.decoder.replay.recorded import Answer, AxisRecording
from pdgw.durations import MS
from pdgw.gateway.configuration.tables.defaults import USUAL_CYCLE_MS

SILENT_CYCLES: Final = 1.5
"""Cycles without a frame after which the gateway steps by itself, and a loss of the PLC is its silence."""
_MAX_FILLED: Final = 1000
"""Such steps in one silence; whatever was to happen has happened then."""


def median_cycle_ns(times: Sequence[int]) -> int:
    """The PLC's cycle: the median time between its frames, the usual one where there are none."""
    gaps = sorted(later - earlier for earlier, later in pairwise(times))
    return max(1, gaps[len(gaps) // 2]) if gaps else USUAL_CYCLE_MS * MS


class Tick(NamedTuple):
    """A step of the gateway; frames up to ``evaluated_ns`` were certainly taken before it.

    ``guessed``: nothing recorded shows it. A gateway that had not got the processor has not made it.
    """

    time_ns: int
    answer: Answer | None
    evaluated_ns: int
    guessed: bool = False


def ticks(recording: AxisRecording, cycle_ns: int) -> list[Tick]:
    """Times of the gateway's steps: one before each answer, and one by itself when no frame arrives for longer than a cycle.

    The time of a step is that of the frame it answers.
    """
    if recording.paced:
        moments = _paced(recording, cycle_ns)
    elif recording.in_order and recording.answers:
        moments = [Tick(answer.time_ns, answer, answer.time_ns) for answer in recording.answers]
    else:
        moments = _answering(recording, cycle_ns)
    return _filled(moments, cycle_ns)


def _answering(recording: AxisRecording, cycle_ns: int) -> list[Tick]:
    """The gateway answers each frame."""
    frames = recording.frames
    moments: list[Tick] = []
    taken = -1  # the newest frame that the gateway has certainly used
    before: int | None = None
    for answer in recording.answers:
        newest = bisect_right(frames, answer.time_ns) - 1
        if before is not None:
            idle = bisect_right(frames, before)
            if idle < len(frames) and frames[idle] - before >= cycle_ns // 2:
                taken = max(taken, idle - 1)  # all frames until then were answered
        silence = 0 <= taken < newest and frames[taken + 1] - frames[taken] > SILENT_CYCLES * cycle_ns
        now = answer.time_ns
        if taken < newest and not silence:
            # Compare up to the next frame. The answer may have waited for a busy PLC. The gateway may have sent all others
            # by itself.
            taken += 1
            now = frames[taken]
        moments.append(Tick(now, answer, frames[taken] if taken >= 0 else 0))
        before = answer.time_ns
    if not moments:
        moments = [Tick(now, None, now) for now in frames]
    return moments


def _paced(recording: AxisRecording, cycle_ns: int) -> list[Tick]:
    """The gateway steps with each frame and sends by itself: an answer shows the last step, or the one before when they cross."""
    moments: list[Tick] = []
    frames, answers = recording.frames, recording.answers
    at = 0
    for position, now in enumerate(frames):
        before = frames[position - 1] if position else 0
        until = frames[position + 1] if position + 1 < len(frames) else None
        first: Answer | None = None
        further: list[Tick] = []
        while at < len(answers) and (until is None or answers[at].time_ns < until):
            answer = answers[at]
            at += 1
            if answer.time_ns < now:
                continue
            late = answer.time_ns - now > SILENT_CYCLES * cycle_ns
            if first is None and not further and not late:
                first = answer
            else:
                further.append(Tick(answer.time_ns, answer, now if late else before))
        moments += [Tick(now, first, before), *further]
    return moments


def _filled(moments: Sequence[Tick], cycle_ns: int) -> list[Tick]:
    """With the steps the gateway makes by itself in a silence."""
    ticks: list[Tick] = []
    for tick in moments:
        filled = 0
        while ticks and filled < _MAX_FILLED and tick.time_ns - ticks[-1].time_ns > SILENT_CYCLES * cycle_ns:
            ticks.append(Tick(ticks[-1].time_ns + cycle_ns, None, ticks[-1].evaluated_ns, True))
            filled += 1
        now = max(tick.time_ns, ticks[-1].time_ns) if ticks else tick.time_ns
        ticks.append(tick._replace(time_ns=now))
    return ticks
