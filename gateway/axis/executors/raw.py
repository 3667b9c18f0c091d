"""Raw operation: values for the drive's objects as they come, limited to what the objects allow.

Source: docs/translation.md; the manufacturer's guide 4.3.3. What the gateway adds is the interlock, and the ramp of a PLC loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter

from pdgw.dsp402.acting import HALT_SWITCHES_OFF
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.states import STATE_BITS, STATUS_OF, ControlBit, State
from pdgw.gateway.axis.demand_report import RawDemand, Report
from pdgw.gateway.axis.executors.executor import AxisRecords, Executor
from pdgw.gateway.axis.power_states import Action
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.base.reasons import Reason

_PASS, _RAMP = Action.PASS, Action.RAMP
_BYTE = 0xFF
_CONTROLWORD, _MODE, _FIRST_VALUE = 0, 1, 2
"""Places of the words in a transparent telegram that are not passed on unchanged."""


class RawExecutor(Executor):
    """``setpoints`` and ``actuals`` are attributes of the images in the order of ``RawDemand.raw`` and ``Report.raw``."""

    def __init__(self, records: AxisRecords, setpoints: Sequence[str], actuals: Sequence[str]) -> None:
        super().__init__(records)
        assert isinstance(records.demand, RawDemand), "the adapter of its telegram has one"
        self._asked = records.demand
        self._setpoints = tuple(setpoints)
        self._limits: tuple[tuple[str, int, int], ...] = ()
        self._modes: dict[int, int] = {}
        """Modes the drive knows, by the byte that carries them."""
        self._read = attrgetter(*actuals)
        self.feedback.velocity_demand = 0  # passes unchanged, also before the drive has sent one
        self._last: Sequence[int] = ()
        self._mode_refused = False

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        if self.settings.on_plc_loss is PlcLossReaction.RAMP:
            HALT_SWITCHES_OFF.check(drive.acting)
        self._limits = tuple((name, *drive.limits(name)) for name in self._setpoints)
        self._modes = {mode & _BYTE: mode for mode in drive.modes}
        self._last = ()

    def refuse(self) -> Report:
        self.command.controlword = self.interlock.controlword
        return self._report(self.interlock.reason)

    def _report(self, reason: Reason | None) -> Report:
        values = self._read(self.feedback)
        if not self.inputs.drive_ok:
            statusword, *rest = values
            values = (statusword & ~STATE_BITS | STATUS_OF[State.FAULT], *rest)
        self.report.raw = values
        return self.report.fill(reason)

    def step(self) -> Report:
        interlock, demand, command = self.interlock, self._asked, self.command
        action, controlword, reason = interlock.cell.action, interlock.controlword, interlock.reason
        raw = demand.raw
        if raw is not None:
            # During the ramp the drive must keep the mode and the deceleration that the ramp began with.
            if demand.connected and action is not _RAMP and raw is not self._last:
                self._take(raw)
            if action is _PASS:
                controlword = raw[_CONTROLWORD]
        if action is _RAMP:
            controlword |= ControlBit.HALT
            # A torque mode may have no Halt (cyclic synchronous torque): set the setpoints to 0, so that they do not
            # accelerate the axis.
            command.target_velocity = command.target_torque = 0
            self._last = ()
        command.controlword = controlword
        return self._report(Reason.MODE_VALUE if reason is None and self._mode_refused else reason)

    def _take(self, values: Sequence[int]) -> None:
        """Values and mode; those that stay the same are left alone."""
        command, last = self.command, self._last
        self._last = values
        mode = values[_MODE] & _BYTE
        self._mode_refused = mode != 0 and mode not in self._modes
        if mode in self._modes:
            command.modes_of_operation = self._modes[mode]
        position = _FIRST_VALUE
        count = len(values)
        while position < count:
            value = values[position]
            if not last or value != last[position]:
                attribute, low, high = self._limits[position]
                if value < low or value > high:
                    self.outputs.saturations += 1
                    value = low if value < low else high
                setattr(command, attribute, value)
            position += 1
