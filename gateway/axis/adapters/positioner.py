"""Telegrams 7, 110 and 111: STW1 and the positioner's words, ZSW1 and what a positioner shows.

Source: docs/motion.md, docs/telegrams.md "Motion". Telegram 7 has blocks alone, 110 spreads over SATZANW, POS_STW and MDI_MOD
what 111 has in POS_STW1 and POS_STW2. Left out: USER, the reference cam, ZSW1.14 and .15 (accelerates, decelerates): 0.
"""

from __future__ import annotations

from collections.abc import Sequence

from pdgw.gateway.axis.adapters.base import ControlWordAdapter, place
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.waist import Demand, Report
from pdgw.gateway.motion.states import State
from pdgw.gateway.motion.wishes import Asked, MotionKind, Outcome
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.signals import POSITIONER_FORMS, signal
from pdgw.profidrive.telegrams import Telegram

_STW1 = signal("STW1")
_DO_NOT_REJECT = _STW1.bit("DO_NOT_REJECT", positioning=True).mask
_NO_INTERMEDIATE_STOP = _STW1.bit("NO_INTERMEDIATE_STOP", positioning=True).mask
_ACTIVATE_TASK = _STW1.bit("ACTIVATE_TASK", positioning=True).mask
_JOG_1 = _STW1.bit("JOG_1_ON").mask
_JOG_2 = _STW1.bit("JOG_2_ON").mask
_START_HOMING = _STW1.bit("START_HOMING", positioning=True).mask
_EXTERNAL = _STW1.bit("EXTERNAL_BLOCK_CHANGE", positioning=True).mask
_ZSW1 = signal("ZSW1")
_OF_THE_DRIVE = _ZSW1.bit("DEVICE_14").mask | _ZSW1.bit("DEVICE_15").mask
"""What the Statusword has there is neither acceleration nor deceleration."""

_TO_FIXED_STOP = signal("STW2").bit("TO_FIXED_STOP").mask
_SHOWN_FIXED_STOP = signal("ZSW2").bit("TO_FIXED_STOP").mask

_SELECTION = POSITIONER_FORMS["SATZANW"]
_BLOCK, _BLOCK_MDI = _SELECTION.bit("BLOCK"), _SELECTION.bit("MDI").mask
_ACTIVE = POSITIONER_FORMS["AKTSATZ"]
_ACTIVE_BLOCK, _ACTIVE_MDI = _ACTIVE.bit("BLOCK").mask, _ACTIVE.bit("MDI_ACTIVE").mask
_MOD_ABSOLUTE = signal("MDI_MOD").bit("ABSOLUTE").mask
_MOD_POSITIVE = signal("MDI_MOD").bit("POSITIVE_DIRECTION").mask
_MOD_NEGATIVE = signal("MDI_MOD").bit("NEGATIVE_DIRECTION").mask

_POS_STW1 = signal("POS_STW1")
_1_BLOCK = _POS_STW1.bit("BLOCK")
_1_ABSOLUTE = _POS_STW1.bit("ABSOLUTE").mask
_1_POSITIVE = _POS_STW1.bit("POSITIVE_DIRECTION").mask
_1_NEGATIVE = _POS_STW1.bit("NEGATIVE_DIRECTION").mask
_1_UPDATE = _POS_STW1.bit("CONTINUOUS_UPDATE").mask
_1_SETTING_UP = _POS_STW1.bit("SETTING_UP").mask
_1_MDI = _POS_STW1.bit("MDI").mask

_POS_STW2 = signal("POS_STW2")
_2_TRACKING = _POS_STW2.bit("TRACKING").mask
_2_SET_REFERENCE = _POS_STW2.bit("SET_REFERENCE_POINT").mask
_2_INCREMENTAL = _POS_STW2.bit("JOG_INCREMENTAL").mask
_2_PASSIVE = _POS_STW2.bit("PASSIVE_HOMING").mask
_2_PROBE_2 = _POS_STW2.bit("PROBE_2").mask
_2_FALLING = _POS_STW2.bit("PROBE_FALLING_EDGE").mask
_2_SOFTWARE = _POS_STW2.bit("SOFTWARE_LIMITS").mask
_2_HARDWARE = _POS_STW2.bit("HARDWARE_LIMITS").mask

_POS_ZSW1 = signal("POS_ZSW1")
_NEGATIVE_LIMIT = _POS_ZSW1.bit("NEGATIVE_HARDWARE_LIMIT").mask
_POSITIVE_LIMIT = _POS_ZSW1.bit("POSITIVE_HARDWARE_LIMIT").mask
_JOGGING = _POS_ZSW1.bit("JOGGING").mask
_HOMING = _POS_ZSW1.bit("HOMING").mask
_PASSIVE_HOMING = _POS_ZSW1.bit("PASSIVE_HOMING").mask
_FUNCTION = {
    State.BLOCK: _POS_ZSW1.bit("BLOCK_MODE").mask,
    State.SETTING_UP: _POS_ZSW1.bit("SETTING_UP").mask,
    State.MDI: _POS_ZSW1.bit("MDI_ACTIVE").mask,
}
_JOG_STATES = (State.JOG, State.JOG_INCREMENTAL)

