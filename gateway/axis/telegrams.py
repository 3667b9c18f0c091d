"""Which adapter, PDO layout and start mode belong to a telegram, and which kind of executor carries it out."""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Final

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation, PdoLayout, with_second_position, without_position
from pdgw.gateway.axis.adapters.adapter import Adapter
from pdgw.gateway.axis.adapters.position_words import BasicPositionerAdapter, PositioningAdapter
from pdgw.gateway.axis.adapters.speed_words import DscAdapter, SpeedAdapter
from pdgw.gateway.axis.adapters.transparent import TransparentAdapter
from pdgw.gateway.axis.settings import AxisSettings, SecondSensor
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.motion.dsc_setpoint import DscForm
from pdgw.profidrive.signals import USER_WORDS, SignalQuantity
from pdgw.profidrive.telegrams import (
    TELEGRAMS,
    ApplicationClass,
    ApplicationMode,
    Direction,
    Telegram,
    TelegramHalf,
    own_telegram,
    register,
    telegram,
)


class Kind(enum.Enum):
    """The executor of a telegram."""

    SPEED = "speed"
    TORQUE = "speed with torque reduction"
    LOAD = "speed with actual values of the motor"
    DSC = "dynamic servo control"
    POSITIONING = "positioning"
    POSITIONER = "positioner"
    RAW = "raw"


@dataclass(frozen=True, slots=True)
class DriveTelegram:
    """``initial_mode``: 6060h to set while configuring, None where the telegram's RPDO carries the mode."""

    kind: Kind
    operation: Operation
    initial_mode: Mode | None = None


_SPEED = DriveTelegram(Kind.SPEED, Operation.VELOCITY, Mode.VELOCITY)
_SPEED_AND_SENSOR = DriveTelegram(Kind.SPEED, Operation.VELOCITY_WITH_POSITION, Mode.VELOCITY)
_SPEED_AND_TORQUE = DriveTelegram(Kind.TORQUE, Operation.VELOCITY_WITH_TORQUE, Mode.VELOCITY)
_DSC = DriveTelegram(Kind.DSC, Operation.CYCLIC_VELOCITY, Mode.CYCLIC_VELOCITY)
_DSC_BY_POSITION = DriveTelegram(Kind.DSC, Operation.CYCLIC_POSITION, Mode.CYCLIC_POSITION)
_POSITIONER = DriveTelegram(Kind.POSITIONER, Operation.POSITIONER)
DRIVE_TELEGRAMS: Final[Mapping[int, DriveTelegram]] = {
    1: _SPEED,
    2: _SPEED,
    3: _SPEED_AND_SENSOR,
    4: _SPEED_AND_SENSOR,
    5: _DSC,
    6: _DSC,
    7: _POSITIONER,
    9: DriveTelegram(Kind.POSITIONING, Operation.POSITIONING),
    20: DriveTelegram(Kind.LOAD, Operation.VELOCITY_WITH_LOAD, Mode.VELOCITY),
    100: DriveTelegram(Kind.RAW, Operation.TRANSPARENT),
    102: _SPEED_AND_TORQUE,
    103: _SPEED_AND_TORQUE,
    105: _DSC,
    106: _DSC,
    110: _POSITIONER,
    111: _POSITIONER,
    112: _POSITIONER,
}


def _telegrams(having: Callable[[Telegram], bool]) -> tuple[int, ...]:
    """The numbers of the drive telegrams with a property."""
    return tuple(number for number in DRIVE_TELEGRAMS if having(telegram(number)))


def _is(*kinds: Kind) -> Callable[[Telegram], bool]:
    return lambda chosen: DRIVE_TELEGRAMS[chosen.base].kind in kinds


