"""Scenarios: what a PLC program does, as a short YAML file, and the engine that plays it.

A scenario is a list of steps; each has one action, an optional ``axis`` (from 1) and ``note``. The engine is sans-I/O: time
and actual values in, setpoints out. Values may be written ``1234``, ``0x4D2``, ``2000h``, ``50 %`` or, with the references in
the file's head, ``1500 rpm`` and ``2000 inc``. ``read`` and ``write`` go to the parameter channel, to the drive object with
the number of the axis as DO-ID. See ``tools/scenarios`` for examples.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from pdgw.gateway.errors import GatewayError
from pdgw.gateway.explain import Problem, problems
from pdgw.gateway.toml_file import check_depth, read_text
from pdgw.peers.plc.endpoint import PlcEndpoint
from pdgw.peers.plc.parameters import ParameterAccess
from pdgw.peers.plc.positioner import Ask, Mdi, PositionerWords, Program, SettingUp, Wait
from pdgw.profidrive.datatypes import DataType, Normalisation, n2, n4
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.codec import MAX_PARAMETERS
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import ApplicationMode, TelegramHalf, telegram
from pdgw.tools.parameters.address import Target, parse_target
from pdgw.tools.parameters.session import Element

Scalar = int | float | str
NS = 1_000_000_000
_DECIMALS = 1_000_000_000
_LARGEST = 2
"""N2 and N4 hold up to 200 %."""
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
    refused: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None
    """The error number a ``write`` has to be refused with."""
    enable: Literal[True] | None = None
    off1: Literal[True] | None = None
    quick_stop: Literal[True] | None = None
    coast: Literal[True] | None = None
    ack: Literal[True] | None = None
    speed: Scalar | None = None
    home: Home | None = None
    home_end: Literal[True] | None = None
    move: Move | None = None
    mdi: Mdi | None = None
    setting_up: SettingUp | None = None
    block: int | None = None
    next_block: Literal[True] | None = None
    jog: Literal[0, 1, 2] | None = None
    """Jog 1 or 2; 0 lets go."""
    jog_distance: Literal[1, 2] | None = None
    set_reference: Literal[True] | None = None
    reject: Literal[True] | None = None
    intermediate_stop: Literal[True] | None = None
    resume: Literal[True] | None = None
    preset: Literal["absolute", "relative"] | None = None
    """The value is parameter 65000."""
    read: Annotated[dict[str, Scalar], Field(min_length=1, max_length=MAX_PARAMETERS)] | None = None
    """What parameters have to be, as in ``expect``; read again until they are."""
    write: Annotated[dict[str, Scalar], Field(min_length=1, max_length=MAX_PARAMETERS)] | None = None
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
        if self.refused is not None and self.write is None:
            raise ValueError("refused: only a write has it")
        return self


_POSITIONERS = frozenset({7, 110, 111})
_POSITIONER_ACTIONS: dict[str, Callable[[PositionerWords, Step], Program]] = {
    "mdi": lambda words, step: words.mdi(step.mdi) if step.mdi is not None else [],
    "setting_up": lambda words, step: words.setting_up(step.setting_up) if step.setting_up is not None else [],
    "block": lambda words, step: words.block(step.block or 0),
    "next_block": lambda words, _: words.next_block(),
    "jog": lambda words, step: words.jog(step.jog or 0, distance=False),
    "jog_distance": lambda words, step: words.jog(step.jog_distance or 0, distance=True),
    "set_reference": lambda words, _: words.set_reference(),
    "home": lambda words, _: words.home(),
}
"""``home`` is telegram 9's too, with its method in SATZANW."""
_ACTIONS = tuple(name for name in Step.model_fields if name not in {"axis", "note", "within", "refused"})


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


