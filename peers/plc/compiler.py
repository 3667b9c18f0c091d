"""What the steps of a scenario are made of, in the words of the axis' telegram: setpoints to set, actual values to wait for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.endpoint import PlcEndpoint
from pdgw.peers.plc.notation import comparison, integer, raw_value
from pdgw.peers.plc.parameters import ParameterAccess
from pdgw.peers.plc.positioner import Ask, PositionerWords, Program, Wait
from pdgw.peers.plc.scenario import Move, References, Scalar, Step
from pdgw.profidrive.telegrams import ApplicationMode, TelegramHalf
from pdgw.tools.parameters.address import Target, parse_target
from pdgw.tools.parameters.session import Element

_STW1_ACTIONS = {
    "off1": {"STW1.ON": 0},
    "quick_stop": {"STW1.NO_QUICK_STOP": 0},
    "coast": {"STW1.NO_COAST_STOP": 0},
    "reject": {"STW1.DO_NOT_REJECT": 0},
    "intermediate_stop": {"STW1.NO_INTERMEDIATE_STOP": 0},
    "resume": {"STW1.NO_INTERMEDIATE_STOP": 1},
    "home_end": {"STW1.START_HOMING": 0},
}
"""The actions that are one bit."""
_CONTROLWORDS = {"off1": 0x0006, "quick_stop": 0x0002, "coast": 0x0000}
_ENABLING = ((0x06, "& 0x6F = 0x21"), (0x07, "& 0x6F = 0x23"), (0x0F, "& 0x6F = 0x27"))
"""Telegram 100: Controlwords, and the Statusword each has to be answered with."""
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


@dataclass(slots=True)
class Expectation:
    """Actual values that have to come within a time; in nanoseconds, as ``since``, when the waiting began."""

    conditions: list[Condition]
    name: str
    axis: int
    within: int
    since: int = -1


@dataclass(slots=True)
class Check:
    """What a parameter has to be, or what its writing has to end with."""

    name: str
    holds: Callable[[Element], bool]


@dataclass(slots=True)
class Access:
    """An access to the parameter channel; a read is repeated until it is as expected."""

    targets: tuple[Target, ...]
    values: tuple[str, ...]
    checks: list[Check]
    axis: int
    within: int
    since: int = -1
    access: ParameterAccess | None = None


Primitive = Callable[[], None] | Expectation | Access | int
"""What the engine plays; an integer is a pause in nanoseconds."""


class Compiler:
    """Makes primitives of the steps for one endpoint."""

    def __init__(self, references: References, endpoint: PlcEndpoint) -> None:
        self._references = references
        self._endpoint = endpoint

    def compile(self, step: Step, within: int) -> list[Primitive]:
        """What a step is made of; GatewayError when it does not fit the axis' telegram."""
        axis = step.axis - 1
        mode = self._endpoint.telegrams[axis].mode
        action = step.action
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
        if action in _STW1_ACTIONS:
            return [self._setter(axis, dict(_STW1_ACTIONS[action]))]
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
        chosen = self._endpoint.telegrams[axis]
        if positioner is not None and (action != "home" or chosen.number in _POSITIONERS):
            if chosen.number not in _POSITIONERS:
                raise GatewayError(f"not possible with telegram {chosen.number}, only with {sorted(_POSITIONERS)}")
            return self._program(axis, positioner(PositionerWords(chosen), step), within)
        if step.speed is not None:
            name = next((n for n in self._endpoint.telegrams[axis].setpoints.names if n.startswith("NSOLL")), "NSOLL_A")
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

    def _program(self, axis: int, program: Program, within: int) -> list[Primitive]:
        return [
            self._expectation(axis, dict(item.values), within, item.name)
            if isinstance(item, Wait)
            else self._setter(axis, dict(item.values))
            if isinstance(item, Ask)
            else item
            for item in program
        ]

    def _move(self, axis: int, move: Move, within: int) -> list[Primitive]:
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

    def _transparent(self, action: str, axis: int, within: int) -> list[Primitive]:
        if action in _CONTROLWORDS:
            return [self._setter(axis, {"Controlword": _CONTROLWORDS[action]})]
        if action == "ack":
            return [
                self._setter(axis, {"Controlword": 0x80}),
                self._expectation(axis, {"Statusword": "& 0x4F = 0x40"}, within, "fault reset"),
                self._setter(axis, {"Controlword": 0}),
            ]
        if action == "enable":
            program: list[Primitive] = []
            for word, status in _ENABLING:
                program.append(self._setter(axis, {"Controlword": word}))
                program.append(
                    self._expectation(axis, {"Statusword": status}, within, f"Controlword {word:02X}h obeyed")
                )
            return program
        raise GatewayError("not possible with telegram 100")

    def _encoder(self, action: str, axis: int, within: int) -> list[Primitive]:
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

    def _access(self, step: Step, axis: int, within: int) -> Access:
        wanted = step.write or step.read or {}
        targets = tuple(parse_target(name) for name in wanted)
        for name, target in zip(wanted, targets, strict=True):
            if target.elements is not None and len(target.elements) > 1:
                raise GatewayError(f"parameter {name!r}: expected one element, each has a value of its own")
        prefix = f"{step.note}: " if step.note else ""
        checks = []
        for name, value in wanted.items():
            if step.read is not None:
                checks.append(Check(f"{prefix}{name} {value}", self._parameter_check(name, value)))
            elif step.refused is None:
                checks.append(Check(f"{prefix}{name} := {value}", lambda element: not element.failed))
            else:
                text = f"{prefix}{name} := {value} refused, error {step.refused:02X}h"
                checks.append(Check(text, lambda element: element.error == step.refused))
        values = tuple(str(value) for value in wanted.values()) if step.write is not None else ()
        return Access(targets, values, checks, axis, within)

    def _parameter_check(self, name: str, wanted: Scalar) -> Callable[[Element], bool]:
        try:
            holds = comparison(wanted, lambda value: integer(name, value))
        except GatewayError:
            return lambda element: element.value == wanted  # a name, octets
        return lambda element: isinstance(element.value, int | float) and holds(element.value)

    def _setter(self, axis: int, values: dict[str, Scalar]) -> Callable[[], None]:
        half = self._endpoint.telegrams[axis].setpoints
        changes: list[tuple[str, int, int]] = []
        for name, value in values.items():
            signal_name, mask, shift = self._resolve(name, half)
            raw = raw_value(self._references, half.signal(signal_name), value)
            if mask and not 0 <= raw << shift <= mask:
                raise GatewayError(f"{name} = {value!r}: expected 0..{mask >> shift}")
            if not mask:
                half.encode(half.from_dict({signal_name: raw}))
            changes.append((signal_name, mask, raw << shift))

        def apply() -> None:
            current = self._endpoint.setpoints[axis]
            new: dict[str, int] = {}
            for signal_name, mask, raw in changes:
                before = new.get(signal_name, current[signal_name])
                new[signal_name] = before & ~mask | raw if mask else raw
            self._endpoint.set(axis, new)

        return apply

    def _expectation(self, axis: int, values: dict[str, Scalar], within: int, name: str) -> Expectation:
        half = self._endpoint.telegrams[axis].actuals
        conditions = []
        for key, wanted in values.items():
            signal_name, mask, shift = self._resolve(key, half)
            holds = comparison(wanted, partial(raw_value, self._references, half.signal(signal_name)))
            conditions.append(Condition(key, str(wanted), holds, mask, shift, signal_name))
        text = ", ".join(f"{c.name} {c.text}" for c in conditions)
        return Expectation(conditions, f"{name}: {text}" if name else text, axis, within)

    @staticmethod
    def _resolve(key: str, half: TelegramHalf) -> tuple[str, int, int]:
        signal_name, _, bit_name = key.partition(".")
        if signal_name not in half.names:
            raise GatewayError(f"signal {signal_name!r} is not in the telegram, allowed: {', '.join(half.names)}")
        if not bit_name:
            return signal_name, 0, 0
        bit = half.signal(signal_name).bit(bit_name, positioning=half.mode is ApplicationMode.POSITIONING)
        return signal_name, bit.mask, bit.position
