"""Speed with a torque reduction (telegrams 102 and 103), and the words of a telegram that show the drive.

MELDW, source: docs/motion.md "MELDW and MOMRED".
"""

from __future__ import annotations

from pdgw.dsp402.drive_type import DriveType, Dsp402Error, Quantity
from pdgw.dsp402.states import STATE_OF_STATUS, State, StatusBit
from pdgw.gateway.axis.demand_report import SHOWN_FAULT, STATE_MASK, Report
from pdgw.gateway.axis.executors.executor import AxisRecords
from pdgw.gateway.axis.executors.message_words import MessageWord, namur_word, reduced_torque
from pdgw.gateway.axis.executors.speed import SpeedExecutor
from pdgw.gateway.axis.values import Inputs, Outputs
from pdgw.gateway.base.fault_numbers import first_warning
from pdgw.gateway.motion.units import round_half_away
from pdgw.profidrive.datatypes import N2_100_PERCENT, DataType

_RATED = 1000
_LOWEST, _HIGHEST = DataType.N2.integer_range


def _n2(value: int, full: int) -> int:
    """A share of ``full`` as N2; 0 where that is not known."""
    if not full:
        return 0
    return max(_LOWEST, min(round_half_away(value * N2_100_PERCENT, full), _HIGHEST))


_ENABLED_STATES = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
_READY_STATES = (*_ENABLED_STATES, State.SWITCHED_ON, State.READY_TO_SWITCH_ON)


_MESSAGE_STATES = tuple(
    MessageWord.states(enabled=state in _ENABLED_STATES, ready=state in _READY_STATES) for state in STATE_OF_STATUS
)
"""By the Statusword under ``STATE_MASK``."""


class DriveWords:
    """Words that show the drive: MELDW, the load values and MELD_NAMUR of telegram 20, FAULT_CODE and WARN_CODE.

    Source: docs/motion.md "Telegram 20". 6078h also gives the torque in 1/1000 of the rated value; a drive without it shows 0.
    """

    def __init__(self, message: int, load: int, codes: int) -> None:
        self._message, self._load, self._codes = message, load, codes
        """Places of the words, -1 without them."""
        self._reports: MessageWord | None = None
        self._full_power = 0
        """Rated torque at the reference speed, in the units of torque x velocity."""

    def set_drive(self, drive: DriveType) -> None:
        """Set the drive: MELDW as far as it has the objects."""
        speed = drive.scaling.reference(Quantity.SPEED)
        self._reports = MessageWord(int(speed), torque=drive.has("current_actual"))
        self._full_power = int(_RATED * speed)

    def step(self, flags: int, inputs: Inputs, outputs: Outputs, *, known: bool) -> None:
        """One cycle. ``flags``: those of the axis, ``known``: the drive's units are."""
        actuals, feedback, reports = outputs.actuals, inputs.feedback, self._reports
        if self._message >= 0 and reports is not None:
            status = feedback.statusword
            word = reports.word(
                feedback.velocity_actual,
                feedback.velocity_demand,
                feedback.current_actual,
                _MESSAGE_STATES[status & STATE_MASK],
                target_reached=status & StatusBit.TARGET_REACHED != 0,
                motor_hot=outputs.motor_hot,
                stage_hot=outputs.stage_hot,
            )
            actuals[self._message] = word if known else 0
        place = self._load
        if place >= 0:
            torque = feedback.current_actual if known else 0
            actuals[place] = actuals[place + 1] = _n2(torque, _RATED)
            actuals[place + 2] = _n2(torque * feedback.velocity_actual, self._full_power)
            actuals[place + 3] = namur_word(outputs.drive_error)
        place = self._codes
        if place >= 0:
            actuals[place] = inputs.fault_code if flags & SHOWN_FAULT else 0
            actuals[place + 1] = first_warning(outputs.warning)


class TorqueExecutor(SpeedExecutor):
    """Telegrams 102 and 103: a torque limit that follows the reduction in every state, and is whole without a PLC.

    6072h is the limit the drive had at start without the reduction.
    """

    def __init__(self, records: AxisRecords) -> None:
        super().__init__(records)
        self._base = 0

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        if drive.max_torque <= 0:
            raise Dsp402Error("Max Torque 6072h", drive.max_torque, "a value above 0, which MOMRED reduces")
        super().set_drive(drive, homing_method)
        self._base = self.command.max_torque = drive.max_torque

    def step(self) -> Report:
        demand = self._asked
        reduction = demand.torque_reduction if demand.connected else 0
        self.command.max_torque = reduced_torque(self._base, reduction)
        return super().step()