# Of a user's own telegram, ``Telegram.base`` is among these numbers.
DRIVE_TELEGRAM_NUMBERS: Final = tuple(DRIVE_TELEGRAMS)
"""The telegrams a drive axis can be given (P922)."""
DSC_TELEGRAM_NUMBERS: Final = _telegrams(_is(Kind.DSC))
"""Telegrams that need to know where the loop is closed."""
CENTRAL_TELEGRAM_NUMBERS: Final = _telegrams(lambda chosen: ApplicationClass.CENTRAL in chosen.classes)
"""Telegrams in which the PLC may close the position loop: with SYNC, their setpoints take effect at the SYNC too."""
POSITIONER_TELEGRAM_NUMBERS: Final = _telegrams(_is(Kind.POSITIONER))
"""Those of them that need a positioner in the configuration."""
FLOAT_TELEGRAM_NUMBERS: Final = tuple(
    number
    for number in POSITIONER_TELEGRAM_NUMBERS
    if any(item.is_float for item in telegram(number).setpoints.signals)
)
"""Those of them with positions in a unit of the user's choice."""
SPEED_TELEGRAM_NUMBERS: Final = _telegrams(_is(Kind.SPEED, Kind.TORQUE, Kind.LOAD))
"""Those of them that jog with speeds of their own."""
TASK_TELEGRAM_NUMBERS: Final = _telegrams(_is(Kind.POSITIONER, Kind.POSITIONING))
"""Those of them with traversing tasks."""
ENCODER_TELEGRAM_NUMBERS: Final = tuple(
    sorted(number for number, item in TELEGRAMS.items() if item.mode is ApplicationMode.ENCODER)
)
"""The telegrams an encoder can be given (P922)."""


def drive_telegrams(known: Iterable[Telegram] = TELEGRAMS.values()) -> dict[int, Telegram]:
    """Those of the known telegrams that a drive axis can be given, by their numbers in order."""
    return {item.number: item for item in sorted(known, key=attrgetter("number")) if item.base in DRIVE_TELEGRAMS}


def may_have_own_encoder(chosen: Telegram) -> bool:
    """Whether G1 may be an encoder of its own: the drive's position is needed for nothing else.

    XERR of DSC counts in G1, and its loop is closed with the drive's position.
    """
    return chosen.base not in DSC_TELEGRAM_NUMBERS and "G1_STW" in chosen.setpoints.names


def has_second_sensor(chosen: Telegram) -> bool:
    """Whether it has the words of G2."""
    return "G2_STW" in chosen.setpoints.names


SECOND_SENSOR_NUMBERS: Final = _telegrams(has_second_sensor)
_LIKE: Final = (*SPEED_TELEGRAM_NUMBERS, *DSC_TELEGRAM_NUMBERS)
_FILLERS: Final = frozenset({*USER_WORDS, "RESERVED", "RESERVED_2"})
_PAIRS: Final = (("STW2", "ZSW2"), ("G1_STW", "G1_ZSW"), ("G2_STW", "G2_ZSW"))
"""A control word and the status word that answers it."""


def own_drive_telegram(number: int, like: int, setpoints: Sequence[str], actuals: Sequence[str]) -> Telegram:
    """A user's own telegram, with the signals of both directions by name.

    It is carried out as telegram ``like`` is. It needs the speed of ``like`` and the signals that all telegrams carried out
    so have, and may have those that one of them has, STW2 with ZSW2, and fillers. GatewayError or ProfidriveError says what
    does not fit.
    """
    if like not in _LIKE:
        raise GatewayError(f"like = {like}: a telegram of your own can be like one of {sorted(_LIKE)}")
    model = telegram(like)
    own = own_telegram(number, model, setpoints, actuals)
    family = [telegram(item) for item in _LIKE if DRIVE_TELEGRAMS[item] is DRIVE_TELEGRAMS[like]]
    for direction, life in ((Direction.SETPOINT, "STW2"), (Direction.ACTUAL, "ZSW2")):
        others = [other.half(direction) for other in family]
        _check_half(own.half(direction), model.half(direction), others, _FILLERS | {life})
    for control, status in _PAIRS:
        if (control in own.setpoints.names) != (status in own.actuals.names):
            raise GatewayError(f"telegram {number}: {control} and {status} belong together: set both or none")
    make_adapter(own, AxisSettings())
    return own


