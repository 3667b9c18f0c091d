"""Interface of the adapters of a drive's telegram, and the meaning of STW1 in all telegrams that have it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Final

from pdgw.gateway.axis.demand_report import Demand, Flag, PowerWish, Report
from pdgw.gateway.axis.settings import AxisSettings, ControlLost
from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.signals import USER_WORDS, signal
from pdgw.profidrive.telegrams import Telegram, TelegramHalf

_STW1: Final = signal("STW1")
_NO_COAST_STOP: Final = _STW1.bit("NO_COAST_STOP").mask
_NO_QUICK_STOP: Final = _STW1.bit("NO_QUICK_STOP").mask
_ON: Final = _STW1.bit("ON").mask
_ENABLE_OPERATION: Final = _STW1.bit("ENABLE_OPERATION").mask
_CONTROL_BY_PLC: Final = _STW1.bit("CONTROL_BY_PLC").mask
_FAULT_ACKNOWLEDGE: Final = _STW1.bit("FAULT_ACKNOWLEDGE").mask
POWER_BITS: Final = _ON | _NO_COAST_STOP | _NO_QUICK_STOP | _ENABLE_OPERATION
"""Bits 0-3 of STW1 and of the Controlword."""


def _wish(word: int) -> PowerWish:
    enables = word & _ENABLE_OPERATION != 0
    if not word & _NO_COAST_STOP:
        return PowerWish.COAST
    if not word & _NO_QUICK_STOP:
        return PowerWish.QUICK_STOP if enables else PowerWish.QUICK_STOP_DISABLED
    if not word & _ON:
        return PowerWish.OFF if enables else PowerWish.OFF_DISABLED
    return PowerWish.ENABLE if enables else PowerWish.ON


WISHES: Final = tuple(_wish(word) for word in range(POWER_BITS + 1))
"""The power wish by bits 0-3 of STW1 (docs/translation.md "States")."""
_STOPS: Final = {
    PowerWish.COAST: PowerWish.NO_PLC_COAST,
    PowerWish.QUICK_STOP: PowerWish.NO_PLC_QUICK_STOP,
    PowerWish.QUICK_STOP_DISABLED: PowerWish.NO_PLC_QUICK_STOP,
}
STOPS_WITHOUT_PLC: Final = tuple(_STOPS.get(wish) for wish in WISHES)
"""The stop of a frame that does not count otherwise, by bits 0-3 of STW1; None: it has none."""


_SERVED_ELSEWHERE: Final = frozenset({"STW2", "ZSW2", *USER_WORDS, "RESERVED", "RESERVED_2"})
"""STW2 and ZSW2 carry the sign of life, which the machine serves; the others have no meaning."""


class SignalAdapter:
    """Find the signals of a telegram by name. ``check`` rejects a telegram with a signal that the adapter did not request."""

    def __init__(self, telegram: Telegram) -> None:
        self.telegram = telegram
        self.served = _SERVED_ELSEWHERE
        """Names of the signals whose place was requested."""

    def setpoint(self, name: str, *following: str) -> int:
        """The place of a setpoint and of those that follow it; -1 without it."""
        return self._place(self.telegram.setpoints, name, following)

    def actual(self, name: str, *following: str) -> int:
        """The place of an actual value and of those that follow it; -1 without it."""
        return self._place(self.telegram.actuals, name, following)

    def _place(self, half: TelegramHalf, name: str, following: tuple[str, ...]) -> int:
        if name not in half.names:
            return -1
        first = half.names.index(name)
        if half.names[first + 1 : first + 1 + len(following)] != following:
            raise GatewayError(f"telegram {self.telegram.number}: {name} is not followed by {', '.join(following)}")
        self.served |= {name, *following}
        return first

    def check(self) -> None:
        """GatewayError names the signals that this adapter neither reads nor writes: they would be ignored, or 0 permanently."""
        names = (*self.telegram.setpoints.names, *self.telegram.actuals.names)
        unserved = [name for name in names if name not in self.served]
        if unserved:
            raise GatewayError(
                f"telegram {self.telegram.number}: {type(self).__name__} neither reads nor writes {', '.join(unserved)}"
            )


class Adapter(SignalAdapter):
    """One telegram of one axis: ``read`` its setpoints into the demand, ``write`` the report into its actual values."""

    def __init__(self, telegram: Telegram, demand: Demand) -> None:
        super().__init__(telegram)
        self.demand = demand
        self.sensors = tuple(
            (self.setpoint(f"{name}_STW"), self.actual(f"{name}_ZSW", f"{name}_XIST1", f"{name}_XIST2"))
            for name in ("G1", "G2")
        )
        """Places of the words of the sensors, which ``SensorWords`` read and write,"""
        self.unheard = False
        """The last edge of STW1.7 came with STW1.10 or before it, after the last fault: it had no effect."""
        self.message = self.actual("MELDW")
        self.load = self.actual("IAIST_GLATT", "MIST_GLATT", "PIST_GLATT", "MELD_NAMUR")
        self.codes = self.actual("FAULT_CODE", "WARN_CODE")
        """and of those that ``DriveWords`` write."""

    def read(self, setpoints: Sequence[int] | None) -> None:
        """Raw setpoints in telegram order, None without a valid PLC."""
        raise NotImplementedError

    def write(self, flags: int, report: Report, actuals: list[int]) -> None:
        """Write raw actual values in telegram order: all ``flags``, and values of the report. Other words do not change."""
        raise NotImplementedError


def _without_control(control_lost: ControlLost) -> dict[PowerWish, dict[PowerWish, PowerWish]]:
    """The power command of STW1 without control, by the last command and its bits 0-3: a stop passes, nothing starts."""
    holds = control_lost is ControlLost.HOLD

    def wish(last: PowerWish, now: PowerWish) -> PowerWish:
        if now in {PowerWish.COAST, PowerWish.QUICK_STOP, PowerWish.QUICK_STOP_DISABLED}:
            return now
        goes_on = (
            holds and now not in {PowerWish.OFF, PowerWish.OFF_DISABLED} and last in {PowerWish.ENABLE, PowerWish.HOLD}
        )
        return PowerWish.HOLD if goes_on else PowerWish.STOP

    return {last: {now: wish(last, now) for now in set(WISHES)} for last in PowerWish}


_UNCONTROLLED: Final = {item: _without_control(item) for item in ControlLost}


class ControlWordAdapter(Adapter):
    """A telegram with STW1 and ZSW1. STW1 is evaluated when it changes."""

    IGNORED: ClassVar[int] = 0
    """Bits of STW1 without an effect."""

    def __init__(self, telegram: Telegram, settings: AxisSettings, demand: Demand) -> None:
        super().__init__(telegram, demand)
        self._uncontrolled = _UNCONTROLLED[settings.control_lost]
        self.stw1 = self.setpoint("STW1")
        self.zsw1 = self.actual("ZSW1")
        self.word: int | None = None
        """The last STW1; None without a PLC."""
        self._armed = False
        """STW1.7 was 0 since the PLC has control in this connection: an acknowledge is an edge."""

    def take(self, word: int | None) -> bool:
        """Evaluate the bits of STW1 that all telegrams share; None without a PLC. False: the other bits do not count."""
        before, self.word, demand = self.word, word, self.demand
        if word is None:
            demand.connected = self._armed = False
            demand.in_control = True
            return False
        if word & _FAULT_ACKNOWLEDGE and not (before or 0) & _FAULT_ACKNOWLEDGE:
            self.unheard = not (word & _CONTROL_BY_PLC and self._armed)
        if not word & _CONTROL_BY_PLC:
            demand.in_control = demand.acknowledge = self._armed = False
            demand.power = self._uncontrolled[demand.power][WISHES[word & POWER_BITS]]
            return False
        demand.connected = demand.in_control = True
        demand.power = WISHES[word & POWER_BITS]
        if word & _FAULT_ACKNOWLEDGE:
            demand.acknowledge = self._armed
        else:
            demand.acknowledge, self._armed = False, True
        return True

    def status(self, flags: int) -> int:
        """ZSW1 of the flags. OFF2 has priority over OFF3, and both are shown."""
        word = self.word
        return flags if word is None or word & _NO_QUICK_STOP else flags & ~Flag.NO_QUICK_STOP