class _Loader(yaml.SafeLoader):
    """Without aliases: a few lines of them are gigabytes when they are walked through."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("anchors and aliases (&name, *name) are not taken: write it out")
        node: yaml.Node | None = super().compose_node(parent, index)
        return node


def load_scenario(path: Path) -> Scenario:
    """Read and validate a file; GatewayError names step, key, value and what is allowed."""
    try:
        document = yaml.load(read_text(path), _Loader)
    except (yaml.YAMLError, ValueError) as error:  # a date that is none and a number of 5000 digits are ValueErrors
        raise GatewayError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError:
        raise GatewayError(f"{path}: not valid YAML: nested too deeply") from None
    check_depth(document, str(path))
    try:
        scenario = Scenario.model_validate(document)
    except ValidationError as error:
        raise GatewayError("\n".join(f"{path}: {_told(problem)}" for problem in problems(error, Scenario))) from error
    try:
        Engine(scenario, PlcEndpoint([telegram(number) for number in scenario.telegrams], 1_000_000))
    except GatewayError as error:
        raise GatewayError(f"{path}: {error}") from error
    return scenario


def _told(problem: Problem) -> str:
    """``step 3: move.to = 'x': expected a number``: steps are counted from 1, as in the results."""
    location = list(problem.location)
    place = ""
    if location[:1] == ["steps"] and len(location) > 1:
        place = f"step {int(location[1]) + 1}: "
        location = location[2:]
    key = ".".join(str(part) for part in location) if not problem.names_key else ""
    value = f" = {problem.value}" if key and problem.value else ""
    return f"{place}{key}{value}{': ' if key else ''}{problem.text}"


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


@dataclass(slots=True)
class _Check:
    """What a parameter has to be, or what its writing has to end with."""

    name: str
    holds: Callable[[Element], bool]


@dataclass(slots=True)
class _Parameters:
    """An access to the parameter channel; a read is repeated until it is as expected."""

    targets: tuple[Target, ...]
    values: tuple[str, ...]
    checks: list[_Check]
    axis: int
    within: int
    since: int = -1
    access: ParameterAccess | None = None


_Primitive = Callable[[], None] | _Wait | _Parameters | int


class Engine:
    """Plays a scenario on an endpoint. ``step(now)`` once per cycle; ``finished`` tells when it is over.

    ``muted`` asks the edge not to send. ``drive_commands`` collects lines for the device simulator, ``accesses`` those to
    the parameter channel, which the edge serves meanwhile. GatewayError from the constructor when a step does not fit the
    axis' telegram.
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
            elif isinstance(item, _Parameters):
                if not self._parameters(item, now):
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

    def _wait(self, wait: _Wait, now: int) -> bool:
        if wait.since < 0:
            wait.since = now
        actuals = self.endpoint.actuals[wait.axis]
        met = actuals is not None and all(c.holds(c.value(actuals)) for c in wait.conditions)
        if not met and now - wait.since < wait.within:
            return False
        if actuals is None:
            measured = f"no valid actual values: {self.endpoint.why_no_values(wait.axis)}"
        else:
            measured = ", ".join(f"{c.name} = {c.value(actuals)}" for c in wait.conditions)
        self._result(wait, wait.name, met, measured, now)
        return True

    def _parameters(self, item: _Parameters, now: int) -> bool:
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

    def _result(self, item: _Wait | _Parameters, name: str, passed: bool, measured: str, now: int) -> None:
        began, waited = now - self._start, now - item.since
        self.results.append(
            Result(self._position, item.axis + 1, name, passed, measured, round(began / NS, 3), round(waited / NS, 3))
        )

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
        if action in {"read", "write"}:
            return [self._access(step, axis, within)]
        if step.preset is not None:
            return [
                self._setter(axis, {"G1_STW.PRESET_RELATIVE": int(step.preset == "relative"), "G1_STW.PRESET": 1}),
                self._expectation(axis, {"G1_ZSW.PRESET_DONE": 1, "G1_ZSW.ERROR": 0}, within, "preset done"),
                self._setter(axis, {"G1_STW.PRESET": 0}),
                self._expectation(axis, {"G1_ZSW.PRESET_DONE": 0}, within, "ready for the next preset"),
            ]
        if mode is ApplicationMode.TRANSPARENT:
            return self._transparent(action, axis, within)
        if mode is ApplicationMode.ENCODER:
            return self._encoder(action, axis, within)
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
        positioner = _POSITIONER_ACTIONS.get(action)
        chosen = self.endpoint.telegrams[axis]
        if positioner is not None and (action != "home" or chosen.number in _POSITIONERS):
            if chosen.number not in _POSITIONERS:
                raise GatewayError(f"not possible with telegram {chosen.number}, only with {sorted(_POSITIONERS)}")
            return self._program(axis, positioner(PositionerWords(chosen), step), within)
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

    def _program(self, axis: int, program: Program, within: int) -> list[_Primitive]:
        return [
            self._expectation(axis, dict(item.values), within, item.name)
            if isinstance(item, Wait)
            else self._setter(axis, dict(item.values))
            if isinstance(item, Ask)
            else item
            for item in program
        ]

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

    def _encoder(self, action: str, axis: int, within: int) -> list[_Primitive]:
        if action == "enable":
            return [
                self._setter(axis, {"STW2_ENC.CONTROL_BY_PLC": 1}),
                self._expectation(
                    axis, {"ZSW2_ENC.CONTROL_REQUESTED": 1, "ZSW2_ENC.FAULT": 0, "G1_ZSW.ERROR": 0}, within, "measuring"
                ),
            ]
        if action == "ack":
            bits = ("STW2_ENC.FAULT_ACKNOWLEDGE", "G1_STW.ERROR_ACKNOWLEDGE")
            return [
                self._setter(axis, dict.fromkeys(bits, 1)),
                self._expectation(axis, {"ZSW2_ENC.FAULT": 0}, within, "fault acknowledged"),
                self._setter(axis, dict.fromkeys(bits, 0)),
                self._expectation(axis, {"G1_ZSW.ERROR": 0}, within, "measuring again"),
            ]
        raise GatewayError("not possible with an encoder's telegram")

    def _access(self, step: Step, axis: int, within: int) -> _Parameters:
        wanted = step.write or step.read or {}
        targets = tuple(parse_target(name) for name in wanted)
        for name, target in zip(wanted, targets, strict=True):
            if target.elements is not None and len(target.elements) > 1:
                raise GatewayError(f"parameter {name!r}: expected one element, each has a value of its own")
        prefix = f"{step.note}: " if step.note else ""
        checks = []
        for name, value in wanted.items():
            if step.read is not None:
                checks.append(_Check(f"{prefix}{name} {value}", self._parameter_check(name, value)))
            elif step.refused is None:
                checks.append(_Check(f"{prefix}{name} := {value}", lambda element: not element.failed))
            else:
                text = f"{prefix}{name} := {value} refused, error {step.refused:02X}h"
                checks.append(_Check(text, lambda element: element.error == step.refused))
        values = tuple(str(value) for value in wanted.values()) if step.write is not None else ()
        return _Parameters(targets, values, checks, axis, within)

    def _parameter_check(self, name: str, wanted: Scalar) -> Callable[[Element], bool]:
        try:
            holds = self._comparison(wanted, lambda value: _integer(name, value))
        except GatewayError:
            return lambda element: element.value == wanted  # a name, octets
        return lambda element: isinstance(element.value, int | float) and holds(element.value)

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
            signal_name, mask, shift = self._resolve(name, half)
            raw = self._raw(half.signal(signal_name), value)
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
        half = self.endpoint.telegrams[axis].actuals
        conditions = []
        for key, wanted in values.items():
            signal_name, mask, shift = self._resolve(key, half)
            holds = self._comparison(wanted, partial(self._raw, half.signal(signal_name)))
            conditions.append(Condition(key, str(wanted), holds, mask, shift, signal_name))
        text = ", ".join(f"{c.name} {c.text}" for c in conditions)
        return _Wait(conditions, f"{name}: {text}" if name else text, axis, within)

    @staticmethod
    def _resolve(key: str, half: TelegramHalf) -> tuple[str, int, int]:
        signal_name, _, bit_name = key.partition(".")
        if signal_name not in half.names:
            raise GatewayError(f"signal {signal_name!r} is not in the telegram, allowed: {', '.join(half.names)}")
        if not bit_name:
            return signal_name, 0, 0
        bit = half.signal(signal_name).bit(bit_name, positioning=half.mode is ApplicationMode.POSITIONING)
        return signal_name, bit.mask, bit.position

    @staticmethod
    def _comparison(wanted: Scalar, raw: Callable[[Scalar], int]) -> Callable[[float], bool]:
        """``raw`` makes an integer of each value in the text."""
        text = str(wanted).strip()
        match = re.fullmatch(r"&\s*(\S+)\s*=\s*(\S+)", text)
        if match:
            mask, bits = raw(match[1]), raw(match[2])
            return lambda value: int(value) & mask == bits
        match = re.fullmatch(r"(<=|>=|<|>)\s*(.+)", text)
        if match:
            bound = raw(match[2])
            compare: dict[str, Callable[[float], bool]] = {
                "<": lambda value: value < bound,
                ">": lambda value: value > bound,
                "<=": lambda value: value <= bound,
                ">=": lambda value: value >= bound,
            }
            return compare[match[1]]
        centre, _, tolerance = text.partition("+-")
        middle = raw(centre)
        width = abs(raw(tolerance)) if tolerance else 0
        return lambda value: abs(value - middle) <= width

    def _raw(self, item: Signal, value: Scalar) -> int:
        """A value in any notation as the signal's raw integer."""
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
            reference = full[match[2]]
            if abs(number) > _LARGEST * reference:
                most = f"{float(_LARGEST * reference):g} {match[2]}"
                raise GatewayError(f"{item.name} = {text}: allowed is up to {most} in either direction (200 %)")
            return _to_wire(item, number, reference)
        return _integer(item.name, value, ", 50 %, 1500 rpm or 2000 inc")


