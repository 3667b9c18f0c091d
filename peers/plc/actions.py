"""The program of each action of a scenario: setpoints to set, actual values to wait for, pauses.

Source: docs/motion.md; for sensors "Reference marks and measurement on the fly". Values of a positioner (telegrams 7, 110, 111,
112) are length units (LU) and 1000 LU/min; for telegram 112 they have the configured unit of length. ``scenario.Step`` declares
each action with its program.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, NamedTuple, Protocol

from pydantic import BaseModel, ConfigDict, Field

from pdgw.base.durations import MS
from pdgw.gateway.axis.telegrams import POSITIONER_TELEGRAM_NUMBERS, SPEED_TELEGRAM_NUMBERS, TASK_TELEGRAM_NUMBERS
from pdgw.gateway.base.errors import GatewayError
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.exchange.following import Follow, can_follow
from pdgw.peers.plc.notation import Scalar
from pdgw.profidrive.signals import SignalQuantity
from pdgw.profidrive.telegrams import TELEGRAMS, Telegram


class Set(NamedTuple):
    """Setpoints by signal or ``signal.bit``, all in one frame. ``if_zero``: setpoints to set only if they are 0."""

    values: Mapping[str, Scalar]
    if_zero: Mapping[str, Scalar] = MappingProxyType({})


class Wait(NamedTuple):
    """Actual values to wait for. ``name``: of the result, by default the note of the step."""

    values: Mapping[str, Scalar]
    name: str = ""


class Access(NamedTuple):
    """Parameters to read until they have these values, or to write."""

    values: Mapping[str, Scalar]
    write: bool


class Ordered(Protocol):
    """The part of an engine that an order changes."""

    endpoint: PlcEndpoint
    muted: bool
    drive: Callable[[str], object]


Order = Callable[[Ordered, int], object]
"""A change of the engine or its endpoint; the integer is the axis, from 0."""
Program = Sequence[Set | Wait | Access | Follow | Order | int]
"""An integer is a pause in nanoseconds."""
Action = Callable[[Telegram, Any], Program]
"""The program for a telegram and the value in the scenario; GatewayError when it is not possible with the telegram."""

_PULSE_NS: Final = 100 * MS
"""Time for which a bit with a counting edge stays set, at any cycle time."""
_FULL: Final = "100 %"
_DEFAULT_VELOCITY: Final = 3000


class Model(BaseModel):
    """A value with keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _impossible(chosen: Telegram, numbers: Iterable[int]) -> GatewayError:
    return GatewayError(f"not possible with telegram {chosen.number}, only with {', '.join(map(str, sorted(numbers)))}")


def _one_of(chosen: Telegram, *names: str, what: str = "") -> str:
    """The first of these setpoints that the telegram has."""
    for name in names:
        if name in chosen.setpoints.names:
            return name
    raise GatewayError(f"{what}not possible with telegram {chosen.number}: it has no {' or '.join(names)}")


def _by(**programs: Program) -> Action:
    """The program of the first of these setpoints that the telegram has."""

    def program(chosen: Telegram, _: object) -> Program:
        for name, found in programs.items():
            if name in chosen.setpoints.names:
                return found
        raise _impossible(chosen, (n for n, item in TELEGRAMS.items() if programs.keys() & {*item.setpoints.names}))

    return program


def _only(*numbers: int) -> Callable[[Action], Action]:
    """Mark a program as possible only with these telegrams."""

    def marked(program: Action) -> Action:
        def checked(chosen: Telegram, value: object) -> Program:
            if chosen.number not in numbers:
                raise _impossible(chosen, numbers)
            return program(chosen, value)

        return checked

    return marked


_positioner = _only(*POSITIONER_TELEGRAM_NUMBERS)
_with_tasks = _only(*TASK_TELEGRAM_NUMBERS)


def _bit(name: str, value: int = 0) -> Action:
    """One bit of the telegrams with traversing tasks."""
    return _with_tasks(lambda *_: [Set({name: value})])