def add_telegram(number: int, like: int, setpoints: Sequence[str], actuals: Sequence[str]) -> Telegram:
    """As ``own_drive_telegram``, and known to this process from then on. For programs: a configuration has its own ones."""
    own = own_drive_telegram(number, like, setpoints, actuals)
    register(own)
    return own


def _check_half(
    own: TelegramHalf, model: TelegramHalf, others: Sequence[TelegramHalf], optional: frozenset[str]
) -> None:
    """Compare one direction of a user's own telegram with those that are carried out alike; GatewayError if it does not fit."""
    names, halves = set(own.names), [set(other.names) for other in others]
    speeds = {item.name for item in model.signals if item.quantity is SignalQuantity.SPEED}
    needed, known = set.intersection(*halves) | speeds, set.union(*halves) | optional
    where, like = f"telegram {own.telegram}, {own.direction.value}s", f"a telegram like {model.telegram}"
    if missing := needed - names:
        raise GatewayError(f"{where}: {_listed(missing)} missing; {like} needs {_listed(needed)}")
    if impossible := names - known:
        raise GatewayError(f"{where}: {like} cannot have {_listed(impossible)}; possible: {_listed(known)}")
    first = model.names[0]
    if own.names[0] != first:
        raise GatewayError(f"{where}: {first} must come first, as in every telegram with a control word")


def _listed(names: set[str]) -> str:
    return ", ".join(sorted(names))


def drive_telegram(chosen: Telegram, form: DscForm = DscForm.SPEED) -> DriveTelegram:
    """The row of a drive telegram; ``form`` where DSC is carried out. GatewayError for one that no drive axis supports."""
    try:
        row = DRIVE_TELEGRAMS[chosen.base]
        return _DSC_BY_POSITION if row is _DSC and form is DscForm.POSITION else row
    except KeyError:
        raise GatewayError(
            f"telegram: {chosen.number} is not supported for a drive, allowed {list(DRIVE_TELEGRAM_NUMBERS)}"
        ) from None


def make_adapter(chosen: Telegram, settings: AxisSettings) -> Adapter:
    """The adapter of a drive telegram; GatewayError for one that no drive axis supports, or with a signal that is not served."""
    adapter = _adapter(drive_telegram(chosen).kind, chosen, settings)
    adapter.check()
    return adapter


def _adapter(kind: Kind, chosen: Telegram, settings: AxisSettings) -> Adapter:
    if kind is Kind.DSC:
        return DscAdapter(chosen, settings)
    if kind in (Kind.SPEED, Kind.LOAD, Kind.TORQUE):
        return SpeedAdapter(chosen, settings)
    if kind is Kind.POSITIONING:
        return PositioningAdapter(chosen, settings)
    if kind is Kind.POSITIONER:
        return BasicPositionerAdapter(chosen, settings)
    return TransparentAdapter(chosen)


def drive_layout(
    chosen: Telegram,
    form: DscForm = DscForm.SPEED,
    second: SecondSensor = SecondSensor.NONE,
    *,
    g1_is_encoder: bool = False,
) -> PdoLayout:
    """PDOs of a drive telegram; ``second``: source of its G2, ``g1_is_encoder``: G1 is an external encoder."""
    row = drive_telegram(chosen, form)
    layout = LAYOUTS[row.operation]
    if second is SecondSensor.DRIVE and has_second_sensor(chosen):
        layout = with_second_position(layout)
    return without_position(layout) if g1_is_encoder and may_have_own_encoder(chosen) else layout


def initial_mode(chosen: Telegram, form: DscForm = DscForm.SPEED) -> Mode | None:
    """6060h to set while configuring, None where the telegram's RPDO carries the mode."""
    return drive_telegram(chosen, form).initial_mode
