"""The handshake of a setpoint with the drive: CW.4 rises with its data, and the drive acknowledges it by SW.12.

Source: docs/motion.md, docs/translation.md. CW.4 rises here, for a setpoint that was not given yet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.dsp402.states import ControlBit, StatusBit
from pdgw.gateway.axis.answer import Answer
from pdgw.gateway.axis.executors.executor import Executor
from pdgw.gateway.axis.executors.positions.mode import ModeSwitch
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.positioner import Positioner
from pdgw.gateway.motion.requests import Motion

NEW_SETPOINT: Final = ControlBit.NEW_SETPOINT
ACKNOWLEDGED: Final = StatusBit.MODE_12
"""Acknowledge bit of mode 1."""
ACKNOWLEDGE_NS: Final = 2 * SECOND
"""After this time without an acknowledge, a setpoint is reported and another task may replace it.

CiA 402 has no limit. A drive that is free for a setpoint acknowledges it within some milliseconds; before that, the data of the
setpoint may have to be written by SDO. A drive whose buffer is full is given no setpoint.
"""
_NOT_ACKNOWLEDGED: Final = warning_bits(FaultNumber.NOT_ACKNOWLEDGED)


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What the drive was given, until the next setpoint or a stop."""

    bits: int = 0
    """Controlword bits beside CW.4."""
    velocity_before: int = 0
    """6081h of the setpoint before, which the drive may still execute."""


NO_SETPOINT: Final = Setpoint()


class Handshake:
    """The newest setpoint of one axis, and the drive's answers to it."""

    def __init__(self, executor: Executor, mode: ModeSwitch, positioner: Positioner) -> None:
        self._inputs, self._outputs = executor.inputs, executor.outputs
        self._feedback, self._command = executor.feedback, executor.command
        self._mode = mode
        self._positioner = positioner
        self._seen = positioner.seen
        self.setpoint = NO_SETPOINT
        self.raised_at = -1
        """When CW.4 rose for it, monotonic ns; -1 while CW.4 is 0."""
        self.acknowledged = False
        """The drive has acknowledged a setpoint, and no stop or reject has ended it since."""
        self.taking = Answer(executor.settings.latency_ns)
        """The acknowledge, in answer to the newest setpoint: a drive that has not shown it may still start."""
        self.arrival = Answer(executor.settings.latency_ns)
        """Target reached, in answer to the setpoint that the drive executes."""
        self.blocked = 0
        """Velocity of a setpoint that waits until the drive is free; 0: none waits."""
        self.blocked_at = 0
        """When none waited last, monotonic ns."""

    @property
    def bits(self) -> int:
        """Controlword bits 4-6 and those of a turntable."""
        bits = self.setpoint.bits
        return bits if self.raised_at < 0 else bits | NEW_SETPOINT

    @property
    def shown(self) -> bool:
        """The drive shows the acknowledge of a setpoint."""
        return self._feedback.statusword & ACKNOWLEDGED != 0 and self._mode.shows_base()

    @property
    def free(self) -> bool:
        """The drive takes a setpoint: it has cleared the last acknowledge, and none can come for a cancelled one."""
        return not self.shown and self.taking.due(self._inputs.now)

    def begin(self, target: int, velocity: int, bits: int) -> None:
        """CW.4 rises with this setpoint."""
        command, now = self._command, self._inputs.now
        self.setpoint = Setpoint(bits, command.profile_velocity)
        command.target_position, command.profile_velocity = target, velocity
        self.raised_at = now
        self.taking.command(now, level=True)

    def announce(self, bits: int) -> None:
        """CW.4 falls, and the Controlword has the bits of the next setpoint already."""
        self.setpoint = Setpoint(bits, self.setpoint.velocity_before)
        self.raised_at = -1

    def fall(self) -> None:
        """CW.4 falls."""
        self.raised_at = -1

    def end(self) -> None:
        """The handshake is over: whether the drive has acknowledged makes no more difference."""
        seen = self._seen
        seen.taken = seen.executing = seen.given
        self.setpoint, self.raised_at, self.acknowledged = NO_SETPOINT, -1, False
        self.arrival.command(self._inputs.now)

    def read(self) -> bool:
        """Read whether the drive has taken the setpoint."""
        if not self.shown:
            self._await()
            return False
        self._seen.taken = self._seen.given
        self.acknowledged = True
        positioner = self._positioner
        if positioner.course.warning is Reason.NOT_ACKNOWLEDGED:
            positioner.warn(None)
            self._outputs.end_warnings(_NOT_ACKNOWLEDGED)
        return True

    def _await(self) -> None:
        """The drive has not taken the setpoint: a warning after ``ACKNOWLEDGE_NS``."""
        statusword, positioner, inputs = self._feedback.statusword, self._positioner, self._inputs
        waits = not self.setpoint.bits & ControlBit.CHANGE_IMMEDIATELY and not statusword & StatusBit.TARGET_REACHED
        if waits or self._mode.halted:
            self.raised_at = inputs.now  # a drive may take it at the end of the motion (one buffer), or of Halt
        elif (
            inputs.now - self.raised_at >= ACKNOWLEDGE_NS
            and positioner.course.warning is not Reason.NOT_ACKNOWLEDGED
            and not inputs.set_point_refused
        ):
            positioner.warn(Reason.NOT_ACKNOWLEDGED)
            detail = f"607Ah = {self._command.target_position}, Statusword {statusword:04X}h, "
            detail += f"6061h = {self._feedback.modes_of_operation_display} after {ACKNOWLEDGE_NS / SECOND:g} s"
            self._outputs.warn(FaultNumber.NOT_ACKNOWLEDGED, detail)

    def executes(self) -> None:
        """The drive begins to execute the setpoint that it has taken."""
        self._seen.executing = self._seen.taken
        self.arrival.command(self._inputs.now)

    def is_replaced(self, motion: Motion, given: int) -> bool:
        """Another task than that of the setpoint ``given`` waits, and the drive does not take this setpoint any more.

        A new setpoint of the same task does not count: its edge would be a second one.
        """
        if motion.first <= given:
            return False
        return self._inputs.now - self.raised_at >= ACKNOWLEDGE_NS or self._inputs.set_point_refused

    def highest_velocity(self) -> int:
        """The highest that the drive may have by the setpoints that it can have, in its units."""
        seen, setpoint, highest = self._seen, self.setpoint, self._command.profile_velocity
        late = self._inputs.now - ACKNOWLEDGE_NS
        if seen.executing != seen.given and not 0 <= self.raised_at <= late:
            highest = max(highest, setpoint.velocity_before)
        if self.blocked and self.blocked_at <= late and setpoint.bits & ControlBit.CHANGE_IMMEDIATELY:
            highest = min(highest, self.blocked)  # the drive has no setpoint that could wait, and is not free
        return highest