def order(change: Callable[[Ordered, Any], object]) -> Action:
    """A change of the engine by the value in the scenario."""
    return lambda _, value: [lambda engine, _: change(engine, value)]


# -- power and faults -------------------------------------------------------------------------------------------------


def _off_on(off: int) -> Program:
    return [
        Set({"STW1": off}),
        Wait({"ZSW1.READY_TO_SWITCH_ON": 1, "ZSW1.SWITCHING_ON_INHIBITED": 0}, "ready"),
        Set({"STW1": off | 1}),
        Wait({"ZSW1.OPERATION_ENABLED": 1}, "operation enabled"),
    ]


enable = _by(
    SATZANW=_off_on(0x043E),
    POS_STW1=_off_on(0x043E),
    STW1=_off_on(0x047E),
    Controlword=[
        part
        for word, status in ((0x06, "& 0x6F = 0x21"), (0x07, "& 0x6F = 0x23"), (0x0F, "& 0x6F = 0x27"))
        for part in (Set({"Controlword": word}), Wait({"Statusword": status}, f"Controlword {word:02X}h executed"))
    ],
    STW2_ENC=[
        Set({"STW2_ENC.CONTROL_BY_PLC": 1}),
        Wait({"ZSW2_ENC.CONTROL_REQUESTED": 1, "ZSW2_ENC.FAULT": 0, "G1_ZSW.ERROR": 0}, "measuring"),
    ],
)
off1 = _by(STW1=[Set({"STW1.ON": 0})], Controlword=[Set({"Controlword": 0x0006})])
quick_stop = _by(STW1=[Set({"STW1.NO_QUICK_STOP": 0})], Controlword=[Set({"Controlword": 0x0002})])
coast = _by(STW1=[Set({"STW1.NO_COAST_STOP": 0})], Controlword=[Set({"Controlword": 0x0000})])
_ENCODER_BITS = ("STW2_ENC.FAULT_ACKNOWLEDGE", "G1_STW.ERROR_ACKNOWLEDGE")
ack = _by(
    STW1=[
        Set({"STW1.ON": 0, "STW1.FAULT_ACKNOWLEDGE": 1}),
        Wait({"ZSW1.FAULT": 0}, "fault acknowledged"),
        Set({"STW1.FAULT_ACKNOWLEDGE": 0}),
    ],
    Controlword=[
        Set({"Controlword": 0x80}),
        Wait({"Statusword": "& 0x4F = 0x40"}, "fault reset"),
        Set({"Controlword": 0}),
    ],
    STW2_ENC=[
        Set(dict.fromkeys(_ENCODER_BITS, 1)),
        Wait({"ZSW2_ENC.FAULT": 0}, "fault acknowledged"),
        Set(dict.fromkeys(_ENCODER_BITS, 0)),
        Wait({"G1_ZSW.ERROR": 0}, "measuring again"),
    ],
)


# -- speed and position loop ------------------------------------------------------------------------------------------


def _speed_setpoint(chosen: Telegram) -> str:
    for item in chosen.setpoints.signals:
        if item.quantity is SignalQuantity.SPEED and item.percent(1) is not None:
            return item.name
    raise GatewayError(f"not possible with telegram {chosen.number}: it has no speed setpoint")


def speed(chosen: Telegram, value: Scalar) -> Program:
    """The speed setpoint. A plain number would be a raw value, and is an error."""
    name, text = _speed_setpoint(chosen), str(value).strip()
    if text.isascii() and text.removeprefix("-").replace(".", "", 1).isdigit() and float(text):
        raise GatewayError(
            f'speed = {text}: the unit is missing: "{text} rpm" or "{text} %"; raw values: set: {{{name}: {text}}}'
        )
    return [Set({name: value})]


def follow(chosen: Telegram, wish: Follow) -> Program:
    """The closed position loop."""
    if not can_follow(chosen, dsc=wish.dsc):
        raise _impossible(chosen, (number for number, item in TELEGRAMS.items() if can_follow(item, dsc=wish.dsc)))
    return [wish]