_POS_ZSW2 = signal("POS_ZSW2")
_TRACKING = _POS_ZSW2.bit("TRACKING").mask
_SPEED_LIMITED = _POS_ZSW2.bit("SPEED_LIMITED").mask
_STATIONARY = _POS_ZSW2.bit("SETPOINT_STATIONARY").mask
_SETPOINT_REACHED = _POS_ZSW2.bit("SETPOINT_REACHED").mask
_FORWARD = _POS_ZSW2.bit("MOVES_FORWARD").mask
_BACKWARD = _POS_ZSW2.bit("MOVES_BACKWARD").mask
_LIMIT_MINUS = _POS_ZSW2.bit("SOFTWARE_LIMIT_MINUS").mask
_LIMIT_PLUS = _POS_ZSW2.bit("SOFTWARE_LIMIT_PLUS").mask
_OUTPUT_1 = _POS_ZSW2.bit("OUTPUT_1")
_FIXED_STOP = _POS_ZSW2.bit("FIXED_STOP_REACHED").mask | _POS_ZSW2.bit("CLAMPING_TORQUE_REACHED").mask
_MOVING_TO_STOP = _POS_ZSW2.bit("TO_FIXED_STOP").mask
_TRAVERSING = _POS_ZSW2.bit("TRAVERSING").mask
_POS_ZSW = sum(bit.mask for bit in signal("POS_ZSW").bits)
"""POS_ZSW is the low byte of POS_ZSW2 (a test)."""
_LOWEST, _HIGHEST = DataType.INTEGER32.integer_range


