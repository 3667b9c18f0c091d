"""The engine that runs a scenario, sans-I/O: time and actual values in, setpoints out."""

from __future__ import annotations

from dataclasses import dataclass

from pdgw.client.session import Element
from pdgw.durations import SECOND
from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.compiler import Access, Compiler, Expectation, Primitive
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.exchange.following import Following
from pdgw.peers.plc.exchange.parameters import ParameterAccess
from pdgw.peers.plc.notation import parse_time
from pdgw.peers.plc.scenario import Scenario, Step
from pdgw.profidrive.errors import ProfidriveError

_ENVIRONMENT = frozenset({"mute", "run", "drive", "hold"})
"""Actions that do not depend on the axis' telegram."""


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

    ``muted``: send no frames. ``drive_commands``: lines for the device simulator. ``accesses``: requests to the parameter
    channel; the caller serves both. GatewayError from the constructor when a step does not fit the axis' telegram.
    """

    def __init__(self, scenario: Scenario, endpoint: PlcEndpoint) -> None:
        self.scenario = scenario
        self.endpoint = endpoint
        self.results: list[Result] = []
        self.notes: list[tuple[float, str]] = []
        self.drive_commands: list[str] = []
        self.accesses: list[ParameterAccess] = []
        self.muted = False
        self.finished = False
        self._start = -1
        self._position = 0
        self._queue: list[Primitive] = []
        self._hold_until = -1
        self._compiler = Compiler(scenario.references, endpoint)
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
        step = self.scenario.steps[min(self._position, len(self.scenario.steps)) - 1]
        return step.note or f"{step.action} axis {step.axis}"

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
                note = self.scenario.steps[self._position].note
                if note:
                    self.notes.append(((now - self._start) / SECOND, note))
                self._position += 1
            item = self._queue[0]
            if isinstance(item, Expectation):
                if not self._wait(item, now):
                    return
                if not self.results[-1].passed and self.scenario.steps[self._position - 1].action == "enable":
                    self._queue = []  # a drive that is not ready must not get ON later
                    continue
            elif isinstance(item, Access):
                if not self._parameters(item, now):
                    return
            elif isinstance(item, Following):
                if not self._follow(item, now):
                    return
            elif isinstance(item, int):
                if self._hold_until < 0:
                    self._hold_until = now + item
                if now < self._hold_until:
                    return
                self._hold_until = -1
            else:
                item()
            self._queue.pop(0)

    def _wait(self, wait: Expectation, now: int) -> bool:
        if wait.since < 0:
            wait.since = now
        actuals = self.endpoint.actuals[wait.axis]
        met = actuals is not None and all(c.holds(c.value(actuals)) for c in wait.conditions)
        if not met and now - wait.since < wait.within:
            return False
        if actuals is None:
            measured = f"no valid actual values: {self.endpoint.why_no_values(wait.axis)}"
        else:
            measured = ", ".join(c.measured(actuals) for c in wait.conditions)
        self._result(wait, wait.name, met, measured, now)
        return True

    def _follow(self, item: Following, now: int) -> bool:
        wanted = item.step(now, self.endpoint.actuals[item.axis])
        self.endpoint.set(item.axis, item.rest if wanted is None else wanted)
        if wanted is None:
            self._result(item, item.name, item.passed, item.measured, now)
        return wanted is None

    def abort(self) -> None:
        """End the active step. A closed position loop leaves no setpoints."""
        if self._queue and isinstance(self._queue[0], Following):
            self.endpoint.set(self._queue[0].axis, self._queue[0].rest)
        self._queue = []
        self.finished = True

    def _parameters(self, item: Access, now: int) -> bool:
        if item.since < 0:
            item.since = now
        expired = now - item.since >= item.within
        if item.access is None:
            item.access = ParameterAccess(item.axis + 1, item.targets, item.values)
            self.accesses.append(item.access)
        access = item.access
        if not access.done and not expired:
            return False
        answers = access.answers if access.done else ()
        met = [check.holds(answer) for check, answer in zip(item.checks, answers, strict=False)]
        if not access.error and access.done and not all(met) and not item.values and not expired:
            item.access = None
            return False
        for place, check in enumerate(item.checks):
            if place < len(answers):
                self._result(item, check.name, met[place], _shown(answers[place]), now)
            else:
                self._result(item, check.name, False, access.error or "no answer in time", now)
        return True

    def _result(self, item: Expectation | Access | Following, name: str, passed: bool, measured: str, now: int) -> None:
        began, waited = now - self._start, now - item.since
        self.results.append(
            Result(
                self._position,
                item.axis + 1,
                name,
                passed,
                measured,
                round(began / SECOND, 3),
                round(waited / SECOND, 3),
            )
        )

    def _compile(self, number: int, step: Step) -> list[Primitive]:
        try:
            within = parse_time(step.within or self.scenario.within)
            if step.action in _ENVIRONMENT:
                return [self._environment(step)]
            return self._compiler.compile(step, within)
        except (GatewayError, ProfidriveError) as error:
            raise GatewayError(f"step {number} ({step.action}): {error}") from error

    def _environment(self, step: Step) -> Primitive:
        if step.hold is not None:
            return parse_time(step.hold)
        if step.drive is not None:
            command = step.drive
            return lambda: self.drive_commands.append(command)
        if step.mute is not None:
            muted = step.mute

            def mute() -> None:
                self.muted = muted

            return mute
        running = bool(step.run)

        def run() -> None:
            self.endpoint.run = running

        return run


def _shown(element: Element) -> str:
    return element.error_text if element.failed else str(element.value)