def sign_of_life(chosen: Telegram, counts: bool) -> Program:
    """Start or stop the counter in the first word that has one."""
    words = [(item.name, bit) for item in chosen.setpoints.signals for bit in item.bits if bit.name == "SIGN_OF_LIFE"]
    if not words:
        raise GatewayError(f"not possible with telegram {chosen.number}: it has no sign of life")
    name, bit = words[0]
    return [lambda engine, axis: engine.endpoint.count(axis, name, bit if counts else None)]


# -- traversing tasks -------------------------------------------------------------------------------------------------

_READY = {"STW1.DO_NOT_REJECT": 1, "STW1.NO_INTERMEDIATE_STOP": 1}


class Move(Model):
    """A traversing task of telegram 9."""

    to: Scalar
    velocity: Scalar = "50 %"
    acc: Scalar = "50 %"
    dec: Scalar = "50 %"
    relative: bool = False


class Home(Model):
    """A homing procedure. ``method`` and ``velocity`` are of telegram 9, ``passive`` and ``negative`` of telegram 111."""

    method: int = 35
    velocity: Scalar = "20 %"
    passive: bool = False
    negative: bool = False


class Mdi(Model):
    """``mdi``: a task with position and velocity. ``update``: STW1.6 stays set, and further ``mdi`` steps change the active
    task.

    ``velocity``: default 3000 (1000 LU/min); telegram 112 needs it. ``direction``: for a modulo axis.
    """

    to: int | float
    velocity: Annotated[int | float | None, Field(ge=0)] = None
    acceleration: int | str = _FULL
    deceleration: int | str = _FULL
    relative: bool = False
    update: bool = False
    direction: Literal["positive", "negative"] | None = None


class SettingUp(Model):
    """``setting_up``: move with a signed velocity until a reject."""

    velocity: int | float


def _override(chosen: Telegram) -> dict[str, Scalar]:
    return {"OVERRIDE": _FULL} if "OVERRIDE" in chosen.setpoints.names else {}


def _task(chosen: Telegram, values: Mapping[str, Scalar], *, update: bool = False) -> Program:
    """Data and edge in one frame. STW1.6 falls when the task is acknowledged, except with ``update``.

    The override becomes 100 % if it is not given.
    """
    begun: list[Set | Wait] = [
        Set({**values, **_READY, "STW1.ACTIVATE_TASK": 1}, _override(chosen)),
        Wait({"ZSW1.TASK_ACKNOWLEDGE": 1}, "task acknowledged"),
    ]
    if update:
        return begun
    return [*begun, Set({"STW1.ACTIVATE_TASK": 0}), Wait({"ZSW1.TASK_ACKNOWLEDGE": 0}, "ready for the next task")]


def move(chosen: Telegram, task: Move) -> Program:
    """A task of telegram 9."""
    values: dict[str, Scalar] = {
        "SATZANW.MDI": 1,
        "MDI_TARPOS": task.to,
        "MDI_VELOCITY": task.velocity,
        "MDI_ACC": task.acc,
        "MDI_DEC": task.dec,
        "MDI_MOD.ABSOLUTE": int(not task.relative),
    }
    return _task(chosen, values)


def _selection(chosen: Telegram) -> str:
    """The word that selects MDI or a block."""
    return _one_of(chosen, "POS_STW1", "SATZANW")


def _mdi_mode(chosen: Telegram, direction: str | None, *, absolute: bool) -> dict[str, Scalar]:
    word = _selection(chosen)
    mode = word if word == "POS_STW1" else "MDI_MOD"
    return {
        f"{mode}.ABSOLUTE": int(absolute),
        f"{mode}.POSITIVE_DIRECTION": int(direction == "positive"),
        f"{mode}.NEGATIVE_DIRECTION": int(direction == "negative"),
        f"{word}.MDI": 1,
    }


