"""Telegram 9: positioning with MDI, homing, intermediate stop and reject.

Modes of operation: 6060h = 1, -5 on a modulo axis, 6 for homing. Source: docs/translation.md "Positioning, telegram 9
(MDI)"; the manufacturer's guide 5.2 and 6.7-6.14. Left out: traversing blocks (telegram 7) and jogging, which the drives
do not have.

Sub-states, as in the positioning diagram of the guide; each is a method that returns Controlword bits 4-12:

| sub-state | left when |
| --- | --- |
| IDLE | edge of STW1.6 (task), of STW1.11 (homing) |
| TASK | target reached, reject, intermediate stop, homing |
| INTERMEDIATE | STW1.5 = 1 (resumes; after a stop at a limit switch only its rising edge), reject, new task at a limit |
| BRAKING | standstill: Halt is cleared, then IDLE or homing |
| HOMING_SETUP | the drive took method and speeds, and confirmed mode 6 |
| HOMING | attained, error, or STW1.11 = 0 |
| HOMED, HOMING_FAILED | STW1.11 = 0 |
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

from pdgw.dsp402.images import DriveFeedback, References
from pdgw.dsp402.modes import HOMING_METHODS, Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.states import STATE_OF_STATUS, ControlBit, State, StatusBit
from pdgw.gateway.reasons import Reason
from pdgw.gateway.translator.base import LIMIT_STANDING_NS, FaultEvent, SdoWrite, Translator, TranslatorSettings
from pdgw.gateway.translator.power import (
    CONTROL_BY_PLC,
    CW_ENABLE_OPERATION,
    ZSW1_FAULT,
    ZSW1_STATE,
    ZSW1_STOPPING,
    ZSW1_TRANSPARENT,
    Phase,
    PowerControl,
)
from pdgw.profidrive.datatypes import Normalisation, n2, n4
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Telegram

_STW1 = signal("STW1")
_DO_NOT_REJECT = _STW1.bit("DO_NOT_REJECT", positioning=True).mask
_NO_INTERMEDIATE_STOP = _STW1.bit("NO_INTERMEDIATE_STOP", positioning=True).mask
_ACTIVATE_TASK = _STW1.bit("ACTIVATE_TASK", positioning=True).mask
_START_HOMING = _STW1.bit("START_HOMING", positioning=True).mask
_ZSW1 = signal("ZSW1")
_WARNING = _ZSW1.bit("WARNING").mask
_TARGET_REACHED = _ZSW1.bit("TARGET_REACHED", positioning=True).mask
_HOME_POSITION_SET = _ZSW1.bit("HOME_POSITION_SET", positioning=True).mask
_TASK_ACKNOWLEDGE = _ZSW1.bit("TASK_ACKNOWLEDGE", positioning=True).mask
_DRIVE_STOPPED = _ZSW1.bit("DRIVE_STOPPED", positioning=True).mask
_MDI = signal("SATZANW").bit("MDI").mask
_METHOD = signal("SATZANW").bit("HOMING_METHOD").mask
_MDI_ACTIVE = signal("AKTSATZ").bit("MDI_ACTIVE").mask
_ABSOLUTE = signal("MDI_MOD").bit("ABSOLUTE").mask
_POSITIVE = signal("MDI_MOD").bit("POSITIVE_DIRECTION").mask
_NEGATIVE = signal("MDI_MOD").bit("NEGATIVE_DIRECTION").mask

_HALT = ControlBit.HALT
_NEW_SETPOINT = ControlBit.NEW_SETPOINT

HOMING_STALE_NS = 50_000_000
"""A "homing attained" that was already there at the start counts only after this time (method 35 is immediate)."""
HOMING_UNATTAINED_NS = 1_000_000_000
"""A drive that stands with "target reached" but without "homing attained" for so long has given the homing up."""
MODE_CONFIRM_NS = 1_000_000_000
"""A mode the drive has not confirmed for so long raises warning 110."""
_LOWEST, _HIGHEST = DRIVE_OBJECTS.attribute("target_position").limits


class SubState(enum.Enum):
    """See the module's table."""

    IDLE = "MDI idle"
    TASK = "traversing task active"
    INTERMEDIATE = "intermediate stop"
    BRAKING = "braking"
    HOMING_SETUP = "homing being prepared"
    HOMING = "homing running"
    HOMED = "homing finished"
    HOMING_FAILED = "homing failed"


_IN_HOMING = (SubState.HOMING_SETUP, SubState.HOMING, SubState.HOMED, SubState.HOMING_FAILED)


