"""Telegram 100: the manufacturer's transparent telegram, whose signals are objects of the drive by their names.

Source: docs/telegrams.md "Telegram 100", docs/translation.md; the manufacturer's guide 4.3.3. Values are not scaled; the mode of
operation travels in the low byte of its word.
"""

from __future__ import annotations

from collections.abc import Sequence

from pdgw.gateway.axis.adapters.adapter import POWER_BITS, WISHES, Adapter
from pdgw.gateway.axis.demand_report import PowerWish, RawDemand, Report
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Telegram

SETPOINT_ATTRIBUTES = (
    "controlword",
    "modes_of_operation",
    "target_torque",
    "target_position",
    "profile_velocity",
    "profile_acceleration",
    "profile_deceleration",
    "dynamic_speed_limit",
    "dynamic_torque_limit",
    "digital_outputs",
    "digital_outputs_mask",
    "target_velocity",
)
"""Drive image attribute of each setpoint signal, in telegram order."""
ACTUAL_ATTRIBUTES = (
    "statusword",
    "modes_of_operation_display",
    "position_actual",
    "velocity_demand",
    "velocity_actual",
    "current_actual",
    "dc_link_voltage",
    "digital_inputs",
    "analogue_input_1",
    "analogue_input_2",
    "encoder_position",
    "error_code",
)
"""Drive image attribute of each actual-value signal, in telegram order."""

_FAULT_ACKNOWLEDGE = signal("STW1").bit("FAULT_ACKNOWLEDGE").mask
"""The same bit in STW1 and the Controlword (a test)."""
_RAW = {
    PowerWish.OFF: PowerWish.RAW_OFF,
    PowerWish.OFF_DISABLED: PowerWish.RAW_OFF,
    PowerWish.QUICK_STOP_DISABLED: PowerWish.QUICK_STOP,
}
_WISHES = tuple(_RAW.get(wish, wish) for wish in WISHES)
"""By bits 0-3 of the Controlword, where bit 3 says nothing beside Shutdown and Quick Stop (CiA 402, commands)."""


class TransparentAdapter(Adapter):
    """The Controlword is read for the interlock; everything else passes."""

    def __init__(self, telegram: Telegram) -> None:
        self._asked = RawDemand()
        super().__init__(telegram, self._asked)
        self._controlword = self.setpoint(*telegram.setpoints.names[: len(SETPOINT_ATTRIBUTES)])
        self.actual(*telegram.actuals.names[: len(ACTUAL_ATTRIBUTES)])
        self._mode_display = self.actual("Modes of Operation Display")
        self._armed = False
        """Controlword bit 7 was 0 in this connection: an acknowledge is an edge."""

    def read(self, setpoints: Sequence[int] | None) -> None:
        demand = self._asked
        if setpoints is None:
            demand.connected = self._armed = False
            return
        word = setpoints[self._controlword]
        demand.connected = True
        demand.power = _WISHES[word & POWER_BITS]
        acknowledge = word & _FAULT_ACKNOWLEDGE != 0
        demand.acknowledge = acknowledge and self._armed
        self._armed = self._armed or not acknowledge
        demand.raw = setpoints

    def write(self, flags: int, report: Report, actuals: list[int]) -> None:
        actuals[:] = report.raw
        actuals[self._mode_display] &= _BYTE


_BYTE = 0xFF
"""The low byte of a word, which carries an Integer8."""
