"""A drive in as few lines as possible, for axis machines: the state table, a speed that follows, nothing else."""

from __future__ import annotations

from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback
from pdgw.dsp402.states import STATUS_OF, ControlBit, State, StatusBit, next_state


class PlainDrive:
    """One ``step`` per cycle: takes a command, updates the feedback. Speed follows the target by ``ramp`` per step."""

    def __init__(self) -> None:
        self.state = State.SWITCH_ON_DISABLED
        self.feedback = DriveFeedback()
        self.ramp = 1000
        self._previous = 0
        self.show()

    def show(self) -> None:
        word = STATUS_OF[self.state] | StatusBit.VOLTAGE_ENABLED | StatusBit.REMOTE
        if self.state is not State.QUICK_STOP_ACTIVE:
            word |= StatusBit.NO_QUICK_STOP
        self.feedback.statusword = word

    def fault(self) -> None:
        self.state = State.FAULT
        self.feedback.velocity_actual = 0
        self.show()

    def restart(self) -> None:
        self.state = State.SWITCH_ON_DISABLED
        self.feedback.velocity_actual = 0
        self._previous = 0
        self.show()

    def step(self, command: DriveCommand) -> None:
        word = command.controlword
        self.state = next_state(self.state, word, self._previous)
        self._previous = word
        target = 0
        if self.state is State.OPERATION_ENABLED and not word & ControlBit.HALT:
            target = command.target_velocity
        speed = self.feedback.velocity_actual
        speed += max(-self.ramp, min(self.ramp, target - speed))
        if self.state not in {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE}:
            speed = 0
        self.feedback.velocity_actual = speed
        if self.state is State.QUICK_STOP_ACTIVE and speed == 0:
            self.state = State.SWITCH_ON_DISABLED
        self.feedback.modes_of_operation_display = command.modes_of_operation
        self.show()
