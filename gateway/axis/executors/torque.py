"""Speed with load values (telegram 20), and with a torque reduction (102, 103)."""

from __future__ import annotations

from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import DriveType, Dsp402Error, Quantity
from pdgw.dsp402.states import STATE_OF_STATUS, State, StatusBit
from pdgw.gateway.axis.demand_report import STATE_MASK
from pdgw.gateway.axis.executors.executor import AxisRecords
from pdgw.gateway.axis.executors.speed import SpeedExecutor
from pdgw.gateway.axis.values import Outputs
from pdgw.gateway.motion.requests import MessageWord, namur_word, reduced_torque
from pdgw.gateway.motion.units import round_half_away
from pdgw.gateway.reasons import Reason
from pdgw.profidrive.datatypes import N2_100_PERCENT, DataType

# Speed with load values of the motor: telegram 20.
#
# Source: docs/motion.md "Telegram 20". 6078h also gives the torque in 1/1000 of the rated value; a drive without it shows 0.


_RATED = 1000
_LOWEST, _HIGHEST = DataType.N2.integer_range


class LoadExecutor(SpeedExecutor):
    """The speed as ever."""

    _full_power = 0
    """Rated torque at the reference speed, in the units of torque x velocity."""

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        super().set_drive(drive, homing_method)
        self._full_power = int(_RATED * drive.scaling.reference(Quantity.SPEED))

    def refuse(self) -> None:
        super().refuse()
        self.report.load = (0, 0, 0)
        self.report.namur = namur_word(self.outputs.drive_error)

    def step(self) -> Reason | None:
        feedback = self.feedback
        torque = feedback.current_actual
        current = _n2(torque, _RATED)
        self.report.load = (current, current, _n2(torque * feedback.velocity_actual, self._full_power))
        self.report.namur = namur_word(self.outputs.drive_error)
        return super().step()


def _n2(value: int, full: int) -> int:
    """A share of ``full`` as N2; 0 where that is not known."""
    if not full:
        return 0
    return max(_LOWEST, min(round_half_away(value * N2_100_PERCENT, full), _HIGHEST))


# Profile velocity with a torque reduction and a message word: telegrams 102 and 103.
#
# Source: docs/motion.md "MELDW and MOMRED". 6072h is the limit the drive had at start without the reduction.


_ENABLED_STATES = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
_READY_STATES = (*_ENABLED_STATES, State.SWITCHED_ON, State.READY_TO_SWITCH_ON)


_MESSAGE_STATES = tuple(
    MessageWord.states(enabled=state in _ENABLED_STATES, ready=state in _READY_STATES) for state in STATE_OF_STATUS
)
"""By the Statusword under ``STATE_MASK``."""
_TARGET_REACHED = StatusBit.TARGET_REACHED


def message_word(drive: DriveType) -> MessageWord:
    """MELDW of a drive, as far as it has the objects."""
    return MessageWord(int(drive.scaling.reference(Quantity.SPEED)), torque=drive.has("current_actual"))


def message_of(message: MessageWord, feedback: DriveFeedback, outputs: Outputs) -> int:
    """MELDW from the reports of a drive."""
    statusword = feedback.statusword
    return message.word(
        feedback.velocity_actual,
        feedback.velocity_demand,
        feedback.current_actual,
        _MESSAGE_STATES[statusword & STATE_MASK],
        target_reached=statusword & _TARGET_REACHED != 0,
        motor_hot=outputs.motor_hot,
        stage_hot=outputs.stage_hot,
    )


class TorqueExecutor(SpeedExecutor):
    """The speed as ever; the torque limit follows the reduction in every state, and is whole without a PLC."""

    def __init__(self, records: AxisRecords) -> None:
        super().__init__(records)
        self._message: MessageWord | None = None
        self._base = 0

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        if drive.max_torque <= 0:
            raise Dsp402Error("Max Torque 6072h", drive.max_torque, "a value above 0, which MOMRED reduces")
        super().set_drive(drive, homing_method)
        self._message = message_word(drive)
        self._base = self.command.max_torque = drive.max_torque

    def refuse(self) -> None:
        super().refuse()
        self.report.message = 0

    def step(self) -> Reason | None:
        demand = self.demand
        reduction = demand.torque_reduction if demand.connected else 0
        self.command.max_torque = reduced_torque(self._base, reduction)
        reason = super().step()
        if self._message is not None:
            self.report.message = message_of(self._message, self.feedback, self.outputs)
        return reason