def _integer(name: str, value: Scalar, others: str = "") -> int:
    """A whole number in any notation; ``others`` completes the message of the GatewayError for anything else."""
    if isinstance(value, int):
        return int(value)
    text = str(value).strip()
    match = re.fullmatch(r"(-?)(?:0x([0-9a-fA-F]{1,16})|([0-9a-fA-F]{1,16})h|(\d{1,20}))", text)
    if match is None:
        raise GatewayError(f"{name} = {text[:40]!r}: expected 1234, 0x4D2, 2000h{others}")
    magnitude = int(match[2] or match[3] or match[4], 16 if match[2] or match[3] else 10)
    return -magnitude if match[1] else magnitude


def _shown(element: Element) -> str:
    return element.error_text if element.failed else str(element.value)


def _normalisation(item: Signal, reference: Fraction | int) -> Normalisation:
    if item.type is DataType.N2:
        return n2(reference, _I64)
    if item.type is DataType.N4:
        return n4(reference, _I64)
    raise GatewayError(f"{item.name}: %, rpm and inc are for normalised signals only")


def _to_wire(item: Signal, number: Fraction, full: Fraction | int) -> int:
    """A number with up to nine decimals, where ``full`` is 100 %, as the raw value."""
    return _normalisation(item, full * _DECIMALS).to_wire(int(number * _DECIMALS))
