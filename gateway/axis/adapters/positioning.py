"""Telegram 9: positioning with MDI and homing.

Source: docs/telegrams.md, docs/translation.md "Positioning, telegram 9 (MDI)". Left out: traversing blocks (telegram 7) and
jogging, which the drives do not have; STW2 is not evaluated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from pdgw.gateway.axis.adapters.positioner import PositionerAdapter
from pdgw.gateway.axis.demand_report import Report
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.profidrive.datatypes import N4_PER_N2
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Telegram

_MDI = signal("SATZANW").bit("MDI").mask
_METHOD = signal("SATZANW").bit("HOMING_METHOD")
_ACTUAL_METHOD = signal("AKTSATZ").bit("HOMING_METHOD").mask
_MDI_ACTIVE = signal("AKTSATZ").bit("MDI_ACTIVE").mask
_ABSOLUTE = signal("MDI_MOD").bit("ABSOLUTE").mask
_POSITIVE = signal("MDI_MOD").bit("POSITIVE_DIRECTION").mask
_NEGATIVE = signal("MDI_MOD").bit("NEGATIVE_DIRECTION").mask


class PositioningAdapter(PositionerAdapter):
    """Positions, speeds and ramps are fractions of the references."""

    IGNORED: ClassVar[int] = PositionerAdapter.IGNORED | signal("STW1").word(
        "JOG_1_ON", "JOG_2_ON", "EXTERNAL_BLOCK_CHANGE", positioning=True
    )

    def __init__(self, telegram: Telegram, settings: AxisSettings) -> None:
        super().__init__(telegram, settings, "SATZANW", "MDI_MOD")
        self._first = self.setpoint("MDI_TARPOS", "MDI_VELOCITY", "MDI_ACC", "MDI_DEC")
        self._aktsatz = self.actual("AKTSATZ")
        self._position = self.actual("XIST_A")

    def forget(self) -> None:
        asked = self.asked
        mdi = asked.mdi
        asked.forget()
        asked.mdi = mdi  # AKTSATZ shows it without control, too

    def read_controls(self, controls: Sequence[int]) -> None:
        asked = self.asked
        selection, mode = controls[1], controls[2]
        asked.mdi = selection & _MDI != 0
        asked.homing_method = _METHOD.of(selection)
        asked.absolute = mode & _ABSOLUTE != 0
        asked.positive = mode & _POSITIVE != 0
        asked.negative = mode & _NEGATIVE != 0

    def read_values(self, setpoints: Sequence[int]) -> None:
        asked, first = self.asked, self._first
        asked.target, asked.velocity = setpoints[first], setpoints[first + 1]
        asked.acceleration, asked.deceleration = setpoints[first + 2] * N4_PER_N2, setpoints[first + 3] * N4_PER_N2

    def write(self, report: Report, actuals: list[int]) -> None:
        actuals[self.zsw1] = self.status(report.flags)
        actuals[self._aktsatz] = report.homing_method & _ACTUAL_METHOD | (_MDI_ACTIVE if report.tasks_active else 0)
        actuals[self._position] = report.position
