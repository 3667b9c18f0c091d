"""The engine that runs a scenario, sans-I/O: time and actual values in, setpoints out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass

from pdgw.base.durations import SECOND
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.client.address import Target, parse_target
from pdgw.gateway.client.session import Element
from pdgw.peers.plc.actions import Access, Order, Set, Wait
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.exchange.following import Follow, Following, can_follow
from pdgw.peers.plc.notation import Scalar, Word, comparison, expected, find, integer, parse_time, raw_value, written
from pdgw.peers.plc.scenario import ACTIONS, Scenario, Step
from pdgw.profidrive.errors import ProfidriveError

Run = Callable[[int], bool]
"""One part of a step: called each cycle with the time, until it returns True."""
Request = Callable[[int, Sequence[Target], Sequence[str]], "Future[list[Element]]"]
"""Read one element of each target from a drive object, or write values to them."""


@dataclass(frozen=True, slots=True)
class Result:
    """An expectation and its result; times in seconds from the start."""

    step: int
    axis: int
    name: str
    passed: bool
    measured: str
    time_s: float
    waited_s: float


class Engine:
    """Runs a scenario on an endpoint. Call ``step(now)`` once per cycle until ``finished`` is true.

    ``muted``: send no frames. GatewayError from the constructor when a step does not fit the axis' telegram.
    """

    def __init__(self, scenario: Scenario, endpoint: PlcEndpoint) -> None:
        self.scenario = scenario
        self.endpoint = endpoint
        self.results: list[Result] = []
        self.notes: list[tuple[float, str]] = []
        self.drive: Callable[[str], object] = lambda _: None
        """Gets the commands for the device simulator."""
        self.request: Request = lambda *_: Future()
        """Parameter channel; without one there is no answer."""
        self.muted = False
        self.finished = False
        self._start = -1
        self._since = -1
        """Start of the active part; -1 before its first cycle."""
        self._position = 0
        self._queue: list[Run] = []
        self._following: tuple[int, Mapping[str, int]] | None = None
        """Axis of the active closed position loop, and the setpoints at its end."""
        self._programs = [self._compile(number, step) for number, step in enumerate(scenario.steps, 1)]

    @property
    def passed(self) -> bool:
        """Whether every expectation until now is met."""
        return all(result.passed for result in self.results)

    @property
    def current(self) -> str:
        """The present step, for a display."""
        if self._position == 0:
            return ""
        step = self._step
        return step.note or f"{step.action} axis {step.axis}"

    @property
    def _step(self) -> Step:
        return self.scenario.steps[self._position - 1]

    def step(self, now: int) -> None:
        """Run the steps that are possible at this time with the actual values of the endpoint."""
        if self._start < 0:
            self._start = now
        while not self.finished:
            if not self._queue:
                if self._position >= len(self._programs):
                    self.finished = True
                    return
                self._queue = list(self._programs[self._position])
                self._position += 1
                if self._step.note:
                    self.notes.append(((now - self._start) / SECOND, self._step.note))
            if self._since < 0:
                self._since = now
            if not self._queue[0](now):
                return
            self._since = -1
            self._queue.pop(0)
            if self._step.action == "enable" and any(r.step == self._position and not r.passed for r in self.results):
                self._queue = []  # a drive that is not ready must not get ON later

    def abort(self) -> None:
        """End the active step. A closed position loop leaves no setpoints."""
        if self._following is not None:
            self.endpoint.set(*self._following)
        self._queue = []
        self.finished = True

    def _report(self, axis: int, name: str, passed: bool, measured: str, now: int) -> None:
        began, waited = round((now - self._start) / SECOND, 3), round((now - self._since) / SECOND, 3)
        self.results.append(Result(self._position, axis + 1, name, passed, measured, began, waited))

    # -- translation of the steps -------------------------------------------------------------------------------------

    def _compile(self, number: int, step: Step) -> list[Run]:
        try:
            chosen = self.endpoint.telegrams[step.axis - 1]
            within = parse_time(step.within or self.scenario.within)
            program = ACTIONS[step.action](chosen, getattr(step, step.action))
            return [self._part(part, step, step.axis - 1, within) for part in program]
        except (GatewayError, ProfidriveError) as error:
            raise GatewayError(f"step {number} ({step.action}): {error}") from error

    def _part(self, part: Set | Wait | Access | Follow | Order | int, step: Step, axis: int, within: int) -> Run:
        match part:
            case int():
                return lambda now: now - self._since >= part
            case Set():
                return self._setter(part, axis)
            case Wait():
                return self._expectation(part.values, part.name or step.note, axis, within)
            case Access():
                return self._access(part, step, axis, within)
            case Follow():
                return self._follow(part, axis, within)

        def run(_: int) -> bool:
            part(self, axis)
            return True

        return run

    def _setter(self, part: Set, axis: int) -> Run:
        changes = [self._change(axis, name, value) for name, value in part.values.items()]
        if_zero = [self._change(axis, name, value) for name, value in part.if_zero.items()]

        def run(_: int) -> bool:
            current = self.endpoint.setpoints[axis]
            new: dict[str, int] = {}
            for name, mask, raw in (*changes, *(change for change in if_zero if not current[change[0]])):
                new[name] = new.get(name, current[name]) & ~mask | raw if mask else raw
            self.endpoint.set(axis, new)
            return True

        return run

    def _change(self, axis: int, name: str, value: Scalar) -> tuple[str, int, int]:
        """Signal, mask (0: all bits) and shifted bits."""
        half = self.endpoint.telegrams[axis].setpoints
        word = find(name, half)
        item, bit = word.signal, word.bit
        raw = raw_value(self.scenario.references, item, value)
        if bit is None:
            half.encode(half.from_dict({item.name: raw}))
            return item.name, 0, raw
        highest = bit.mask >> bit.position
        lowest = -(highest // 2) - 1 if bit.signed else 0
        if not lowest <= raw <= highest:
            raise GatewayError(f"{name} = {value!r}: expected {lowest}..{highest}")
        return item.name, bit.mask, (raw & highest) << bit.position

    def _expectation(self, values: Mapping[str, Scalar], name: str, axis: int, within: int) -> Run:
        references = self.scenario.references
        half = self.endpoint.telegrams[axis].actuals
        conditions: list[tuple[Word, str, Callable[[int], bool]]] = []
        for key, condition in values.items():
            word = find(key, half)
            conditions.append((word, str(condition), expected(references, word.signal, condition)))
        text = ", ".join(f"{word.name} {condition}" for word, condition, _ in conditions)

        def run(now: int) -> bool:
            actuals = self.endpoint.actuals[axis]
            met = actuals is not None and all(holds(word.of(actuals)) for word, _, holds in conditions)
            if not met and now - self._since < within:
                return False
            if actuals is None:
                measured = f"no valid actual values: {self.endpoint.why_no_values(axis)}"
            else:
                measured = ", ".join(
                    f"{word.name} = {written(references, word.signal, condition, word.of(actuals))}"
                    for word, condition, _ in conditions
                )
            self._report(axis, f"{name}: {text}" if name else text, met, measured, now)
            return True

        return run

    def _follow(self, wish: Follow, axis: int, within: int) -> Run:
        known = self.scenario.references
        dsc = can_follow(self.endpoint.telegrams[axis], dsc=True)
        item = Following(wish, within, increments=known.increments, rpm=known.speed_rpm, dsc=dsc)

        def run(now: int) -> bool:
            self._following = axis, item.rest
            setpoints = item.step(now, self.endpoint.actuals[axis])
            self.endpoint.set(axis, item.rest if setpoints is None else setpoints)
            if setpoints is not None:
                return False
            self._following = None
            self._report(axis, item.name, item.passed, item.measured, now)
            return True

        return run

    def _access(self, part: Access, step: Step, axis: int, within: int) -> Run:
        """An access to the parameter channel. A read is repeated until it has the required values."""
        targets = tuple(parse_target(name) for name in part.values)
        for name, target in zip(part.values, targets, strict=True):
            if target.elements is not None and len(target.elements) > 1:
                raise GatewayError(f"parameter {name!r}: expected one element; each element has its own value")
        checks = [_check(step, name, value, write=part.write) for name, value in part.values.items()]
        values = tuple(map(str, part.values.values())) if part.write else ()
        answer: Future[list[Element]] | None = None

        def run(now: int) -> bool:
            nonlocal answer
            expired = now - self._since >= within
            if answer is None:
                answer = self.request(axis + 1, targets, values)
            if not answer.done() and not expired:
                return False
            elements, problem = _outcome(answer)
            met = [holds(element) for (_, holds), element in zip(checks, elements, strict=False)]
            if elements and not all(met) and not part.write and not expired:
                answer = None
                return False
            for place, (name, _) in enumerate(checks):
                if elements:
                    element = elements[place]
                    measured = element.error_text if element.failed else str(element.value)
                    self._report(axis, name, met[place], measured, now)
                else:
                    self._report(axis, name, False, problem, now)
            return True

        return run


def _outcome(answer: Future[list[Element]]) -> tuple[list[Element], str]:
    """The elements of an answer, or why there are none."""
    if not answer.done():
        return [], "no answer in time"
    error = answer.exception()
    if error is None:
        return answer.result(), ""
    return [], str(error) if isinstance(error, GatewayError) else repr(error)


def _check(step: Step, name: str, condition: Scalar, *, write: bool) -> tuple[str, Callable[[Element], bool]]:
    """The name of a result, and whether an answer has the required value, or is the required result of a write."""
    text = f"{step.note}: {name}" if step.note else name
    if write:
        if step.refused is None:
            return f"{text} := {condition}", lambda element: not element.failed
        return (
            f"{text} := {condition} refused, error {step.refused:02X}h",
            lambda element: element.error == step.refused,
        )
    try:
        holds = comparison(condition, lambda value: integer(name, value))
    except GatewayError:
        return f"{text} {condition}", lambda element: element.value == condition  # a name or octets
    return f"{text} {condition}", lambda element: isinstance(element.value, int | float) and holds(element.value)