@_positioner
def mdi(chosen: Telegram, task: Mdi) -> Program:
    """A task with position and velocity."""
    form = _one_of(chosen, "MDI_TARPOS", "MDI_TARPOS_F").removeprefix("MDI_TARPOS")
    if task.velocity is None and form:
        raise GatewayError(
            f"mdi.velocity is missing: telegram {chosen.number} needs it in the gateway's unit of length"
        )
    values: dict[str, Scalar] = {
        **_mdi_mode(chosen, task.direction, absolute=not task.relative),
        f"MDI_TARPOS{form}": task.to,
        f"MDI_VELOCITY{form}": _DEFAULT_VELOCITY if task.velocity is None else task.velocity,
        f"MDI_ACC{form}": task.acceleration,
        f"MDI_DEC{form}": task.deceleration,
    }
    if _selection(chosen) == "POS_STW1":
        values |= {"POS_STW1.SETTING_UP": 0, "POS_STW1.CONTINUOUS_UPDATE": int(task.update)}
    elif task.update:
        _one_of(chosen, "POS_STW1", what="update is ")
    return _task(chosen, values, update=task.update)


@_positioner
def setting_up(chosen: Telegram, wish: SettingUp) -> Program:
    """A motion with a signed velocity."""
    form = "_F" if "MDI_TARPOS_F" in chosen.setpoints.names else ""
    _one_of(chosen, "POS_STW1")
    values: dict[str, Scalar] = {
        **_mdi_mode(chosen, "positive" if wish.velocity > 0 else "negative", absolute=False),
        f"MDI_VELOCITY{form}": abs(wish.velocity),
        f"MDI_ACC{form}": _FULL,
        f"MDI_DEC{form}": _FULL,
        "POS_STW1.SETTING_UP": 1,
        "POS_STW1.CONTINUOUS_UPDATE": 0,
    }
    return _task(chosen, values)


@_positioner
def block(chosen: Telegram, number: int) -> Program:
    """A traversing block."""
    word = _selection(chosen)
    return _task(chosen, {f"{word}.BLOCK": number, f"{word}.MDI": 0})


def _jog_values(which: int) -> dict[str, Scalar]:
    return {"STW1.JOG_1_ON": int(which == 1), "STW1.JOG_2_ON": int(which == 2)}


@_only(*SPEED_TELEGRAM_NUMBERS, *POSITIONER_TELEGRAM_NUMBERS)
def jog(chosen: Telegram, which: int) -> Program:
    """The end of a jog with a speed telegram sets speed 0, so that the axis does not turn with an earlier setpoint."""
    if chosen.number in SPEED_TELEGRAM_NUMBERS:
        ramp = ("STW1.ENABLE_RAMP_GENERATOR", "STW1.UNFREEZE_RAMP_GENERATOR", "STW1.ENABLE_SETPOINT")
        return [Set({_speed_setpoint(chosen): 0, **dict.fromkeys(ramp, int(not which)), **_jog_values(which)})]
    values = {**_READY, **_jog_values(which)}
    for word in {"POS_STW2", "POS_STW"} & {*chosen.setpoints.names}:
        values[f"{word}.JOG_INCREMENTAL"] = 0
    return [Set(values)]


@_positioner
def jog_distance(chosen: Telegram, which: int) -> Program:
    """An incremental jog."""
    word = _one_of(chosen, "POS_STW2", "POS_STW")
    return [Set({**_READY, **_jog_values(which), f"{word}.JOG_INCREMENTAL": 1}, _override(chosen))]


@_positioner
def set_reference(chosen: Telegram, _: object) -> Program:
    """Set the reference point."""
    bit = f"{_one_of(chosen, 'POS_STW2', 'POS_STW')}.SET_REFERENCE_POINT"
    return [Set({bit: 1}), _PULSE_NS, Wait({"ZSW1.HOME_POSITION_SET": 1}, "reference point set"), Set({bit: 0})]


