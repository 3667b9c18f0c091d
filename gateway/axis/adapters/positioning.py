"""Telegram 9: positioning with MDI and homing.

Source: docs/telegrams.md, docs/translation.md "Positioning, telegram 9 (MDI)". Left out: traversing blocks (telegram 7) and
jogging, which the drives do not have; STW2 is not evaluated.
"""

from __future__ import annotations

from collections.abc import Sequence

from pdgw.gateway.axis.adapters.base import ControlWordAdapter
from pdgw.gateway.axis.demand_report import Demand, Report, Task
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.motion.modulo import Direction
from pdgw.profidrive.datatypes import N4_PER_N2
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Telegram

_STW1 = signal("STW1")
_DO_NOT_REJECT = _STW1.bit("DO_NOT_REJECT", positioning=True).mask
_NO_INTERMEDIATE_STOP = _STW1.bit("NO_INTERMEDIATE_STOP", positioning=True).mask
_ACTIVATE_TASK = _STW1.bit("ACTIVATE_TASK", positioning=True).mask
_START_HOMING = _STW1.bit("START_HOMING", positioning=True).mask
_MDI = signal("SATZANW").bit("MDI").mask
_METHOD = signal("SATZANW").bit("HOMING_METHOD")
_ACTUAL_METHOD = signal("AKTSATZ").bit("HOMING_METHOD").mask
_MDI_ACTIVE = signal("AKTSATZ").bit("MDI_ACTIVE").mask
_ABSOLUTE = signal("MDI_MOD").bit("ABSOLUTE").mask
_POSITIVE = signal("MDI_MOD").bit("POSITIVE_DIRECTION").mask
_NEGATIVE = signal("MDI_MOD").bit("NEGATIVE_DIRECTION").mask
_DIRECTIONS = {_POSITIVE: Direction.POSITIVE, _NEGATIVE: Direction.NEGATIVE}


class PositioningAdapter(ControlWordAdapter):
    """Edges of STW1.6 and .11 are found here, with the data of their frame; a bit that stands when the PLC comes is none."""

    def __init__(self, telegram: Telegram, settings: AxisSettings) -> None:
        super().__init__(telegram, settings)
        self._satzanw = self.setpoint("SATZANW")
        self._target = self.setpoint("MDI_TARPOS")
        self._velocity = self.setpoint("MDI_VELOCITY")
        self._acceleration = self.setpoint("MDI_ACC")
        self._deceleration = self.setpoint("MDI_DEC")
        self._mode = self.setpoint("MDI_MOD")
        self._aktsatz = self.actual("AKTSATZ")
        self._position = self.actual("XIST_A")

    def read(self, setpoints: Sequence[int] | None, demand: Demand) -> None:
        demand.task = None
        demand.homing_edge = False
        word = None if setpoints is None else setpoints[self.stw1]
        activated = False
        if word != self.word:
            new = not demand.connected
            if self.take(word, demand) and word is not None:
                activated = word & _ACTIVATE_TASK != 0 and not (demand.activate or new)
                demand.homing_edge = word & _START_HOMING != 0 and not (demand.homing or new)
                demand.reject = not word & _DO_NOT_REJECT
                demand.intermediate_stop = not word & _NO_INTERMEDIATE_STOP
                demand.activate = word & _ACTIVATE_TASK != 0
                demand.homing = word & _START_HOMING != 0
        if setpoints is None or not demand.in_control:
            return
        selection = setpoints[self._satzanw]
        demand.tasks_selected = selection & _MDI != 0
        if demand.homing:
            demand.homing_method = _METHOD.of(selection)
            demand.homing_velocity = setpoints[self._velocity]
        if activated:
            demand.task = self._task(setpoints)

    def kept(self, demand: Demand) -> tuple[object, ...]:
        return (*super().kept(demand), demand.activate, demand.homing, demand.tasks_selected)

    def _task(self, setpoints: Sequence[int]) -> Task:
        mode = setpoints[self._mode]
        return Task(
            setpoints[self._target],
            not mode & _ABSOLUTE,
            setpoints[self._velocity],
            setpoints[self._acceleration] * N4_PER_N2,
            setpoints[self._deceleration] * N4_PER_N2,
            _DIRECTIONS.get(mode & (_POSITIVE | _NEGATIVE), Direction.SHORTEST),
        )

    def write(self, report: Report, actuals: list[int]) -> None:
        actuals[self.zsw1] = self.status(report.flags)
        actuals[self._aktsatz] = report.homing_method & _ACTUAL_METHOD | (_MDI_ACTIVE if report.tasks_active else 0)
        actuals[self._position] = report.position
