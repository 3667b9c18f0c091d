"""Telegrams 1-4, 20, 102 and 103: STW1, ZSW1 and a speed; MOMRED where they have it.

Source: docs/telegrams.md, docs/translation.md "Standard telegrams" 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Final

from pdgw.gateway.axis.adapters.adapter import ControlWordAdapter
from pdgw.gateway.axis.demand_report import Report, SpeedDemand, SpeedWish
from pdgw.gateway.axis.settings import AxisSettings, SetpointEnable
from pdgw.profidrive.datatypes import N4_PER_N2, DataType
from pdgw.profidrive.signals import SignalQuantity, signal
from pdgw.profidrive.telegrams import Telegram, TelegramHalf

_STW1: Final = signal("STW1")
DEVICE_BITS: Final = sum(_STW1.bit(f"DEVICE_{number}").mask for number in (12, 13, 14, 15))
_RUN: Final = _STW1.bit("ENABLE_RAMP_GENERATOR").mask | _STW1.bit("ENABLE_SETPOINT").mask
_FOLLOW: Final = _RUN | _STW1.bit("UNFREEZE_RAMP_GENERATOR").mask
_FOLLOW_SPEED: Final = SpeedWish.FOLLOW
_JOG_1, _JOG_2 = _STW1.bit("JOG_1_ON").mask, _STW1.bit("JOG_2_ON").mask
_JOGS: Final = {_JOG_1: SpeedWish.JOG_1, _JOG_2: SpeedWish.JOG_2}
"""With STW1.4 to .6 = 0; both bits are speed 0."""


class SpeedAdapter(ControlWordAdapter):
    """Words by name; an N2 is promoted to the demand's N4 and a report's N4 truncated toward zero, as N2 itself is."""

    IGNORED: ClassVar[int] = _STW1.bit("DEVICE_11").mask

    def __init__(self, telegram: Telegram, settings: AxisSettings) -> None:
        self._asked = SpeedDemand()
        super().__init__(telegram, settings, self._asked)
        setpoint, self._setpoint_shift = _speed_signal(telegram.setpoints)
        actual, self._actual_shift = _speed_signal(telegram.actuals)
        self._setpoint, self._actual = self.setpoint(setpoint), self.actual(actual)
        self._torque = self.setpoint("MOMRED")
        self._profidrive = settings.setpoint_enable is SetpointEnable.PROFIDRIVE
        self._jogs = self._profidrive and settings.jog_speeds_rpm is not None

    def read(self, setpoints: Sequence[int] | None) -> None:
        word, demand = None if setpoints is None else setpoints[self.stw1], self._asked
        if word != self.word:
            self._evaluate(word, demand)
        if setpoints is not None and demand.in_control:
            if demand.speed_wish is _FOLLOW_SPEED:
                demand.speed = setpoints[self._setpoint] << self._setpoint_shift
            if self._torque >= 0:
                demand.torque_reduction = setpoints[self._torque]

    def _evaluate(self, word: int | None, demand: SpeedDemand) -> None:
        if word is None:
            demand.device_bits = 0
        if not self.take(word) or word is None:
            return
        demand.device_bits = word & DEVICE_BITS
        demand.jogs = jogs = 0 if word & _FOLLOW else word & (_JOG_1 | _JOG_2)
        if word & _FOLLOW == _FOLLOW:
            demand.speed_wish = _FOLLOW_SPEED
        elif self._jogs and not word & _FOLLOW:
            demand.speed_wish = _JOGS.get(jogs, SpeedWish.ZERO)
        elif self._profidrive and word & _RUN != _RUN:
            demand.speed_wish = SpeedWish.ZERO
        else:
            demand.speed_wish = SpeedWish.FREEZE if self._profidrive else SpeedWish.HOLD

    def write(self, flags: int, report: Report, actuals: list[int]) -> None:
        actuals[self.zsw1] = self.status(flags)
        speed, shift = report.speed, self._actual_shift
        actuals[self._actual] = speed >> shift if speed >= 0 else -(-speed >> shift)


class DscAdapter(SpeedAdapter):
    """Telegrams 5, 6, 105 and 106: the speed is in force whatever STW1.4 to .6 are, unless .5 alone is 0 (freeze)."""

    def __init__(self, telegram: Telegram, settings: AxisSettings) -> None:
        super().__init__(telegram, settings)
        self._xerr = self.setpoint("XERR")
        self._kpc = self.setpoint("KPC")

    def read(self, setpoints: Sequence[int] | None) -> None:
        super().read(setpoints)
        demand = self._asked
        if setpoints is not None and demand.in_control:
            demand.speed = setpoints[self._setpoint] << self._setpoint_shift
            demand.position_error = setpoints[self._xerr], setpoints[self._kpc]


def _speed_signal(half: TelegramHalf) -> tuple[str, int]:
    """The name of the speed, and the place of its lowest bit in an N4."""
    item = next(item for item in half.signals if item.quantity is SignalQuantity.SPEED)
    return item.name, N4_PER_N2.bit_length() - 1 if item.type is DataType.N2 else 0
