"""Speed with load values of the motor: telegram 20.

Source: docs/motion.md "Telegram 20". 6078h also gives the torque in 1/1000 of the rated value; a drive without it shows 0.
"""

from __future__ import annotations

from pdgw.dsp402.drive_type import DriveType, Quantity
from pdgw.gateway.axis.executors.speed import SpeedExecutor
from pdgw.gateway.motion.messages import namur_word
from pdgw.gateway.motion.units import round_half_away
from pdgw.gateway.reasons import Reason
from pdgw.profidrive.datatypes import N2_100_PERCENT, DataType

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
