"""Replay: recorded inputs of one axis through the axis machine of this version, in recorded time, compared with the recorded
outputs.

Without I/O; ``decoder.replay.recording`` makes the inputs from captures. The PLC's frames pass the link's endpoint, the
drive's values are those of its TPDOs, and the recorded answers give the times of the gateway's steps.

A recorder does not show which TPDO a step used, nor the exact time of the step. So the question is: for each step, do inputs
within ``tolerance_ns`` of its recorded time exist with which the axis machine gives exactly the recorded actual values, and
each RPDO exactly the recorded payloads in their order? Inputs are used in their order, none omitted for longer than the
tolerance; of the PLC's frames the newest, or an earlier one while frames and answers cross. Repetitions of a payload (refresh)
do not count. If a step cannot be explained, the search goes back as far as the tolerance; if that fails, this step is the
difference.

Whether a drive is online is an input (IOPS of the answers), as are references (SDO), the results of SDO writes and latched
values of the touch probe. If a silence of the PLC is as long as the watchdog within the tolerance, IOCS shows whether the
gateway saw a loss. The state of the machine before the recording is unknown: the comparison starts when the drive is
configured in the recording, or with an OFF while the power stage is off; the same applies after a difference.

Not here: a telegram changed in operation (P922), the words of an external encoder, the numbers of the fault buffer.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Final, NamedTuple

from pdgw.decoder.replay.cycles import Tick, ticks
from pdgw.decoder.replay.recorded import UNKNOWN_TORQUE, Answer, AxisRecording
from pdgw.decoder.replay.recorded_drive import asks_for_off, recall
from pdgw.decoder.replay.result import AxisReplay, Difference, Step
from pdgw.decoder.replay.rpdos import Place, RpdoComparison
from pdgw.decoder.replay.touch_probe import Found, find_answer
from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive.images import FEEDBACK_NAMES, DriveFeedback
from pdgw.dsp402.objects import DRIVE_OBJECTS, MAX_TORQUE
from pdgw.durations import SECOND
from pdgw.gateway.axis.checkpoint import Checkpoint, Checkpoints
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.values import FaultRecord, ProbeWish, SdoAnswer, SdoWrite
from pdgw.profidrive.telegrams import ApplicationMode

MAX_DIFFERENCES: Final = 20
"""Maximum number of differences of an axis."""
BUDGET: Final = 10_000
"""Choices that are tried for one step that does not fit."""
_LONGEST_STALL_NS: Final = SECOND

_NO_FEEDBACK: Final = {name: getattr(DriveFeedback(), name) for name in FEEDBACK_NAMES}


@dataclass(slots=True)
class _State:
    """A hypothesis about the gateway at one moment, beside its machine."""

    image: dict[str, int] = field(default_factory=lambda: dict(_NO_FEEDBACK))
    """The values of a ``DriveFeedback``."""
    setpoints: int = 0
    feedback: int = 0
    configured: int = 0
    online: bool = False
    asked: tuple[SdoWrite, ...] | None = None
    done_at: int | None = None
    done_error: str | None = None
    sdo: int = 0
    probe: ProbeWish | None = None
    probe_found: Found | None = None
    probes: int = 0
    """Transfers of the touch probe that were used."""
    sent: Place = field(default_factory=Place)
    frames: int = 0
    """Frames of the PLC up to this moment."""
    known: bool = False

    def copy(self) -> _State:
        return replace(self, image=dict(self.image), sent=self.sent.copy())


class _Inputs(NamedTuple):
    """One choice for a step: number of used events, offset of the clock, and whether the step was made at all."""

    setpoints: int
    feedback: int
    shift_ns: int
    made: bool = True


class _Choice:
    """A step with the state before it and the choices not tried yet."""

    def __init__(self, checkpoint: Checkpoint, state: _State, inputs: Iterator[_Inputs]) -> None:
        self.checkpoint = checkpoint
        self.state = state
        self.inputs = inputs
        self.tried = 0
        self.best: Difference | None = None
        """The tried inputs with the smallest difference."""


class Replayer:
    """Replays one axis. ``tolerance_ns``: how far recorded times may be off, with the uncertainty of the clocks."""

    def __init__(self, recording: AxisRecording, *, cycle_ns: int, tolerance_ns: int) -> None:
        self._recording = recording
        self._cycle_ns = cycle_ns
        self._tolerance = self._sent_tolerance = tolerance_ns
        if recording.in_order:
            # A step without an answer may have been delayed by the longest pause of the gateway.
            times = [answer.time_ns for answer in recording.answers]
            longest = max((later - earlier for earlier, later in pairwise(times)), default=0)
            limit = max(_LONGEST_STALL_NS, recording.watchdog_ns)  # a pause up to this time may be a loss
            self._sent_tolerance = max(tolerance_ns, min(longest, limit))
        settings = recording.settings
        if not settings.cycle_ns:  # DSC calculates its setpoints for each cycle
            settings = replace(settings, cycle_ns=cycle_ns)
        self._machine = AxisMachine(recording.telegram.number, settings, DriveFeedback())
        self._checkpoints = Checkpoints(self._machine)
        self._rpdos = recording.rpdos
        self._not_compared = recording.not_computed
        self._setpoint_times, self._certain_times = _times(recording)
        self._feedback_times = [event.time_ns for event in recording.feedback]
        self._state = _State()
        self._ticks = ticks(recording, cycle_ns)
        last_ns = self._ticks[-1].time_ns if self._ticks else 0
        self._comparison = RpdoComparison(
            recording, cycle_ns=cycle_ns, tolerance_ns=self._sent_tolerance, last_ns=last_ns
        )
        # A payload counts as missing after the tolerance; its cause may be this time earlier.
        self._depth = 2 * -(-self._sent_tolerance // cycle_ns) + 4
        self._visited: set[Hashable] = set()
        cycles = (cycle_ns, 2 * cycle_ns, tolerance_ns)
        self._shifts = (0, *(sign * shift for shift in cycles for sign in (1, -1)))
        self._uncertain_gaps = [
            (last, following)
            for last, following in pairwise(recording.frames)
            if abs(following - last - recording.watchdog_ns) <= self._sent_tolerance
        ]

    def run(self, *, first_only: bool = False) -> AxisReplay:
        """Replay everything; with ``first_only`` up to the first difference."""
        outcome = AxisReplay(self._recording)
        steps = outcome.steps
        choices: deque[_Choice] = deque(maxlen=self._depth)
        unchecked = 0  # steps up to here are not checked: they belong to a difference
        failed_at = -1
        failure: Difference | None = None
        budget = BUDGET
        while len(steps) < len(self._ticks):
            choice = self._choice(self._ticks[len(steps)])
            while not self._advance(choice, steps, check=len(steps) >= unchecked, searching=len(steps) <= failed_at):
                if len(steps) > failed_at:
                    failed_at, failure = len(steps), choice.best
                    budget = BUDGET
                    self._visited.clear()
                budget -= choice.tried
                choice.tried = 0
                if not choices or budget <= 0:
                    break
                choice = choices.pop()
                steps.pop()
            else:
                choices.append(choice)
                continue
            if failure is not None:
                outcome.differences.append(failure)
            if first_only:
                return outcome
            # No input fits: continue with the likeliest inputs, and compare again once the state is known again.
            self._restore(choice)
            self._state.known = False
            choices.clear()
            unchecked = failed_at + 1 if len(outcome.differences) < MAX_DIFFERENCES else len(self._ticks)
        return outcome

    # -- one step -----------------------------------------------------------------------------------------------------

    def _choice(self, tick: Tick) -> _Choice:
        return _Choice(self._checkpoints.save(), self._state, self._inputs(tick, self._state))

    def _restore(self, choice: _Choice) -> None:
        self._checkpoints.restore(choice.checkpoint)
        self._state = choice.state.copy()

    def _seen(self, position: int) -> bool:
        """Whether the search was at this step in this state before: it would end alike."""
        state = self._state
        key = (
            position,
            state.setpoints,
            state.feedback,
            state.configured,
            state.sdo,
            state.done_at,
            state.probes,
            state.sent.span,
            tuple(sorted(state.sent.cursors.items())),
            self._checkpoints.fingerprint(),
        )
        if key in self._visited:
            return True
        self._visited.add(key)
        return False

    def _advance(self, choice: _Choice, steps: list[Step], *, check: bool, searching: bool) -> bool:
        """Take the next choice that fits the recording; False when none is left."""
        tick = self._ticks[len(steps)]
        for inputs in choice.inputs:
            self._restore(choice)
            choice.tried += 1
            step, difference = self._step(tick, inputs, check=check)
            if difference is None:
                if check and searching and self._seen(len(steps)):
                    continue
                steps.append(step)
                return True
            if choice.best is None or len(difference.names) < len(choice.best.names):
                choice.best = difference
        return False

    def _inputs(self, tick: Tick, state: _State) -> Iterator[_Inputs]:
        now, recording = tick.time_ns, self._recording
        exact = recording.in_order and not recording.paced and tick.answer is not None
        tolerance = 0 if exact else self._tolerance
        latest = now + self._cycle_ns if tick.answer is None else tick.answer.time_ns
        certain = bisect_right(self._certain_times, tick.evaluated_ns)
        setpoints = _near(self._setpoint_times, now, certain, latest, state.setpoints)
        certain = bisect_right(self._feedback_times, now - tolerance)
        feedback = _near(self._feedback_times, now, certain, now + tolerance, state.feedback)
        for shift in self._shifts:
            for taken in setpoints:
                for received in feedback:
                    yield _Inputs(taken, received, shift)
            if tick.guessed and recording.in_order and not shift:
                yield _Inputs(state.setpoints, state.feedback, 0, made=False)

    def _step(self, tick: Tick, inputs: _Inputs, *, check: bool) -> tuple[Step, Difference | None]:
        state, machine, recording = self._state, self._machine, self._recording
        given, outputs = machine.inputs, machine.outputs
        if not inputs.made:
            return self._step_result(tick, inputs, (), compared=False), None
        now = tick.time_ns + inputs.shift_ns
        for event in recording.feedback[state.feedback : inputs.feedback]:
            state.image.update(event.values)
        newest = recording.setpoints[inputs.setpoints - 1] if inputs.setpoints else None
        values = None if newest is None else newest.values
        stops = given.gateway_stops = newest is not None and newest.gateway_stops
        if stops and inputs.setpoints == state.setpoints:
            values = None  # a gateway that stops uses each frame once
        state.setpoints, state.feedback = inputs.setpoints, inputs.feedback
        came_online = not state.online
        state.online = self._online(tick, state.online)
        if (
            not stops
            and tick.answer is not None
            and tick.answer.plc_ok is (values is None)
            and self._is_uncertain_loss(tick)
        ):
            values = recording.setpoints[inputs.setpoints - 2].values if tick.answer.plc_ok else None
        plc_ok = values is not None and not stops
        compare = check and state.known
        if state.online:
            # Its IOPS become BAD when the gateway has released the drive, shortly before or after the NMT command.
            self._configure(tick.time_ns + (self._tolerance if came_online else 0))
        for attribute, value in state.image.items():
            setattr(given.feedback, attribute, value)
        given.now, given.setpoints, given.drive_ok = now, values, state.online
        before, state.frames = state.frames, bisect_right(recording.frames, now)
        given.fresh = state.frames > before and not stops
        self._answer_sdo(now)
        self._answer_probe(now)
        self._checkpoints.step()
        actuals = tuple(outputs.actuals)
        difference = None
        if compare:
            difference = self._compare_answer(tick, actuals, plc_ok) or self._comparison.compare(
                state.sent, tick.time_ns, outputs.command, online=state.online
            )
        else:
            self._comparison.follow(state.sent, tick.time_ns)
        written_wrong = self._find_sdo(now)
        difference = difference or written_wrong
        self._find_probe(now)
        step = self._step_result(tick, inputs, tuple(outputs.faults), compared=compare)
        if values is not None and not stops:
            self._recognise(values, tick)
        return step, difference if compare else None

    def _step_result(self, tick: Tick, inputs: _Inputs, faults: tuple[FaultRecord, ...], *, compared: bool) -> Step:
        outputs = self._machine.outputs
        return Step(
            tick.time_ns,
            tick.answer,
            inputs.setpoints,
            inputs.feedback,
            outputs.command.controlword,
            tuple(outputs.actuals),
            outputs.reason,
            faults,
            compared,
        )

    def _online(self, tick: Tick, before: bool) -> bool:
        if tick.answer is not None:
            return tick.answer.drive_ok
        if self._recording.answers:
            return before
        position = bisect_right(self._recording.online, (tick.time_ns, True))
        return position > 0 and self._recording.online[position - 1][1]

    def _is_uncertain_loss(self, tick: Tick) -> bool:
        """Whether a silence of the PLC was about as long as the watchdog: then IOCS says if the gateway saw a loss."""
        position = bisect_right(self._uncertain_gaps, (tick.time_ns + self._sent_tolerance,)) - 1
        return position >= 0 and tick.time_ns <= self._uncertain_gaps[position][1] + self._sent_tolerance

    def _configure(self, until: int) -> None:
        """References and restarts of the drive that the gateway has learned until a time."""
        state = self._state
        events = self._recording.configured
        while state.configured < len(events) and events[state.configured].time_ns <= until:
            configured = events[state.configured].configured
            state.configured += 1
            state.known |= configured.restarted
            self._machine.inputs.news.append(configured)

    def _recognise(self, values: Sequence[int], tick: Tick) -> None:
        """With an OFF while the drive is not powered, the machine's state follows from the recording."""
        word, state = values[0], self._state
        if state.known:
            return
        transparent = self._recording.telegram.setpoints.mode is ApplicationMode.TRANSPARENT
        if not state.online or not asks_for_off(word, state.image["statusword"], transparent=transparent):
            return
        state.known = True
        recall(self._machine, self._in_force(tick.time_ns), None if tick.answer is None else tick.answer.actuals[0])

    def _in_force(self, now: int) -> Iterator[tuple[Pdo, bytes]]:
        """The newest payload of each RPDO."""
        for pdo in self._rpdos:
            sent = self._recording.sent[pdo.number]
            count = bisect_right(sent, (now,))
            if count and len(sent[count - 1].data) == pdo.size:
                yield pdo, sent[count - 1].data

    def _compare_answer(self, tick: Tick, actuals: tuple[int, ...], plc_ok: bool) -> Difference | None:
        answer = tick.answer
        if answer is None:
            return None
        if self._not_compared:
            recorded_values = answer.actuals
            actuals = tuple(recorded_values[i] if i in self._not_compared else value for i, value in enumerate(actuals))
        agrees = answer.plc_ok is None or answer.plc_ok == plc_ok
        if agrees and answer.actuals == actuals:
            return None
        half = self._recording.telegram.actuals
        recorded, today = half.as_dict(answer.actuals), half.as_dict(actuals)
        if not agrees:
            recorded, today = {**recorded, "IOCS": bool(answer.plc_ok)}, {**today, "IOCS": plc_ok}
        return Difference(answer.time_ns, self._recording.do_id, "actual values", recorded, today)

    # -- SDO ----------------------------------------------------------------------------------------------------------

    def _answer_sdo(self, now: int) -> None:
        """The machine's SDO writes were answered when the recorded ones were: the step after that has the answer."""
        state, request = self._state, self._machine.outputs.writes
        if request is not None and state.asked == request and state.done_at is not None and state.done_at <= now:
            state.asked = None  # a request after the answer is a new one
            self._machine.inputs.news.append(SdoAnswer(request, state.done_error))

    def _find_sdo(self, now: int) -> Difference | None:
        """When the writes of the machine since this step were answered, or which other value was written."""
        state, request = self._state, self._machine.outputs.writes
        wrong = None
        if request is not None and state.asked != request:
            state.done_at, state.done_error, wrong = self._find_writes(request, now)
        state.asked = request
        return wrong

    def _answer_probe(self, now: int) -> None:
        """Answer the machine's request in the step after the gateway has read the position from the drive."""
        state, found = self._state, self._state.probe_found
        if found is not None and found.time_ns <= now:
            state.probes, state.probe_found = found.used, None
            self._machine.inputs.news.append(found.answer)

    def _find_probe(self, now: int) -> None:
        """Find the recorded transfers for the machine's requests since this step."""
        state, wish = self._state, self._machine.outputs.probe
        if wish is not state.probe:
            state.probe = wish
            begin = now - self._tolerance
            transfers = self._recording.probe
            state.probe_found = None if wish is None else find_answer(wish, transfers, state.probes, begin)

    def _find_writes(self, request: Sequence[SdoWrite], now: int) -> tuple[int | None, str | None, Difference | None]:
        """Time and error of the recorded writes that serve a request."""
        results = self._recording.sdo
        position = self._state.sdo
        done = now
        for write in request:
            while position < len(results) and (
                results[position].time_ns < now - self._tolerance
                or (results[position].index, results[position].subindex) != (write.index, write.subindex)
            ):
                position += 1
            if position == len(results):
                return None, None, None
            result = results[position]
            position += 1
            entry = DRIVE_OBJECTS.entry(write.index, write.subindex)
            wanted = _encode(entry, write.value)
            own = (write.index, write.subindex) == MAX_TORQUE and write.value == UNKNOWN_TORQUE
            if result.error is None and result.data != wanted and not own:
                signed = entry.type.char.islower()
                recorded = {entry.name: int.from_bytes(result.data, "little", signed=signed)}
                wrong = Difference(result.time_ns, self._recording.do_id, "SDO", recorded, {entry.name: write.value})
                return None, None, wrong
            done = max(done, result.time_ns)
            if result.error is not None:
                self._state.sdo = position
                return done, result.error, None
        self._state.sdo = position
        return done, None, None


