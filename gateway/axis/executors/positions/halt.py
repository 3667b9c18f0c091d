"""Halt (Controlword.8): when it rises and falls, and the setpoint that it has stopped.

Source: docs/motion.md. A drive may continue a stopped setpoint when Halt falls, so Halt stays until the next function where one
does. Halt never falls together with the edge of a setpoint.
"""

from __future__ import annotations

import enum
from typing import Final

from pdgw.dsp402.states import ControlBit, StatusBit
from pdgw.gateway.axis.answer import Answer
from pdgw.gateway.axis.executors.executor import Executor
from pdgw.gateway.axis.executors.positions.handshake import Handshake
from pdgw.gateway.axis.executors.positions.mode import ModeSwitch
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.positioner import Positioner

HALT: Final = ControlBit.HALT
_TARGET_REACHED: Final = StatusBit.TARGET_REACHED
_MOVES: Final = warning_bits(FaultNumber.MOVES_UNASKED)
"""The axis has also left the standstill window."""


class _Stopped(enum.Enum):
    """The setpoint that Halt has stopped, until another one comes."""

    NONE = "none"
    UNMOVED = "it has not moved the axis yet (the brake opens), so the drive may still execute it: Halt stays"
    STOPPED = "the drive may continue it when Halt falls"
    ENDED = 'Halt has fallen, at "target reached"'
    CONTINUED = "the drive turned again, or shows its target as not reached again (its brake opens): Halt stays"


_NONE, _UNMOVED, _STOPPED, _ENDED, _CONTINUED = _Stopped


class Halt:
    """Halt of one axis. What returns Controlword bits returns Halt or 0."""

    def __init__(self, executor: Executor, mode: ModeSwitch, handshake: Handshake, positioner: Positioner) -> None:
        self._inputs, self._outputs, self._feedback = executor.inputs, executor.outputs, executor.feedback
        self._mode = mode
        self._handshake = handshake
        self._positioner = positioner
        self.effect = Answer(executor.settings.latency_ns)
        """Whether the newest setpoint or Halt has had the time to show at the shaft."""
        self._reached = Answer(executor.settings.latency_ns)
        """Target reached, in answer to the newest setpoint."""
        self.awaits_reached = False
        """Target reached may be that of before the newest setpoint: ``read_reached`` has to be called."""
        self._setpoint = _NONE
        self.rested = False
        """The axis was at rest without Halt, and no motion has begun since."""

    @property
    def has_stopped(self) -> bool:
        """Halt has stopped a setpoint, and none came since."""
        return self._setpoint is not _NONE

    @property
    def continued(self) -> bool:
        """The drive continues it."""
        return self._setpoint is _CONTINUED

    @property
    def _shows_reached(self) -> bool:
        """The drive shows "target reached", and not since before the newest setpoint."""
        return not self.awaits_reached and self._feedback.statusword & _TARGET_REACHED != 0

    @property
    def axis_stopped(self) -> bool:
        """The axis is at standstill, and the drive has ended its ramp."""
        return self._inputs.standstill and (self._shows_reached or self._feedback.velocity_actual == 0)

    @property
    def may_fall(self) -> bool:
        """The axis has stopped, and no setpoint is on its way that the drive may still start.

        Without "target reached", a speed of 0 can be older than the start of the setpoint, or than Halt.
        """
        now = self._inputs.now
        return (self._shows_reached or self.effect.due(now)) and self.axis_stopped and self._handshake.taking.due(now)

    @property
    def released(self) -> bool:
        """Halt has stopped a setpoint and has fallen: a drive that continues gets the next setpoint or mode at once."""
        return self._setpoint is not _NONE and not self._mode.halted and self._mode.shows_base()

    @property
    def keeps_mode(self) -> bool:
        """The drive does not take another mode, and continues what Halt has stopped: Halt stays until it takes the mode."""
        mode = self._mode
        other_asked = self.has_stopped and mode.mode != mode.base
        return other_asked and mode.shows_base() and (mode.halted or not self.axis_stopped)

    def note_turning(self) -> None:
        """The axis turns in this cycle."""
        self.effect.withdraw()
        if self._setpoint is _UNMOVED:
            self._setpoint = _STOPPED

    def replaced(self) -> None:
        """The drive gets a new setpoint."""
        now = self._inputs.now
        self.effect.command(now)
        self._reached.command(now)
        self.read_reached()
        self.end()

    def read_reached(self) -> None:
        """Read "target reached" until it is an answer to the newest setpoint; under Halt it says nothing about its motion."""
        reached = self._reached.read(self._feedback.statusword & _TARGET_REACHED != 0, self._inputs.now)
        self.awaits_reached = self._reached.awaited
        if reached and not self._mode.halted:
            self.effect.withdraw()

    def watch(self) -> None:
        """Note whether the drive works on a setpoint that Halt has stopped and released."""
        if self._setpoint is _NONE or not self.released or self._inputs.standstill_unknown:
            return
        if not (self.axis_stopped and (self._shows_reached or self._setpoint is not _ENDED)):
            self._setpoint = _CONTINUED

    def begin(self) -> int:
        """Halt stops the setpoint."""
        effect, mode = self.effect, self._mode
        if self._setpoint is _NONE:
            self._setpoint = _UNMOVED if effect.awaited and mode.shows_base() else _STOPPED
        if not mode.halted:
            effect.command(self._inputs.now)
        return HALT

    def rest(self) -> int:
        """Without a function: Halt while the axis turns, and until the next function if it turns again without Halt."""
        inputs = self._inputs
        if self.rested and not (inputs.standstill or inputs.standstill_unknown) and self._mode.shows_base():
            self._setpoint = _CONTINUED
        if self._setpoint is not _NONE or self._outputs.warned:
            stays = self._stays()
        else:  # a setpoint that has neither moved the axis nor ended may still start: its brake opens
            stays = self.effect.awaited and self._mode.shows_base()
        if not stays and self.may_fall:
            if self._setpoint is not _NONE and self._shows_reached:
                self._setpoint = _ENDED
            self.rested = True
            return 0
        return self.begin()

    def _stays(self) -> bool:
        """Without a function: whether the drive continues what Halt has stopped, with a warning."""
        positioner, inputs, outputs, setpoint = self._positioner, self._inputs, self._outputs, self._setpoint
        turns = setpoint is _CONTINUED and not (inputs.standstill or inputs.standstill_unknown)
        if turns and not outputs.warned & _MOVES:
            positioner.warn(None)
            outputs.warn(FaultNumber.MOVES_UNASKED, f"speed {self._feedback.velocity_actual}")
        if outputs.warned & _MOVES and positioner.course.warning is None:
            positioner.warn(Reason.MOVES_UNASKED)
        return setpoint is _CONTINUED or setpoint is _UNMOVED

    def before_homing(self) -> int:
        """Halt stays until the mode has to change, and rises again if the drive continues what Halt has stopped."""
        mode = self._mode
        return self.begin() if self.has_stopped and (mode.halted or self.continued) and not mode.asked else 0

    def end(self) -> None:
        """The drive has no stopped setpoint any more."""
        self._setpoint = _NONE
        self.rested = False
        self._outputs.end_warnings(_MOVES)
