"""Words of the telegrams with positions: 7, 110 and 111 of the positioner, and 9 (positioning with MDI and homing).

Source: docs/motion.md, docs/telegrams.md "Sources", docs/translation.md "Positioning, telegram 9 (MDI)". Telegram 7 has blocks
alone, 110 spreads over SATZANW, POS_STW and MDI_MOD what 111 has in POS_STW1 and POS_STW2. Left out: USER, the reference cam,
ZSW1.14 and .15 (accelerates, decelerates): 0. In telegram 9: traversing blocks (telegram 7) and jogging, which the drives do
not have; STW2 is not evaluated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from operator import itemgetter
from typing import ClassVar

from pdgw.gateway.axis.adapters.adapter import Adapter, ControlWordAdapter
from pdgw.gateway.axis.demand_report import MotionDemand, PowerWish, Report
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.motion.requests import (
    FULL,
    Command,
    PositionerChoices,
    PositionerRequest,
)
from pdgw.gateway.motion.units import LU_PER_VELOCITY_UNIT, round_half_away
from pdgw.profidrive.datatypes import N2_100_PERCENT, N4_PER_N2, DataType, float_of, float_pattern
from pdgw.profidrive.signals import POSITIONER_FORMS, signal
from pdgw.profidrive.telegrams import Telegram

_ZSW1 = signal("ZSW1")
_OWN = ~(_ZSW1.bit("DEVICE_14").mask | _ZSW1.bit("DEVICE_15").mask)
"""Bits of the Statusword that are neither acceleration nor deceleration."""

_TO_FIXED_STOP = signal("STW2").bit("TO_FIXED_STOP").mask
_SHOWN_FIXED_STOP = signal("ZSW2").bit("TO_FIXED_STOP").mask

_ACTIVE = POSITIONER_FORMS["AKTSATZ"]
_ACTIVE_BLOCK, _ACTIVE_MDI = _ACTIVE.bit("BLOCK").mask, _ACTIVE.bit("MDI_ACTIVE").mask
_CONTROL_WORDS = ("STW1", "SATZANW", "POS_STW", "POS_STW1", "POS_STW2", "MDI_MOD")
_COMMANDS = Command.__members__
_LIMITS = Command.SOFTWARE_LIMITS | Command.HARDWARE_LIMITS
_MDI_SELECTED = Command.MDI

_TO_FIXED_STOP_SHOWN = signal("POS_ZSW2").bit("TO_FIXED_STOP").mask
_MDI_MODES = signal("POS_ZSW1").word("MDI_ACTIVE", "SETTING_UP")
_POS_ZSW = sum(bit.mask for bit in signal("POS_ZSW").bits)
"""POS_ZSW is the low byte of POS_ZSW2 (a test)."""
_LOWEST, _HIGHEST = DataType.INTEGER32.integer_range


class PositionerAdapter(ControlWordAdapter):
    """Common part of all: the commands in the control words, by the names of their bits. They are read when they change.

    Without control by a PLC, no motion is requested.
    """

    IGNORED: ClassVar[int] = signal("STW1").word("OPEN_BRAKE", "DEVICE_14", "DEVICE_15", positioning=True)
    KEPT: ClassVar[int] = 0
    """Commands that stay without control."""

    def __init__(self, telegram: Telegram, settings: AxisSettings) -> None:
        self._asked = MotionDemand()
        super().__init__(telegram, settings, self._asked)
        self._stw2 = self.setpoint("STW2")
        self._last: Sequence[int] | None = None
        """The setpoints that are in the request; None without control."""
        words = [item for item in telegram.setpoints.signals if item.name in _CONTROL_WORDS]
        self._words: Callable[[Sequence[int]], tuple[int, ...]] = itemgetter(
            *(self.setpoint(item.name) for item in words)
        )
        fields = [(place, bit) for place, item in enumerate(words) for bit in item.fields(positioning=True)]
        self._command_bits = [(place, bit.mask, _COMMANDS[bit.name]) for place, bit in fields if bit.name in _COMMANDS]
        self._number = next(field for field in fields if field[1].name in {"BLOCK", "HOMING_METHOD"})
        watched = any(bit.name == "SOFTWARE_LIMITS" for _, bit in fields)
        self._always = 0 if watched else _LIMITS
        """Limits have no bit in telegrams 7, 9 and 110: they are watched as soon as they are known."""

    def read(self, setpoints: Sequence[int] | None) -> None:
        word, demand = None if setpoints is None else setpoints[self.stw1], self._asked
        if word != self.word:
            self.take(word)
        request, last = demand.motion, self._last
        if setpoints is None or not demand.in_control:
            if last is not None and (setpoints is None or demand.power is not PowerWish.HOLD):
                self._last = None
                demand.motion = PositionerRequest(request.commands & self.KEPT)
            return
        place = self._stw2
        if place >= 0:  # the sign of life makes no other request
            setpoints = (*setpoints[:place], setpoints[place] & _TO_FIXED_STOP, *setpoints[place + 1 :])
        if setpoints == last:
            return
        self._last = setpoints
        controls = self._words(setpoints)
        commands, number = request.commands, request.number
        if last is None or controls != self._words(last):
            commands = self._always
            for place, mask, command in self._command_bits:
                if controls[place] & mask:
                    commands |= command
            place, field = self._number
            number = field.of(controls[place])
        demand.motion = self.requested(setpoints, commands, number)

    def requested(self, setpoints: Sequence[int], commands: int, number: int) -> PositionerRequest:
        """The request with the values that are not bits of a control word."""
        raise NotImplementedError


class _MdiValues:
    """STW2, OVERRIDE and the setpoints of MDI, and the words that show them."""

    NAMES: ClassVar[tuple[str, ...]] = ("MDI_TARPOS", "MDI_VELOCITY", "MDI_ACC", "MDI_DEC")
    POSITION: ClassVar[str] = "XIST_A"

    def __init__(self, adapter: Adapter) -> None:
        self._stw2 = adapter.setpoint("STW2")
        self._override = adapter.setpoint("OVERRIDE")
        self._first = adapter.setpoint(*self.NAMES)
        self._zsw2 = adapter.actual("ZSW2")
        self._xist = adapter.actual(self.POSITION)

    def read(self, setpoints: Sequence[int], commands: int, block: int) -> PositionerRequest:
        override = setpoints[self._override]
        return PositionerRequest(
            commands,
            block,
            setpoints[self._stw2] != 0,
            override if override > 0 else 0,
            *self.task(setpoints, self._first),
        )

    def task(self, setpoints: Sequence[int], first: int) -> tuple[int, int, int, int, int | None]:
        """Target, velocity, acceleration, deceleration and reference coordinate."""
        return setpoints[first], setpoints[first + 1], setpoints[first + 2], setpoints[first + 3], None

    def write(self, report: Report, actuals: list[int]) -> None:
        position = report.position
        actuals[self._xist] = position if _LOWEST <= position <= _HIGHEST else max(_LOWEST, min(position, _HIGHEST))
        if report.positioner[1] & _TO_FIXED_STOP_SHOWN:
            actuals[self._zsw2] |= _SHOWN_FIXED_STOP


class _FloatValues(_MdiValues):
    """The same of telegram 112, in the user's unit of length; a value that is not a number is a task with speed 0, which is
    rejected. GatewayError without the unit."""

    NAMES: ClassVar[tuple[str, ...]] = ("MDI_TARPOS_F", "MDI_VELOCITY_F", "MDI_ACC_F", "MDI_DEC_F")
    POSITION: ClassVar[str] = "XIST_F"

    def __init__(self, adapter: Adapter, choices: PositionerChoices | None) -> None:
        if choices is None or not choices.lu_per_unit:
            raise GatewayError("lu_per_unit is missing: telegram 112 needs lu_per_unit and velocity_per")
        super().__init__(adapter)
        self._reference = adapter.setpoint("REF_COORDINATE")
        self._speed = adapter.actual("VIST_F")
        self._lu = choices.lu_per_unit
        self._minutes = 60 if choices.units_per_second else 1
        """Factor to velocities per minute."""

    def task(self, setpoints: Sequence[int], first: int) -> tuple[int, int, int, int, int | None]:
        target, velocity, acceleration, deceleration = floats = [
            float_of(item) for item in setpoints[first : first + 4]
        ]
        speed = max(0, _whole(velocity, self._lu * self._minutes, LU_PER_VELOCITY_UNIT))
        reference = float_of(setpoints[self._reference])
        return (
            _whole(target, self._lu),
            speed if all(map(isfinite, floats)) else 0,
            _share(acceleration),
            _share(deceleration),
            _whole(reference, self._lu) if isfinite(reference) else None,
        )

    def write(self, report: Report, actuals: list[int]) -> None:
        super().write(report, actuals)
        actuals[self._xist] = float_pattern(report.position / self._lu)
        actuals[self._speed] = float_pattern(report.length_speed / (self._lu * self._minutes))


def _whole(value: float, factor: int, divisor: int = 1) -> int:
    """A number times ``factor`` / ``divisor``, rounded to nearest; 0 for an invalid number."""
    if not isfinite(value):
        return 0
    numerator, denominator = value.as_integer_ratio()
    return round_half_away(numerator * factor, denominator * divisor)


def _share(percent: float) -> int:
    """Percent as N2, 0 to 200 %."""
    low, high = 0, DataType.N2.integer_range[1]
    return max(low, min(_whole(percent, N2_100_PERCENT, 100), high))


class BasicPositionerAdapter(PositionerAdapter):
    """Telegrams 7 and 110 to 112: the words of a positioner, as far as the telegram has them.

    Telegram 7 has blocks alone: its bit MDI selects a task that cannot be executed (speed 0).
    """

    def __init__(self, telegram: Telegram, settings: AxisSettings) -> None:
        super().__init__(telegram, settings)
        self._mdi: _MdiValues | None = None
        if "MDI_TARPOS" in telegram.setpoints.names:
            self._mdi = _MdiValues(self)
        elif "MDI_TARPOS_F" in telegram.setpoints.names:
            self._mdi = _FloatValues(self, settings.positioner)
        self._aktsatz = self.actual("AKTSATZ")
        self._pos_zsw = self.actual("POS_ZSW")
        self._pos_zsw1 = self.actual("POS_ZSW1", "POS_ZSW2")
        self._speed = self.actual("NIST_B")

    def requested(self, setpoints: Sequence[int], commands: int, number: int) -> PositionerRequest:
        if self._mdi is None:
            return PositionerRequest(commands, number)
        return self._mdi.read(setpoints, commands, number)

    def write(self, flags: int, report: Report, actuals: list[int]) -> None:
        actuals[self.zsw1] = self.status(flags) & _OWN
        mdi, (first, second) = self._mdi, report.positioner
        if mdi is not None:
            mdi.write(report, actuals)
        if self._aktsatz >= 0:
            active = _ACTIVE_MDI if mdi is not None and first & _MDI_MODES else 0
            actuals[self._aktsatz] = first & _ACTIVE_BLOCK | active
        if self._pos_zsw >= 0:
            actuals[self._pos_zsw] = second & _POS_ZSW
        place = self._pos_zsw1
        if place >= 0:
            actuals[place], actuals[place + 1] = first, second
        if self._speed >= 0:
            actuals[self._speed] = report.speed


class PositioningAdapter(PositionerAdapter):
    """Positions, speeds and ramps are fractions of the references. AKTSATZ shows MDI without control, too."""

    KEPT: ClassVar[int] = _MDI_SELECTED
    IGNORED: ClassVar[int] = PositionerAdapter.IGNORED | signal("STW1").word(
        "JOG_1_ON", "JOG_2_ON", "EXTERNAL_BLOCK_CHANGE", positioning=True
    )

    def __init__(self, telegram: Telegram, settings: AxisSettings) -> None:
        super().__init__(telegram, settings)
        self._first = self.setpoint("MDI_TARPOS", "MDI_VELOCITY", "MDI_ACC", "MDI_DEC")
        self._aktsatz = self.actual("AKTSATZ")
        self._xist = self.actual("XIST_A")

    def requested(self, setpoints: Sequence[int], commands: int, number: int) -> PositionerRequest:
        target, velocity, acceleration, deceleration = setpoints[self._first : self._first + 4]
        ramps = (acceleration * N4_PER_N2, deceleration * N4_PER_N2)
        return PositionerRequest(commands, number, False, FULL, target, velocity, *ramps)

    def write(self, flags: int, report: Report, actuals: list[int]) -> None:
        actuals[self.zsw1] = self.status(flags)
        actuals[self._aktsatz] = report.active
        actuals[self._xist] = report.position