def _encode(entry: Entry, value: int) -> bytes:
    return value.to_bytes(entry.type.bits // 8, "little", signed=entry.type.char.islower())


def _times(recording: AxisRecording) -> tuple[list[int], list[int]]:
    """For each event of the setpoints: the earliest time, and the certain time, at which it is in force.

    The gateway's own recording has the time of an answer, not that of its step. The first answer after a loss may belong to a
    step that was still in time; then its IOCS is GOOD, and no earlier step saw the loss.
    """
    events, answers = recording.setpoints, recording.answers
    times, certain = [event.time_ns for event in events], [event.certain_ns for event in events]
    if not recording.in_order or recording.paced:
        return times, certain
    for i, event in enumerate(events):
        if event.values is not None:
            continue
        place = bisect_left(answers, event.time_ns, key=_time)
        if place == len(answers) or not answers[place].plc_ok:
            continue
        answered = answers[place].time_ns
        if i + 1 == len(events) or answered < events[i + 1].time_ns:
            times[i] = certain[i] = answered + 1
    return times, certain


def _time(answer: Answer) -> int:
    return answer.time_ns


def _near(times: Sequence[int], now: int, certain: int, latest: int, taken: int) -> list[int]:
    """Possible numbers of processed events: at least ``certain``, none later than ``latest``; the likeliest first."""
    low = max(taken, certain)
    high = max(low, bisect_right(times, latest))
    likely = min(max(low, bisect_right(times, now)), high)
    return sorted(range(low, high + 1), key=lambda count: abs(count - likely))