@dataclass(slots=True)
class _Task:
    """A traversing task in the drive's units, taken with its edge."""

    target: int
    velocity: int
    acceleration: int
    deceleration: int
    bits: int
    """Controlword bits 5, 6, 11 and 12."""
    absolute_target: int | None
    """Where the task ends, for the resume; None for a relative task that was not given to the drive yet."""
    edge_seen: bool = False
    """The drive has acknowledged this task (SW.12)."""


class PositioningTranslator(Translator):
    """MDI tasks to profile position mode, homing to homing mode, with the hand-shakes of both sides."""

    def __init__(self, telegram: Telegram, settings: TranslatorSettings) -> None:
        super().__init__(telegram, settings)
        self.power = PowerControl(settings)
        self.sub_state = SubState.IDLE
        self.home_position_set = False
        self._base_mode = Mode.TURNTABLE if settings.modulo_axis else Mode.POSITION
        self.command.modes_of_operation = self._base_mode
        self._mode: int = self._base_mode
        self._mode_since = -1
        self._method = 0
        self._actuals = [0] * len(telegram.actuals.signals)
        self._position: Normalisation | None = None
        self._relative: Normalisation | None = None
        self._velocity: Normalisation | None = None
        self._acceleration: Normalisation | None = None
        self._deceleration: Normalisation | None = None
        self._window = 0
        self._setpoints: Sequence[int] = (0,) * len(telegram.setpoints.signals)
        self._controlled = False
        self._last_word = _ACTIVATE_TASK | _START_HOMING
        self._task: _Task | None = None
        self._pending: _Task | None = None
        self._setpoint_bit = False
        self._halted = False
        self._homing_after_braking = False
        self._braking_reason: Reason | None = None
        self._limit_since = -1
        self._at_limit = False
        """The intermediate stop is not the PLC's: a limit of the drive stopped the task."""
        self._mdi_active = False
        self._homing_writes: tuple[SdoWrite, ...] = ()
        self._sdo_busy = False
        self._sdo_state: str | None = None
        self._homing_since = 0
        self._homing_idle_since = -1
        self._attained_seen_low = False
        self._handlers = {
            SubState.IDLE: self._idle,
            SubState.TASK: self._traversing,
            SubState.INTERMEDIATE: self._intermediate,
            SubState.BRAKING: self._braking,
            SubState.HOMING_SETUP: self._homing_setup,
            SubState.HOMING: self._homing,
            SubState.HOMED: self._homing_over,
            SubState.HOMING_FAILED: self._homing_over,
        }

    @property
    def released(self) -> bool:
        return self.power.phase is Phase.FOLLOW

    def set_references(self, references: References | None, homing_method: int = 0) -> None:
        self._position = None
        self._method = homing_method
        if references is None or not self._usable(references):
            return
        self._position = n4(references.position_max, (references.position_min, references.position_max))
        self._relative = n4(references.position_max, (_LOWEST, _HIGHEST))
        low, high = DRIVE_OBJECTS.attribute("profile_velocity").limits
        velocity_max = min(high, int(references.profile_velocity_reference))
        self._velocity = n4(references.profile_velocity_reference, (low, velocity_max), minimum=0)
        acceleration = DRIVE_OBJECTS.attribute("profile_acceleration").limits
        deceleration = DRIVE_OBJECTS.attribute("profile_deceleration").limits
        self._acceleration = n2(references.max_acceleration, (acceleration[0], references.max_acceleration))
        self._deceleration = n2(references.max_deceleration, (deceleration[0], references.max_deceleration))
        self._window = max(1, int(references.speed_reference * self.settings.standstill_window))

    def drive_restarted(self) -> None:
        self.power.lock()
        self._drop()
        self._halted = False
        self.home_position_set = False

    def sdo_done(self, error: str | None) -> None:
        self.sdo_request = None
        self._sdo_busy = False
        if self._sdo_state == "":
            self._sdo_state = "done" if error is None else error

    def step(self, setpoints: Sequence[int] | None, feedback: DriveFeedback, drive_ok: bool, now: int) -> Sequence[int]:
        statusword = feedback.statusword
        velocity = feedback.velocity_actual
        actuals = self._actuals
        position = self._position
        in_control, connected = self._take(setpoints)
        if position is None:
            return self._refuse(statusword, drive_ok)
        values = self._setpoints
        word = values[0]
        window = self._window
        standstill = -window <= velocity <= window
        power = self.power
        low = power.step(word, connected, drive_ok, statusword, standstill, now)
        reason = power.reason
        command = self.command
        state_bits = ZSW1_STATE[statusword & 0x7F]
        extra = 0
        reached = False
        if power.ramping:
            state_bits = ZSW1_STOPPING
            self._halted = True  # the mode stays what it is while Halt is set
            self._drop()
            extra = _HALT
        elif low & 0xF == CW_ENABLE_OPERATION and STATE_OF_STATUS[statusword & 0x7F] is State.OPERATION_ENABLED:
            self.reason = None
            extra = self._handlers[self.sub_state](word, feedback, standstill, now)
            reached = self.sub_state is SubState.IDLE or self.sub_state is SubState.HOMED
            reason = self.reason
        else:
            self._drop()
        self._last_word = word
        self._halted = bool(extra & _HALT)
        if not drive_ok:
            self.home_position_set = False
        self.reason = Reason.NO_CONTROL if setpoints is not None and not in_control else reason
        command.controlword = low | extra
        command.modes_of_operation = self._mode
        in_homing = self.sub_state in _IN_HOMING
        if drive_ok:
            actuals[0] = (
                state_bits
                | statusword & ZSW1_TRANSPARENT
                | (_WARNING if self.warning else 0)
                | (_TARGET_REACHED if reached else 0)
                | (_HOME_POSITION_SET if self.home_position_set else 0)
                | (
                    _TASK_ACKNOWLEDGE
                    if statusword & StatusBit.MODE_12 and not in_homing and self._in_base_mode(feedback)
                    else 0
                )
                | (_DRIVE_STOPPED if standstill else 0)
            )
        else:
            actuals[0] = statusword & ZSW1_TRANSPARENT | ZSW1_FAULT
        if not in_homing:
            self._mdi_active = bool(connected and values[1] & _MDI and low & 0xF == CW_ENABLE_OPERATION)
        actuals[1] = self._method & _METHOD | (_MDI_ACTIVE if self._mdi_active else 0)
        actuals[3] = position.to_wire(feedback.position_actual)
        return actuals

    # -- inputs ---------------------------------------------------------------------------------------------------

    def _take(self, setpoints: Sequence[int] | None) -> tuple[bool, bool]:
        """Keep the setpoints in force; returns (STW1 is evaluated now, a PLC is in charge)."""
        if setpoints is None:
            if self._controlled:
                self._controlled = False
                # A bit that is still standing when the PLC comes back is no edge.
                self._last_word |= _ACTIVATE_TASK | _START_HOMING
            return False, False
        if setpoints[0] & CONTROL_BY_PLC:
            if not self._controlled:
                self._controlled = True
                self._last_word = setpoints[0]
            self._setpoints = tuple(setpoints)
            return True, True
        return False, self._controlled

    def _refuse(self, statusword: int, drive_ok: bool) -> Sequence[int]:
        """Without valid references nothing is converted, nothing is enabled and no OFF is taken note of."""
        self.power.lock()
        self.reason = Reason.REFERENCE_INVALID if drive_ok else Reason.DRIVE_OFFLINE
        self._drop()
        self.command.controlword = 0
        self._actuals[:] = [statusword & ZSW1_TRANSPARENT | ZSW1_FAULT, 0, 0, 0]
        return self._actuals

    def _rising(self, word: int, bit: int) -> bool:
        return bool(word & bit and not self._last_word & bit)

    def _drop(self) -> None:
        """Not in operation: task, handshake and homing are over; the next edge starts anew."""
        self.sub_state = SubState.IDLE
        self._task = self._pending = None
        self._setpoint_bit = False
        self._homing_after_braking = False
        self._at_limit = False
        self._limit_since = -1
        self._sdo_state = None
        self._mode_since = -1
        if not self._halted:
            self._mode = self._base_mode

    def _in_base_mode(self, feedback: DriveFeedback) -> bool:
        return feedback.modes_of_operation_display == self._base_mode

    def _mode_confirmed(self, mode: int, feedback: DriveFeedback, now: int) -> bool:
        """Ask for a mode (never while Halt is set) and tell whether 6061h shows it."""
        if self._mode != mode and not self._halted:
            self._mode = mode
            self._mode_since = now
        if self._mode == mode and feedback.modes_of_operation_display == mode:
            self._mode_since = -1
            return True
        self.reason = Reason.MODE_NOT_CONFIRMED
        if self._mode_since < 0:
            self._mode_since = now
        elif now - self._mode_since >= MODE_CONFIRM_NS and not self.warning:
            self.warning = True
            self.events.append(
                FaultEvent(110, f"6060h = {mode}, 6061h = {feedback.modes_of_operation_display} for 1 s")
            )
        return False

    # -- traversing tasks -----------------------------------------------------------------------------------------

    def _limited(self, conversion: Normalisation | None, wire: int) -> int:
        if conversion is None:
            return 0
        if conversion.saturates(wire):
            self.saturations += 1
        return conversion.to_value(wire)

    def _new_task(self) -> _Task:
        _, _, _, target, velocity, acceleration, deceleration, mode = self._setpoints
        relative = not mode & _ABSOLUTE
        bits = ControlBit.CHANGE_IMMEDIATELY | (ControlBit.RELATIVE if relative else 0)
        value = self._limited(self._relative if relative else self._position, target)
        if self._base_mode is Mode.TURNTABLE and not relative:
            direction = mode & (_POSITIVE | _NEGATIVE)
            if direction == _NEGATIVE:
                bits |= ControlBit.TURNTABLE_CCW
            elif direction != _POSITIVE:
                bits |= ControlBit.TURNTABLE_SHORTEST
        return _Task(
            value,
            self._limited(self._velocity, velocity),
            self._limited(self._acceleration, acceleration),
            self._limited(self._deceleration, deceleration),
            bits,
            None if relative else value,
        )

    def _latch_edge(self, word: int) -> None:
        """A rising edge of STW1.6 with everything else given becomes a task with the data of this frame."""
        if not self._rising(word, _ACTIVATE_TASK):
            return
        if not self._setpoints[1] & _MDI:
            self.reason = Reason.MDI_OFF
        elif word & _DO_NOT_REJECT and word & _NO_INTERMEDIATE_STOP:
            self._pending = self._new_task()

    def _handshake(self, word: int, feedback: DriveFeedback, now: int) -> None:
        """CW.4: raised for a pending task once the drive took the last one back, lowered when STW1.6 has fallen."""
        acknowledged = bool(feedback.statusword & StatusBit.MODE_12) and self._in_base_mode(feedback)
        if self._setpoint_bit:
            task = self._task
            if task is not None and acknowledged and not task.edge_seen:
                task.edge_seen = True
            if (task is None or task.edge_seen) and (not word & _ACTIVATE_TASK or self._pending is not None):
                self._setpoint_bit = False
            return
        pending = self._pending
        if pending is None or acknowledged or self._halted:
            return
        if not self._mode_confirmed(self._base_mode, feedback, now):
            return
        if pending.absolute_target is None:
            pending.absolute_target = self._in_range(feedback.position_actual + pending.target)
        self._pending = None
        self._task = pending
        self._setpoint_bit = True
        command = self.command
        command.target_position = pending.target
        command.profile_velocity = pending.velocity
        command.profile_acceleration = pending.acceleration
        command.profile_deceleration = pending.deceleration

    def _in_range(self, position: int) -> int:
        """A computed position as an object can hold it: a modulo axis turns on past the end, any other ends there."""
        if self._base_mode is Mode.TURNTABLE:
            return (position - _LOWEST) % (_HIGHEST - _LOWEST + 1) + _LOWEST
        return min(max(position, _LOWEST), _HIGHEST)

    def _bits(self) -> int:
        """Controlword bits 4-6, 11 and 12 of the task in force."""
        return (self._task.bits if self._task else 0) | (_NEW_SETPOINT if self._setpoint_bit else 0)

    def _start_homing_asked(self, word: int) -> bool:
        """Edge of STW1.11 with a supported method; anything else raises the warning and starts nothing."""
        if not word & _START_HOMING:
            if self.warning and self.sub_state is SubState.IDLE:
                self.warning = False
            return False
        if not self._rising(word, _START_HOMING):
            if self.warning:
                self.reason = Reason.HOMING_METHOD
            return False
        method = self._asked_method()
        if method in HOMING_METHODS:
            self.warning = False
            return True
        self.warning = True
        self.reason = Reason.HOMING_METHOD
        allowed = ", ".join(str(number) for number in sorted(HOMING_METHODS))
        self.events.append(FaultEvent(108, f"SATZANW homing method {method}, allowed {allowed}"))
        return False

    def _asked_method(self) -> int:
        method = self._setpoints[1] & _METHOD
        return method - 0x100 if method & 0x80 else method

    def _idle(self, word: int, feedback: DriveFeedback, standstill: bool, now: int) -> int:
        if self._start_homing_asked(word):
            return self._begin_homing()
        self._latch_edge(word)
        if not self._setpoints[1] & _MDI:
            self.reason = Reason.MDI_OFF
        self._handshake(word, feedback, now)
        untaken = self._setpoint_bit and self._task is not None and not self._task.edge_seen
        if untaken or self._pending is not None:
            self.sub_state = SubState.TASK
        elif self._mode != self._base_mode:
            self._mode_confirmed(self._base_mode, feedback, now)
        return self._bits()

    def _traversing(self, word: int, feedback: DriveFeedback, standstill: bool, now: int) -> int:
        if not word & _DO_NOT_REJECT or not self._setpoints[1] & _MDI:
            self.reason = Reason.REJECTED if not word & _DO_NOT_REJECT else Reason.MDI_OFF
            return self._brake(then_home=False)
        if self._start_homing_asked(word):
            return self._brake(then_home=True)
        if not word & _NO_INTERMEDIATE_STOP:
            return self._interrupt(word, feedback, standstill, now)
        self._latch_edge(word)
        self._handshake(word, feedback, now)
        task = self._task
        if (
            task is not None
            and task.edge_seen
            and self._pending is None
            and feedback.statusword & StatusBit.TARGET_REACHED
        ):
            self.sub_state = SubState.IDLE
        elif self._stands_at_limit(feedback, standstill, now):
            self._at_limit = True
            return self._interrupt(word, feedback, standstill, now)
        return self._bits()

    def _stands_at_limit(self, feedback: DriveFeedback, standstill: bool, now: int) -> bool:
        """Whether a limit switch holds the task: it must not go on by itself when the switch is released."""
        if not (standstill and self._pending is None and feedback.statusword & StatusBit.INTERNAL_LIMIT):
            self._limit_since = -1
        elif self._limit_since < 0:
            self._limit_since = now
        return self._limit_since >= 0 and now - self._limit_since >= LIMIT_STANDING_NS

    def _interrupt(self, word: int, feedback: DriveFeedback, standstill: bool, now: int) -> int:
        self.sub_state = SubState.INTERMEDIATE
        # A task the drive has not taken is the one to resume with; its own Controlword edge never comes.
        if self._pending is not None:
            self._task, self._pending = self._pending, None
            self._setpoint_bit = False
        return self._intermediate(word, feedback, standstill, now)

    def _intermediate(self, word: int, feedback: DriveFeedback, standstill: bool, now: int) -> int:
        if not word & _DO_NOT_REJECT or not self._setpoints[1] & _MDI:
            self.reason = Reason.REJECTED if not word & _DO_NOT_REJECT else Reason.MDI_OFF
            return self._brake(then_home=False)
        if self._start_homing_asked(word):
            return self._brake(then_home=True)
        self._handshake(word, feedback, now)
        task = self._task
        if not word & _NO_INTERMEDIATE_STOP:
            self._at_limit = False
            self.reason = Reason.INTERMEDIATE_STOP
            return _HALT | self._bits()
        if self._at_limit and not self._rising(word, _ACTIVATE_TASK):
            self.reason = Reason.TASK_AT_LIMIT
            return _HALT | self._bits()
        self._at_limit = False
        self._limit_since = -1
        # Halt and CW.4 fall in this Controlword, CW.4 rises in a later one: the two together are not allowed.
        self._setpoint_bit = False
        self._task = None
        self._latch_edge(word)
        if task is not None and self._pending is None:
            self._pending = self._resumed(task, feedback)
        self.sub_state = SubState.TASK
        return 0

    def _resumed(self, task: _Task, feedback: DriveFeedback) -> _Task:
        """The rest of an interrupted task: to its original target, absolute where the axis has no modulo."""
        if task.absolute_target is None:
            return task
        relative = bool(task.bits & ControlBit.RELATIVE)
        if relative and self._base_mode is Mode.TURNTABLE:
            rest = self._in_range(task.absolute_target - feedback.position_actual)
            return _Task(rest, task.velocity, task.acceleration, task.deceleration, task.bits, task.absolute_target)
        bits = task.bits & ~ControlBit.RELATIVE
        target = task.absolute_target
        return _Task(target, task.velocity, task.acceleration, task.deceleration, bits, target)

    def _brake(self, then_home: bool) -> int:
        self.sub_state = SubState.BRAKING
        self._at_limit = False
        self._limit_since = -1
        self._task = self._pending = None
        self._setpoint_bit = False
        self._homing_after_braking = then_home
        self._braking_reason = self.reason
        return _HALT

    def _braking(self, word: int, feedback: DriveFeedback, standstill: bool, now: int) -> int:
        """Halt is kept to standstill and then cleared without a restart."""
        if not word & _START_HOMING:
            self._homing_after_braking = False
        elif self._start_homing_asked(word):
            self._homing_after_braking = True
        self.reason = self._braking_reason
        self._latch_edge(word)
        if not word & _DO_NOT_REJECT or not self._setpoints[1] & _MDI:
            self._pending = None
        stopped = standstill and (feedback.statusword & StatusBit.TARGET_REACHED or feedback.velocity_actual == 0)
        if not stopped:
            return _HALT
        if self._homing_after_braking:
            return self._begin_homing()
        self.sub_state = SubState.IDLE if self._pending is None else SubState.TASK
        return 0

    # -- homing ---------------------------------------------------------------------------------------------------

    def _begin_homing(self) -> int:
        self.sub_state = SubState.HOMING_SETUP
        self._task = self._pending = None
        self._setpoint_bit = False
        self._homing_after_braking = False
        self.home_position_set = False
        self.reason = Reason.HOMING_SETUP
        speed = max(1, self._limited(self._velocity, self._setpoints[4]))
        self._homing_writes = (
            SdoWrite(0x6098, 0, self._asked_method()),
            SdoWrite(0x6099, 1, speed),
            SdoWrite(0x6099, 2, speed),
        )
        self._sdo_state = None
        self._ask_for_writes()
        return 0

    def _ask_for_writes(self) -> None:
        """Not before the answer to the writes of a homing that was given up: it would be taken for ours."""
        if not self._sdo_busy:
            self._sdo_busy = True
            self._sdo_state = ""
            self.sdo_request = self._homing_writes

    def _homing_setup(self, word: int, feedback: DriveFeedback, standstill: bool, now: int) -> int:
        if not word & _START_HOMING:
            self._drop()
            return 0
        if self._sdo_state is None:
            self._ask_for_writes()
        if not self._sdo_state:
            self.reason = Reason.HOMING_SETUP
            return 0
        if self._sdo_state != "done":
            self.events.append(FaultEvent(111, str(self._sdo_state)))
            self.warning = True
            self.sub_state = SubState.HOMING_FAILED
            self.reason = Reason.HOMING_ERROR
            return 0
        self._method = self._homing_writes[0].value
        if not self._mode_confirmed(Mode.HOMING, feedback, now):
            return 0
        self.sub_state = SubState.HOMING
        self._homing_since = now
        self._homing_idle_since = -1
        self._attained_seen_low = False
        return _NEW_SETPOINT

    def _homing(self, word: int, feedback: DriveFeedback, standstill: bool, now: int) -> int:
        if not word & _START_HOMING:
            self.reason = Reason.HOMING_STOPPED
            return self._brake(then_home=False)
        statusword = feedback.statusword
        finished = statusword & (StatusBit.MODE_12 | StatusBit.TARGET_REACHED)
        attained = finished == StatusBit.MODE_12 | StatusBit.TARGET_REACHED
        error = bool(statusword & StatusBit.MODE_13)
        if not attained and not error:
            self._attained_seen_low = True
            if not standstill or not statusword & StatusBit.TARGET_REACHED:
                self._homing_idle_since = -1
            elif self._homing_idle_since < 0:
                self._homing_idle_since = now
            elif now - self._homing_idle_since >= HOMING_UNATTAINED_NS:
                self._homing_failed("stands without homing attained", statusword)
                return 0
        elif self._attained_seen_low or now - self._homing_since >= HOMING_STALE_NS:
            if error:
                self._homing_failed("homing error", statusword)
                return 0
            self.home_position_set = True
            self.sub_state = SubState.HOMED
        return _NEW_SETPOINT

    def _homing_failed(self, what: str, statusword: int) -> None:
        self.warning = True
        self.events.append(FaultEvent(109, f"method {self._method}, {what}, Statusword {statusword:04X}h"))
        self.sub_state = SubState.HOMING_FAILED
        self.reason = Reason.HOMING_ERROR

    def _homing_over(self, word: int, feedback: DriveFeedback, standstill: bool, now: int) -> int:
        if word & _START_HOMING:
            if self.sub_state is SubState.HOMED:
                return _NEW_SETPOINT
            self.reason = Reason.HOMING_ERROR
            return 0
        self.warning = False
        self._drop()
        self._latch_edge(word)
        if self._pending is not None:
            self.sub_state = SubState.TASK
        return 0
