"""Scenarios: what a PLC program does, as a short YAML file, and the engine that plays it.

A scenario is a list of steps; each has one action, an optional ``axis`` (from 1) and ``note``. The engine is sans-I/O: time
and actual values in, setpoints out. Values may be written ``1234``, ``0x4D2``, ``2000h``, ``50 %`` or, with the references in
the file's head, ``1500 rpm`` and ``2000 inc``. See ``tools/scenarios`` for examples.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gateway.errors import GatewayError
from profidrive.datatypes import DataType, Normalisation, n2, n4
from profidrive.errors import ProfidriveError
from profidrive.signals import Signal, signal
from profidrive.telegrams import ApplicationMode, telegram
from tools.plc.endpoint import PlcEndpoint

Scalar = int | float | str
NS = 1_000_000_000
_DECIMALS = 1_000_000_000
_I64 = (-(1 << 62), 1 << 62)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class References(_Model):
    """What 100 % stands for, to write values in physical units."""

    speed_rpm: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 3000
    position: Annotated[int, Field(gt=0)] = 500_000


class Move(_Model):
    """A traversing task of telegram 9."""

    to: Scalar
    velocity: Scalar = "50 %"
    acc: Scalar = "50 %"
    dec: Scalar = "50 %"
    relative: bool = False


class Home(_Model):
    """A homing procedure of telegram 9."""

    method: int = 35
    velocity: Scalar = "20 %"


class Step(_Model):
    """One step: exactly one action."""

    axis: Annotated[int, Field(ge=1)] = 1
    note: str = ""
    within: str = "3 s"
    enable: Literal[True] | None = None
    off1: Literal[True] | None = None
    quick_stop: Literal[True] | None = None
    coast: Literal[True] | None = None
    ack: Literal[True] | None = None
    speed: Scalar | None = None
    home: Home | None = None
    home_end: Literal[True] | None = None
    move: Move | None = None
    reject: Literal[True] | None = None
    intermediate_stop: Literal[True] | None = None
    resume: Literal[True] | None = None
    set: Annotated[dict[str, Scalar], Field(min_length=1)] | None = None
    expect: Annotated[dict[str, Scalar], Field(min_length=1)] | None = None
    hold: str | None = None
    mute: bool | None = None
    run: bool | None = None
    drive: str | None = None

    @property
    def action(self) -> str:
        """The name of the action."""
        return next(name for name in _ACTIONS if getattr(self, name) is not None)

    @model_validator(mode="after")
    def _one_action(self) -> Step:
        given = [name for name in _ACTIONS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"{len(given)} actions ({', '.join(given) or 'none'}), allowed exactly one of {', '.join(_ACTIONS)}"
            )
        return self


_ACTIONS = tuple(name for name in Step.model_fields if name not in {"axis", "note", "within"})


class Scenario(_Model):
    """The whole file."""

    name: str = "scenario"
    telegrams: Annotated[list[int], Field(min_length=1)] = [1]
    references: References = References()
    steps: Annotated[list[Step], Field(min_length=1)]

    @model_validator(mode="after")
    def _axes_exist(self) -> Scenario:
        for number in self.telegrams:
            try:
                telegram(number)
            except ProfidriveError as error:
                raise ValueError(str(error)) from error
        for position, step in enumerate(self.steps, 1):
            if step.axis > len(self.telegrams):
                raise ValueError(f"step {position}: axis {step.axis} does not exist, allowed 1..{len(self.telegrams)}")
        return self


def load_scenario(path: Path) -> Scenario:
    """Read and validate a file; GatewayError names step, key, value and what is allowed."""
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise GatewayError(f"{path}: cannot be read: {error}") from error
    except (yaml.YAMLError, ValueError) as error:  # a date that is none and a number of 5000 digits are ValueErrors
        raise GatewayError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError:
        raise GatewayError(f"{path}: not valid YAML: nested too deeply") from None
    try:
        scenario = Scenario.model_validate(document)
    except ValidationError as error:
        raise GatewayError("\n".join(dict.fromkeys(_explain(path, detail) for detail in error.errors()))) from error
    try:
        Engine(scenario, PlcEndpoint([telegram(number) for number in scenario.telegrams], 1_000_000))
    except GatewayError as error:
        raise GatewayError(f"{path}: {error}") from error
    return scenario


def _explain(path: Path, detail: Any) -> str:
    location = list(detail["loc"])
    place = ""
    if location[:1] == ["steps"] and len(location) > 1:
        place = f"step {location[1] + 1}: "
        location = location[2:]
    message = detail["msg"].removeprefix("Value error, ")
    if location[-1:] and location[-1] in {"int", "float", "str"}:  # one error for each member of Scalar
        location.pop()
        message = "expected a number or a text such as 50 %"
    key = ".".join(str(part) for part in location)
    value = detail["input"]
    shown = "" if isinstance(value, dict | list) or detail["type"] == "extra_forbidden" else f" = {value!r}"
    if detail["type"] == "extra_forbidden":
        models: dict[Any, type[BaseModel]] = {"move": Move, "home": Home, "references": References}
        model = models.get(location[0], Step) if place else models.get(location[0], Scenario)
        model = model if len(location) > 1 else Step if place else Scenario
        message = f"unknown key, allowed: {', '.join(model.model_fields)}"
    return f"{path}: {place}{key}{shown}{': ' if key else ''}{message}"


def parse_time(text: str) -> int:
    """``500 ms`` or ``3 s`` in nanoseconds; GatewayError otherwise."""
    match = re.fullmatch(r"\s*(\d{1,9}(?:\.\d{1,9})?)\s*(ms|s)\s*", text)
    if match is None:
        raise GatewayError(f"time {text[:40]!r}: expected a number with ms or s")
    return int(Fraction(match[1]) * (1_000_000 if match[2] == "ms" else NS))


@dataclass(frozen=True, slots=True)
class Condition:
    """A named value compared with a bound."""

    name: str
    text: str
    holds: Callable[[int], bool]
    mask: int
    shift: int
    signal: str

    def value(self, actuals: dict[str, int]) -> int:
        raw = actuals[self.signal]
        return (raw & self.mask) >> self.shift if self.mask else raw


@dataclass(frozen=True, slots=True)
class Result:
    """An expectation and what became of it; times in seconds from the start."""

    step: int
    axis: int
    name: str
    passed: bool
    measured: str
    time_s: float
    waited_s: float


@dataclass(slots=True)
class _Wait:
    conditions: list[Condition]
    name: str
    axis: int
    within: int
    since: int = -1


_Primitive = Callable[[], None] | _Wait | int


class Engine:
    """Plays a scenario on an endpoint. ``step(now)`` once per cycle; ``finished`` tells when it is over.

    ``muted`` asks the edge not to send. ``drive_commands`` collects lines for the drive simulator. GatewayError from the
    constructor when a step does not fit the axis' telegram.
    """

    def __init__(self, scenario: Scenario, endpoint: PlcEndpoint) -> None:
        self.scenario = scenario
        self.endpoint = endpoint
        self.results: list[Result] = []
        self.notes: list[tuple[float, str]] = []
        self.drive_commands: list[str] = []
        self.muted = False
        self.finished = False
        self._start = -1
        self._position = 0
        self._queue: list[_Primitive] = []
        self._hold_until = -1
        self._programs = [self._compile(number, step) for number, step in enumerate(scenario.steps, 1)]

    @property
    def passed(self) -> bool:
        """Every expectation so far held."""
        return all(result.passed for result in self.results)

    @property
    def current(self) -> str:
        """What is being done, for a view."""
        if self._position == 0:
            return ""
        step = self.scenario.steps[min(self._position, len(self.scenario.steps)) - 1]
        return step.note or f"{step.action} axis {step.axis}"

    def step(self, now: int) -> None:
        """Play as far as it goes at this time with the actual values in the endpoint."""
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
                    self.notes.append(((now - self._start) / NS, note))
                self._position += 1
            item = self._queue[0]
            if isinstance(item, _Wait):
                if not self._wait(item, now):
                    return
                if not self.results[-1].passed and self.scenario.steps[self._position - 1].action == "enable":
                    self._queue = []  # a drive that is not ready gets no ON later on
                    continue
            elif isinstance(item, int):
                if self._hold_until < 0:
                    self._hold_until = now + item
                if now < self._hold_until:
                    return
                self._hold_until = -1
            else:
                item()
            self._queue.pop(0)

    def _wait(self, wait: _Wait, now: int) -> bool:
        if wait.since < 0:
            wait.since = now
        actuals = self.endpoint.actuals[wait.axis]
        met = actuals is not None and all(c.holds(c.value(actuals)) for c in wait.conditions)
        if not met and now - wait.since < wait.within:
            return False
        measured = "no valid actual values (IOPS BAD)"
        if actuals is not None:
            measured = ", ".join(f"{c.name} = {c.value(actuals)}" for c in wait.conditions)
        self.results.append(
            Result(
                self._position,
                wait.axis + 1,
                wait.name,
                met,
                measured,
                round((now - self._start) / NS, 3),
                round((now - wait.since) / NS, 3),
            )
        )
        return True

    # -- compiling ----------------------------------------------------------------------------------------------------

    def _compile(self, number: int, step: Step) -> list[_Primitive]:
        try:
            return self._actions(step)
        except (GatewayError, ProfidriveError) as error:
            raise GatewayError(f"step {number} ({step.action}): {error}") from error

    def _actions(self, step: Step) -> list[_Primitive]:
        axis = step.axis - 1
        mode = self.endpoint.telegrams[axis].mode
        within = parse_time(step.within)
        action = step.action
        if action in {"mute", "run", "drive", "hold"}:
            return [self._environment(step)]
        if action == "set":
            return [self._setter(axis, step.set or {})]
        if action == "expect":
            return [self._expectation(axis, step.expect or {}, within, step.note)]
        if mode is ApplicationMode.TRANSPARENT:
            return self._transparent(action, axis, within)
        control = {
            "off1": {"STW1.ON": 0},
            "quick_stop": {"STW1.NO_QUICK_STOP": 0},
            "coast": {"STW1.NO_COAST_STOP": 0},
            "reject": {"STW1.DO_NOT_REJECT": 0},
            "intermediate_stop": {"STW1.NO_INTERMEDIATE_STOP": 0},
            "resume": {"STW1.NO_INTERMEDIATE_STOP": 1},
            "home_end": {"STW1.START_HOMING": 0},
        }
        if action in control:
            return [self._setter(axis, dict(control[action]))]
        if action == "enable":
            off = 0x043E if mode is ApplicationMode.POSITIONING else 0x047E
            return [
                self._setter(axis, {"STW1": off}),
                self._expectation(
                    axis, {"ZSW1.READY_TO_SWITCH_ON": 1, "ZSW1.SWITCHING_ON_INHIBITED": 0}, within, "ready"
                ),
                self._setter(axis, {"STW1": off | 1}),
                self._expectation(axis, {"ZSW1.OPERATION_ENABLED": 1, "ZSW1.FAULT": 0}, within, "operation enabled"),
            ]
        if action == "ack":
            return [
                self._setter(axis, {"STW1.ON": 0, "STW1.FAULT_ACKNOWLEDGE": 1}),
                self._expectation(axis, {"ZSW1.FAULT": 0}, within, "fault acknowledged"),
                self._setter(axis, {"STW1.FAULT_ACKNOWLEDGE": 0}),
            ]
        if step.speed is not None:
            name = next((n for n in self.endpoint.telegrams[axis].setpoints.names if n.startswith("NSOLL")), "NSOLL_A")
            return [self._setter(axis, {name: step.speed})]
        if step.move is not None:
            return self._move(axis, step.move, within)
        if step.home is not None:
            method = step.home.method & 0xFF
            return [
                self._setter(axis, {"SATZANW.HOMING_METHOD": method, "MDI_VELOCITY": step.home.velocity}),
                self._setter(axis, {"SATZANW.MDI": 1, "STW1.START_HOMING": 1}),
            ]
        raise GatewayError("not possible with this telegram")

    def _move(self, axis: int, move: Move, within: int) -> list[_Primitive]:
        """Data, then the edge of STW1.6, held until ZSW1.12 acknowledges."""
        return [
            self._setter(
                axis,
                {
                    "SATZANW.MDI": 1,
                    "MDI_TARPOS": move.to,
                    "MDI_VELOCITY": move.velocity,
                    "MDI_ACC": move.acc,
                    "MDI_DEC": move.dec,
                    "MDI_MOD.ABSOLUTE": 0 if move.relative else 1,
                    "STW1.DO_NOT_REJECT": 1,
                    "STW1.NO_INTERMEDIATE_STOP": 1,
                    "STW1.ACTIVATE_TASK": 1,
                },
            ),
            self._expectation(axis, {"ZSW1.TASK_ACKNOWLEDGE": 1}, within, "task acknowledged"),
            self._setter(axis, {"STW1.ACTIVATE_TASK": 0}),
            self._expectation(axis, {"ZSW1.TASK_ACKNOWLEDGE": 0}, within, "ready for the next task"),
        ]

    def _transparent(self, action: str, axis: int, within: int) -> list[_Primitive]:
        words = {"off1": 0x0006, "quick_stop": 0x0002, "coast": 0x0000}
        if action in words:
            return [self._setter(axis, {"Controlword": words[action]})]
        if action == "ack":
            return [
                self._setter(axis, {"Controlword": 0x80}),
                self._expectation(axis, {"Statusword": "& 0x4F = 0x40"}, within, "fault reset"),
                self._setter(axis, {"Controlword": 0}),
            ]
        if action == "enable":
            program: list[_Primitive] = []
            for word, status in ((0x06, "& 0x6F = 0x21"), (0x07, "& 0x6F = 0x23"), (0x0F, "& 0x6F = 0x27")):
                program.append(self._setter(axis, {"Controlword": word}))
                program.append(
                    self._expectation(axis, {"Statusword": status}, within, f"Controlword {word:02X}h obeyed")
                )
            return program
        raise GatewayError("not possible with telegram 100")

    def _environment(self, step: Step) -> _Primitive:
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

    def _setter(self, axis: int, values: dict[str, Scalar]) -> Callable[[], None]:
        half = self.endpoint.telegrams[axis].setpoints
        changes: list[tuple[str, int, int]] = []
        for name, value in values.items():
            signal_name, mask, shift = self._resolve(name, axis, half.names)
            raw = self._raw(signal(signal_name), value)
            if mask and not 0 <= raw << shift <= mask:
                raise GatewayError(f"{name} = {value!r}: expected 0..{mask >> shift}")
            if not mask:
                half.encode(half.from_dict({signal_name: raw}))
            changes.append((signal_name, mask, raw << shift))

        def apply() -> None:
            current = self.endpoint.setpoints[axis]
            new: dict[str, int] = {}
            for signal_name, mask, raw in changes:
                before = new.get(signal_name, current[signal_name])
                new[signal_name] = before & ~mask | raw if mask else raw
            self.endpoint.set(axis, new)

        return apply

    def _expectation(self, axis: int, values: dict[str, Scalar], within: int, name: str) -> _Wait:
        names = self.endpoint.telegrams[axis].actuals.names
        conditions = []
        for key, wanted in values.items():
            signal_name, mask, shift = self._resolve(key, axis, names)
            holds = self._comparison(signal(signal_name), wanted)
            conditions.append(Condition(key, str(wanted), holds, mask, shift, signal_name))
        text = ", ".join(f"{c.name} {c.text}" for c in conditions)
        return _Wait(conditions, f"{name}: {text}" if name else text, axis, within)

    def _resolve(self, key: str, axis: int, names: tuple[str, ...]) -> tuple[str, int, int]:
        signal_name, _, bit_name = key.partition(".")
        if signal_name not in names:
            raise GatewayError(f"signal {signal_name!r} is not in the telegram, allowed: {', '.join(names)}")
        if not bit_name:
            return signal_name, 0, 0
        positioning = self.endpoint.telegrams[axis].mode is ApplicationMode.POSITIONING
        bit = signal(signal_name).bit(bit_name, positioning=positioning)
        return signal_name, bit.mask, bit.position

    def _comparison(self, item: Signal, wanted: Scalar) -> Callable[[int], bool]:
        text = str(wanted).strip()
        match = re.fullmatch(r"&\s*(\S+)\s*=\s*(\S+)", text)
        if match:
            mask, bits = self._raw(item, match[1]), self._raw(item, match[2])
            return lambda value: value & mask == bits
        match = re.fullmatch(r"(<=|>=|<|>)\s*(.+)", text)
        if match:
            bound = self._raw(item, match[2])
            compare: dict[str, Callable[[int], bool]] = {
                "<": lambda value: value < bound,
                ">": lambda value: value > bound,
                "<=": lambda value: value <= bound,
                ">=": lambda value: value >= bound,
            }
            return compare[match[1]]
        centre, _, tolerance = text.partition("+-")
        middle = self._raw(item, centre)
        width = abs(self._raw(item, tolerance)) if tolerance else 0
        return lambda value: abs(value - middle) <= width

    def _raw(self, item: Signal, value: Scalar) -> int:
        """A value in any notation as the signal's raw integer."""
        if isinstance(value, int):
            return int(value)
        text = str(value).strip()
        match = re.fullmatch(r"(-?\d{1,15}(?:\.\d{1,9})?)\s*(%|rpm|inc)", text)
        if match:
            number = Fraction(match[1])
            references = self.scenario.references
            full: dict[str, Fraction | int] = {
                "%": 100,
                "rpm": Fraction(references.speed_rpm),
                "inc": references.position,
            }
            return _to_wire(item, number, full[match[2]])
        match = re.fullmatch(r"(-?)(?:0x([0-9a-fA-F]{1,16})|([0-9a-fA-F]{1,16})h|(\d{1,20}))", text)
        if match is None:
            raise GatewayError(f"{item.name} = {text[:40]!r}: expected 1234, 0x4D2, 2000h, 50 %, 1500 rpm or 2000 inc")
        magnitude = int(match[2] or match[3] or match[4], 16 if match[2] or match[3] else 10)
        return -magnitude if match[1] else magnitude


def _normalisation(item: Signal, reference: Fraction | int) -> Normalisation:
    if item.type is DataType.N2:
        return n2(reference, _I64)
    if item.type is DataType.N4:
        return n4(reference, _I64)
    raise GatewayError(f"{item.name}: %, rpm and inc are for normalised signals only")


def _to_wire(item: Signal, number: Fraction, full: Fraction | int) -> int:
    """A number with up to nine decimals, where ``full`` is 100 %, as the raw value."""
    return _normalisation(item, full * _DECIMALS).to_wire(int(number * _DECIMALS))