@_with_tasks
def home(chosen: Telegram, wish: Home) -> Program:
    """Homing, active or passive (waits for the probe's edge). Except with telegram 9 the configuration has method and speeds."""
    start = {"STW1.START_HOMING": 1}
    bits = {"POS_STW2.PASSIVE_HOMING": wish.passive, "POS_STW2.HOMING_NEGATIVE": wish.negative}
    if chosen.number in POSITIONER_TELEGRAM_NUMBERS:
        for name in sorted({"method", "velocity"} & wish.model_fields_set):
            raise GatewayError(
                f"home.{name} is allowed only with telegram 9; with other telegrams the configuration sets it"
            )
    if "POS_STW2" in chosen.setpoints.names:
        return [Set({**{name: int(on) for name, on in bits.items()}, **start})]
    if any(bits.values()):
        _one_of(chosen, "POS_STW2", what="passive and negative are ")
    if chosen.number in POSITIONER_TELEGRAM_NUMBERS:
        return [Set(start)]
    method = {"SATZANW.HOMING_METHOD": wish.method & 0xFF, "MDI_VELOCITY": wish.velocity}
    return [Set(method), Set({"SATZANW.MDI": 1, **start})]


next_block = _positioner(
    lambda *_: [Set({"STW1.EXTERNAL_BLOCK_CHANGE": 1}), _PULSE_NS, Set({"STW1.EXTERNAL_BLOCK_CHANGE": 0})]
)
stop_homing = _bit("STW1.START_HOMING")
reject = _bit("STW1.DO_NOT_REJECT")
intermediate_stop = _bit("STW1.NO_INTERMEDIATE_STOP")
resume = _bit("STW1.NO_INTERMEDIATE_STOP", 1)


# -- sensors ----------------------------------------------------------------------------------------------------------

Function = Annotated[int, Field(ge=1, le=4)]
_NONE, _ACTIVATE, _READ, _ABORT = range(4)
"""Gn_STW.COMMAND."""


class Reading(Model):
    """``read_value``: of a function with a stored value."""

    sensor: Literal[1, 2] = 1
    function: Function = 1


class Measuring(Reading):
    """``measure``: one function. ``also`` has further ones, because a second step would abort the first."""

    also: tuple[Function, ...] = ()


def _command(chosen: Telegram, sensor: int, command: int, functions: Iterable[int], **bits: int) -> Program:
    """Send a command. It takes effect on a change, so the previous one is removed first."""
    word = _one_of(chosen, f"G{sensor}_STW")
    values = {f"FUNCTION_{number}": int(number in functions) for number in range(1, 5)} | bits
    return [
        Set({f"{word}.COMMAND": _NONE}),
        _PULSE_NS,
        Set({**{f"{word}.{name}": value for name, value in values.items()}, f"{word}.COMMAND": command}),
        _PULSE_NS,
    ]


def reference_mark(chosen: Telegram, sensor: int) -> Program:
    """Search the zero pulse."""
    return _command(chosen, sensor, _ACTIVATE, {1}, MODE=0)


def measure(chosen: Telegram, wish: Measuring) -> Program:
    """Measure positions at edges of the probes."""
    return _command(chosen, wish.sensor, _ACTIVATE, {wish.function, *wish.also}, MODE=1)


def read_value(chosen: Telegram, wish: Reading) -> Program:
    """Read a stored value; it stays in Gn_XIST2."""
    found = Wait({f"G{wish.sensor}_ZSW.VALUE_{wish.function}": 1}, f"value of function {wish.function}")
    return [found, *_command(chosen, wish.sensor, _READ, {wish.function})]


def stop_measuring(chosen: Telegram, sensor: int) -> Program:
    """Abort all searches and measurements."""
    return [*_command(chosen, sensor, _ABORT, range(1, 5)), Set({f"G{sensor}_STW.COMMAND": _NONE})]


def preset(_: Telegram, kind: str) -> Program:
    """Preset of an encoder."""
    return [
        Set({"G1_STW.PRESET_RELATIVE": int(kind == "relative"), "G1_STW.PRESET": 1}),
        Wait({"G1_ZSW.PRESET_DONE": 1, "G1_ZSW.ERROR": 0}, "preset done"),
        Set({"G1_STW.PRESET": 0}),
        Wait({"G1_ZSW.PRESET_DONE": 0}, "ready for the next preset"),
    ]