class PositionerAdapter(ControlWordAdapter):
    """Words by name; what a telegram lacks keeps its first value."""

    def __init__(self, telegram: Telegram, settings: AxisSettings) -> None:
        super().__init__(telegram, settings)
        setpoints, actuals = telegram.setpoints, telegram.actuals
        self._asked = Asked()
        self._last: Sequence[int] | None = None
        self._words = (-1, -1, -1)
        """STW1 and the positioner's words as they were evaluated last."""
        self._stw2 = place(setpoints, "STW2")
        self._satzanw = place(setpoints, "SATZANW")
        self._pos_stw = place(setpoints, "POS_STW")
        self._pos_stw1 = place(setpoints, "POS_STW1")
        self._pos_stw2 = place(setpoints, "POS_STW2")
        self._override = place(setpoints, "OVERRIDE")
        self._target = place(setpoints, "MDI_TARPOS")
        """MDI_VELOCITY, MDI_ACC and MDI_DEC follow."""
        self._mod = place(setpoints, "MDI_MOD")
        self._zsw2 = place(actuals, "ZSW2")
        self._aktsatz = place(actuals, "AKTSATZ")
        self._pos_zsw = place(actuals, "POS_ZSW")
        self._pos_zsw1 = place(actuals, "POS_ZSW1")
        """POS_ZSW2 follows."""
        self._message = place(actuals, "MELDW")
        self._position = place(actuals, "XIST_A")
        self._speed = place(actuals, "NIST_B")
        self._codes = place(actuals, "FAULT_CODE")
        """WARN_CODE follows."""

    def read(self, setpoints: Sequence[int] | None, demand: Demand) -> None:
        word = None if setpoints is None else setpoints[self.stw1]
        if word != self.word:
            self.take(word, demand)
        demand.motion = self._asked
        if word is None or setpoints is None or not demand.in_control or setpoints == self._last:
            return
        self._last = setpoints
        asked = self._asked
        if self._pos_stw1 >= 0:
            words = (word, setpoints[self._pos_stw1], setpoints[self._pos_stw2])
            if words != self._words:
                self._words = words
                self._read_stw1(word)
                self._read_111(words[1], words[2])
        else:
            self._read_stw1(word)
            self._read_selection(setpoints)
        if self._stw2 >= 0:
            asked.to_fixed_stop = setpoints[self._stw2] & _TO_FIXED_STOP != 0
        if self._override >= 0:
            override = setpoints[self._override]
            asked.override = override if override > 0 else 0
        first = self._target
        if first >= 0:
            asked.target, asked.velocity = setpoints[first], setpoints[first + 1]
            asked.acceleration, asked.deceleration = setpoints[first + 2], setpoints[first + 3]

    def _read_stw1(self, word: int) -> None:
        asked = self._asked
        asked.do_not_reject = word & _DO_NOT_REJECT != 0
        asked.no_intermediate_stop = word & _NO_INTERMEDIATE_STOP != 0
        asked.activate = word & _ACTIVATE_TASK != 0
        asked.jog_1 = word & _JOG_1 != 0
        asked.jog_2 = word & _JOG_2 != 0
        asked.homing = word & _START_HOMING != 0
        asked.external_block_change = word & _EXTERNAL != 0

    def _read_111(self, word: int, second: int) -> None:
        asked = self._asked
        asked.block = _1_BLOCK.of(word)
        asked.absolute = word & _1_ABSOLUTE != 0
        asked.positive = word & _1_POSITIVE != 0
        asked.negative = word & _1_NEGATIVE != 0
        asked.continuous_update = word & _1_UPDATE != 0
        asked.setting_up = word & _1_SETTING_UP != 0
        asked.mdi = word & _1_MDI != 0
        asked.tracking = second & _2_TRACKING != 0
        asked.set_reference_point = second & _2_SET_REFERENCE != 0
        asked.jog_incremental = second & _2_INCREMENTAL != 0
        asked.passive_homing = second & _2_PASSIVE != 0
        asked.probe_2 = second & _2_PROBE_2 != 0
        asked.probe_falling = second & _2_FALLING != 0
        asked.software_limits = second & _2_SOFTWARE != 0
        asked.hardware_limits = second & _2_HARDWARE != 0

    def _read_selection(self, setpoints: Sequence[int]) -> None:
        asked = self._asked
        selection = setpoints[self._satzanw]
        asked.block = _BLOCK.of(selection)
        # Telegram 7 has no MDI: its bit selects a task that cannot be done (speed 0).
        asked.mdi = selection & _BLOCK_MDI != 0
        if self._mod >= 0:
            mode = setpoints[self._mod]
            asked.absolute = mode & _MOD_ABSOLUTE != 0
            asked.positive = mode & _MOD_POSITIVE != 0
            asked.negative = mode & _MOD_NEGATIVE != 0
        if self._pos_stw >= 0:
            word = setpoints[self._pos_stw]
            asked.tracking = word & _2_TRACKING != 0
            asked.set_reference_point = word & _2_SET_REFERENCE != 0
            asked.jog_incremental = word & _2_INCREMENTAL != 0
            # Limits have no bit in telegram 110: they are watched as soon as they are known.
            asked.software_limits = asked.hardware_limits = True

    def write(self, report: Report, actuals: list[int]) -> None:
        actuals[self.zsw1] = report.flags & ~_OF_THE_DRIVE
        outcome = report.motion
        if outcome is None:
            return
        if self._message >= 0:
            actuals[self._message] = report.message
        if self._position >= 0:
            position = outcome.position
            actuals[self._position] = (
                position if _LOWEST <= position <= _HIGHEST else max(_LOWEST, min(position, _HIGHEST))
            )
        if self._speed >= 0:
            actuals[self._speed] = report.speed
        if self._codes >= 0:
            actuals[self._codes], actuals[self._codes + 1] = report.fault_code, report.warning_code
        if self._zsw2 >= 0 and outcome.to_fixed_stop:
            actuals[self._zsw2] |= _SHOWN_FIXED_STOP
        if self._aktsatz >= 0:
            active = _ACTIVE_MDI if outcome.shown is State.MDI or outcome.shown is State.SETTING_UP else 0
            actuals[self._aktsatz] = outcome.block & _ACTIVE_BLOCK | active
        if self._pos_zsw >= 0:
            actuals[self._pos_zsw] = self._second(outcome, report.speed) & _POS_ZSW
        if self._pos_zsw1 >= 0:
            actuals[self._pos_zsw1] = self._first(outcome)
            actuals[self._pos_zsw1 + 1] = self._second(outcome, report.speed)

    @staticmethod
    def _first(outcome: Outcome) -> int:
        """POS_ZSW1."""
        word = outcome.block | _FUNCTION.get(outcome.shown, 0)
        if outcome.state in _JOG_STATES:
            word |= _JOGGING
        if outcome.homing:
            word |= _HOMING
        if outcome.passive_homing:
            word |= _PASSIVE_HOMING
        if outcome.negative_limit:
            word |= _NEGATIVE_LIMIT
        return word | _POSITIVE_LIMIT if outcome.positive_limit else word

    @staticmethod
    def _second(outcome: Outcome, speed: int) -> int:
        """POS_ZSW2."""
        motion = outcome.motion
        word = outcome.outputs << _OUTPUT_1.position
        if outcome.reached:
            word |= _STATIONARY | _SETPOINT_REACHED
        elif motion.kind is MotionKind.STAND:
            word |= _STATIONARY
        else:
            word |= _TRAVERSING
        if not outcome.standing:
            word |= _FORWARD if speed > 0 else _BACKWARD
        if outcome.state is State.TRACKING:
            word |= _TRACKING
        if outcome.speed_limited:
            word |= _SPEED_LIMITED
        if outcome.at_minus:
            word |= _LIMIT_MINUS
        if outcome.at_plus:
            word |= _LIMIT_PLUS
        if outcome.to_fixed_stop:
            word |= _MOVING_TO_STOP
        return word | _FIXED_STOP if outcome.fixed_stop else word
