"""Translate the steps of a scenario to the telegram of the axis: setpoints to set, actual values to wait for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

from pdgw.client.address import Target, parse_target
from pdgw.client.session import Element
from pdgw.gateway.axis.telegrams import POSITIONER_TELEGRAM_NUMBERS, SPEED_TELEGRAM_NUMBERS
from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.exchange.following import Follow, Following, can_follow
from pdgw.peers.plc.exchange.parameters import ParameterAccess
from pdgw.peers.plc.exchange.positioner import Ask, PositionerWords, Program, Wait
from pdgw.peers.plc.exchange.sensor import SensorWords
from pdgw.peers.plc.notation import comparison, expected, integer, raw_value, written
from pdgw.peers.plc.scenario import Home, Move, References, Scalar, Step
from pdgw.peers.plc.vocabulary import word
from pdgw.phrases import did_you_mean
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.signals import SignalQuantity
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, Telegram, TelegramHalf
from pdgw.profidrive.words import Bit

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
"""Telegram 100: Controlwords, and the required answer of the Statusword to each."""
_POSITIONER_ACTIONS: dict[str, Callable[[PositionerWords, Step], Program]] = {
    "mdi": lambda words, step: words.mdi(step.mdi) if step.mdi is not None else [],
    "setting_up": lambda words, step: words.setting_up(step.setting_up) if step.setting_up is not None else [],
    "block": lambda words, step: words.block(step.block or 0),
    "next_block": lambda words, _: words.next_block(),
    "jog": lambda words, step: words.jog(step.jog or 0, distance=False),
    "jog_distance": lambda words, step: words.jog(step.jog_distance or 0, distance=True),
    "set_reference": lambda words, _: words.set_reference(),
    "home": lambda words, step: _home(words, step.home) if step.home is not None else [],
}
"""``home`` exists for telegram 9, too, with its method in SATZANW."""


def _home(words: PositionerWords, wish: Home) -> Program:
    """Method and speeds are those of the configuration."""
    for name in sorted({"method", "velocity"} & wish.model_fields_set):
        raise GatewayError(
            f"home.{name} is allowed only with telegram 9; with other telegrams the configuration sets it"
        )
    return words.home(passive=wish.passive, negative=wish.negative)


_SENSOR_ACTIONS: dict[str, Callable[[Telegram, Step], Program]] = {
    "reference_mark": lambda chosen, step: SensorWords(chosen, step.reference_mark or 1).reference_mark(),
    "measure": lambda chosen, step: (
        SensorWords(chosen, step.measure.sensor).measure(step.measure) if step.measure is not None else []
    ),
    "read_value": lambda chosen, step: (
        SensorWords(chosen, step.read_value.sensor).read_value(step.read_value) if step.read_value is not None else []
    ),
    "stop_measuring": lambda chosen, step: SensorWords(chosen, step.stop_measuring or 1).stop(),
}
_RAMP_BITS = ("STW1.ENABLE_RAMP_GENERATOR", "STW1.UNFREEZE_RAMP_GENERATOR", "STW1.ENABLE_SETPOINT")
"""All 0 while a speed telegram jogs."""
_SIGN_OF_LIFE = "SIGN_OF_LIFE"


@dataclass(frozen=True, slots=True)
class Condition:
    """A named value compared with a bound."""

    name: str
    text: str
    holds: Callable[[int], bool]
    mask: int
    shift: int
    signal: str
    write: Callable[[int], str]

    def value(self, actuals: dict[str, int]) -> int:
        raw = actuals[self.signal]
        return (raw & self.mask) >> self.shift if self.mask else raw

    def measured(self, actuals: dict[str, int]) -> str:
        """The value in the notation of the bound."""
        return f"{self.name} = {self.write(self.value(actuals))}"


@dataclass(slots=True)
class Expectation:
    """Required actual values within a time. ``since``: start of the waiting; both in nanoseconds."""

    conditions: list[Condition]
    name: str
    axis: int
    within: int
    since: int = -1


@dataclass(slots=True)
class Check:
    """Required value of a parameter, or required result of a write."""

    name: str
    holds: Callable[[Element], bool]


@dataclass(slots=True)
class Access:
    """An access to the parameter channel. A read is repeated until it has the required value."""

    targets: tuple[Target, ...]
    values: tuple[str, ...]
    checks: list[Check]
    axis: int
    within: int
    since: int = -1
    access: ParameterAccess | None = None


Primitive = Callable[[], None] | Expectation | Access | Following | int
"""A command of the engine; an integer is a pause in nanoseconds."""


class Compiler:
    """Translates steps to primitives for one endpoint."""

    def __init__(self, references: References, endpoint: PlcEndpoint) -> None:
        self._references = references
        self._endpoint = endpoint

    def compile(self, step: Step, within: int) -> list[Primitive]:
        """The primitives of a step; GatewayError when it does not fit the axis' telegram."""
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
        chosen = self._endpoint.telegrams[axis]
        if action in _SENSOR_ACTIONS:
            return self._program(axis, _SENSOR_ACTIONS[action](chosen, step), within)
        if step.sign_of_life is not None:
            return [self._sign_of_life(axis, counts=step.sign_of_life)]
        if step.follow is not None:
            return [self._follow(axis, step.follow, within)]
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
        if step.jog is not None and chosen.number in SPEED_TELEGRAM_NUMBERS:
            return [self._jog(axis, step.jog)]
        if positioner is not None and (action != "home" or chosen.number in POSITIONER_TELEGRAM_NUMBERS):
            if chosen.number not in POSITIONER_TELEGRAM_NUMBERS:
                others = SPEED_TELEGRAM_NUMBERS if action == "jog" else ()
                allowed = ", ".join(map(str, sorted((*POSITIONER_TELEGRAM_NUMBERS, *others))))
                raise GatewayError(f"not possible with telegram {chosen.number}, only with {allowed}")
            return self._program(axis, positioner(PositionerWords(chosen), step), within)
        if step.speed is not None:
            return [self._setter(axis, {_speed_setpoint(chosen): step.speed})]
        if step.move is not None:
            return self._move(axis, step.move, within)
        if step.home is not None:
            if step.home.passive or step.home.negative:
                raise GatewayError(
                    f"passive and negative are not possible with telegram {chosen.number}, only with 111"
                )
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
            else self._setter(axis, dict(item.values), dict(item.if_zero))
            if isinstance(item, Ask)
            else item
            for item in program
        ]

    def _jog(self, axis: int, which: int) -> Callable[[], None]:
        """Jog of a speed telegram. The end of a jog sets speed 0, so that the axis does not turn with an earlier setpoint."""
        values: dict[str, Scalar] = {_speed_setpoint(self._endpoint.telegrams[axis]): 0}
        values |= dict.fromkeys(_RAMP_BITS, int(not which))
        return self._setter(axis, {**values, "STW1.JOG_1_ON": int(which == 1), "STW1.JOG_2_ON": int(which == 2)})

    def _sign_of_life(self, axis: int, *, counts: bool) -> Callable[[], None]:
        half = self._endpoint.telegrams[axis].setpoints
        for item in half.signals:
            bit = next((bit for bit in item.bits if bit.name == _SIGN_OF_LIFE), None)
            if bit is not None:
                return partial(self._endpoint.count, axis, item.name, bit if counts else None)
        raise GatewayError(f"not possible with telegram {half.telegram}: it has no sign of life")

    def _follow(self, axis: int, wish: Follow, within: int) -> Following:
        chosen = self._endpoint.telegrams[axis]
        if not can_follow(chosen, dsc=wish.dsc):
            allowed = [str(t.number) for t in TELEGRAMS.values() if can_follow(t, dsc=wish.dsc)]
            raise GatewayError(f"not possible with telegram {chosen.number}, only with {', '.join(allowed)}")
        known = self._references
        return Following(
            wish,
            axis,
            within,
            increments=known.increments,
            rpm=known.speed_rpm,
            dsc=can_follow(chosen, dsc=True),
        )

    def _move(self, axis: int, move: Move, within: int) -> list[Primitive]:
        """Set the data, then the edge of STW1.6, until ZSW1.12 acknowledges."""
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
                    self._expectation(axis, {"Statusword": status}, within, f"Controlword {word:02X}h executed")
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
        raise GatewayError("not possible with the telegram of an encoder")

    def _access(self, step: Step, axis: int, within: int) -> Access:
        wanted = step.write or step.read or {}
        targets = tuple(parse_target(name) for name in wanted)
        for name, target in zip(wanted, targets, strict=True):
            if target.elements is not None and len(target.elements) > 1:
                raise GatewayError(f"parameter {name!r}: expected one element; each element has its own value")
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
            return lambda element: element.value == wanted  # a name or octets
        return lambda element: isinstance(element.value, int | float) and holds(element.value)

    def _setter(
        self, axis: int, values: Mapping[str, Scalar], if_zero: Mapping[str, Scalar] = MappingProxyType({})
    ) -> Callable[[], None]:
        """Set setpoints; those of ``if_zero`` only if they are 0."""
        changes = [self._change(axis, name, value) for name, value in values.items()]
        more = [self._change(axis, name, value) for name, value in if_zero.items()]

        def apply() -> None:
            current = self._endpoint.setpoints[axis]
            wanted = [*changes, *(change for change in more if not current[change[0]])]
            new: dict[str, int] = {}
            for signal_name, mask, raw in wanted:
                before = new.get(signal_name, current[signal_name])
                new[signal_name] = before & ~mask | raw if mask else raw
            self._endpoint.set(axis, new)

        return apply

    def _change(self, axis: int, name: str, value: Scalar) -> tuple[str, int, int]:
        """Signal, mask (0: all bits) and shifted bits."""
        half = self._endpoint.telegrams[axis].setpoints
        key = word(name, half.telegram).key if name.islower() else name
        signal_name, bit = self._resolve(key, half)
        raw = raw_value(self._references, half.signal(signal_name), value)
        if bit is None:
            half.encode(half.from_dict({signal_name: raw}))
            return signal_name, 0, raw
        highest = bit.mask >> bit.position
        lowest = -(highest // 2) - 1 if bit.signed else 0
        if not lowest <= raw <= highest:
            raise GatewayError(f"{name} = {value!r}: expected {lowest}..{highest}")
        return signal_name, bit.mask, (raw & highest) << bit.position

    def _expectation(self, axis: int, values: dict[str, Scalar], within: int, name: str) -> Expectation:
        half = self._endpoint.telegrams[axis].actuals
        conditions = []
        for key, wanted in values.items():
            signal_name, bit = self._resolve(key, half)
            item = half.signal(signal_name)
            holds = expected(self._references, item, wanted)
            mask, shift = (0, 0) if bit is None else (bit.mask, bit.position)
            write = partial(written, self._references, item, str(wanted))
            conditions.append(Condition(key, str(wanted), holds, mask, shift, signal_name, write))
        text = ", ".join(f"{c.name} {c.text}" for c in conditions)
        return Expectation(conditions, f"{name}: {text}" if name else text, axis, within)

    @staticmethod
    def _resolve(key: str, half: TelegramHalf) -> tuple[str, Bit | None]:
        signal_name, _, bit_name = key.partition(".")
        if signal_name not in half.names:
            hint = did_you_mean(signal_name, half.names)
            raise GatewayError(
                f"signal {signal_name!r} is not in the telegram{hint} (allowed: {', '.join(half.names)})"
            )
        if not bit_name:
            return signal_name, None
        positioning = half.mode is ApplicationMode.POSITIONING
        item = half.signal(signal_name)
        try:
            return signal_name, item.bit(bit_name, positioning=positioning)
        except ProfidriveError as error:
            names = [bit.name for bit in item.fields(positioning=positioning)]
            hint = did_you_mean(bit_name, names)
            raise GatewayError(f"{key}: not a bit of {signal_name}{hint} (allowed: {', '.join(names)})") from error


def _speed_setpoint(chosen: Telegram) -> str:
    for item in chosen.setpoints.signals:
        if item.quantity is SignalQuantity.SPEED and item.percent(1) is not None:
            return item.name
    raise GatewayError(f"not possible with telegram {chosen.number}: it has no speed setpoint")
