"""Telegrams 1, 2, 3 and 20: velocity mode (6060h = 3).

Source: docs/translation.md "Standard telegrams", docs/telegrams.md "Normalisation"; the manufacturer's guide 6.1-6.6.
Left out: the encoder words of telegram 3, which the axis fills in (``gateway.encoder.SensorWords``), and telegram 20's current,
torque and power, which the velocity PDOs do not carry: they are 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from pdgw.dsp402.images import DriveFeedback, References
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.states import StatusBit
from pdgw.gateway.reasons import Reason
from pdgw.gateway.translator.base import LIMIT_STANDING_NS, SetpointEnable, Translator, TranslatorSettings
from pdgw.gateway.translator.power import (
    CONTROL_BY_PLC,
    CW_ENABLE_OPERATION,
    ZSW1_FAULT,
    ZSW1_STATE,
    ZSW1_STOPPING,
    ZSW1_TRANSPARENT,
    Phase,
    PowerControl,
)
from pdgw.profidrive.datatypes import DataType, Normalisation, n2, n4
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Telegram

_STW1 = signal("STW1")
_ZSW1 = signal("ZSW1")
_RAMP_GENERATOR = _STW1.bit("ENABLE_RAMP_GENERATOR").mask
_UNFREEZE = _STW1.bit("UNFREEZE_RAMP_GENERATOR").mask
_ENABLE_SETPOINT = _STW1.bit("ENABLE_SETPOINT").mask
_SETPOINT_BITS = _RAMP_GENERATOR | _UNFREEZE | _ENABLE_SETPOINT
_DEVICE_BITS = 0xF000
"""STW1 12-15 are device specific and pass to Controlword 12-15."""
_WARNING = _ZSW1.bit("WARNING").mask
_TRANSPARENT = ZSW1_TRANSPARENT | _ZSW1.bit("TARGET_REACHED").mask


class VelocityTranslator(Translator):
    """Speed setpoint to 60FFh, 606Ch to speed actual value, OFF1 as a ramp to standstill.

    An axis that a limit switch stopped does not move on by itself when the switch is released: 60FFh is 0 until the PLC takes
    its setpoint through 0 (or to the other direction, off the switch), or out of operation.
    """

    def __init__(self, telegram: Telegram, settings: TranslatorSettings) -> None:
        super().__init__(telegram, settings)
        self.power = PowerControl(settings)
        self._setpoint_index, self._setpoint_type = next(
            (index, item.type) for index, item in enumerate(telegram.setpoints.signals) if item.name.startswith("NSOLL")
        )
        self._actual_index, self._actual_type = next(
            (index, item.type) for index, item in enumerate(telegram.actuals.signals) if item.name.startswith("NIST")
        )
        self._actuals = [0] * len(telegram.actuals.signals)
        self._setpoint: Normalisation | None = None
        self._actual: Normalisation | None = None
        self._window = 0
        self._word = 0
        self._controlled = False
        self._wire: int | None = None
        self._value = 0
        self._target = 0
        self._standing_since = -1
        self._stopped = 0
        """The setpoint with which the axis stood at a limit; 0: none."""
        self._profidrive = settings.setpoint_enable is SetpointEnable.PROFIDRIVE

    @property
    def released(self) -> bool:
        return self.power.phase is Phase.FOLLOW

    def set_references(self, references: References | None, homing_method: int = 0) -> None:
        self._setpoint = self._actual = None
        self._wire = None
        if references is None or not self._usable(references):
            return
        reference = references.speed_reference
        limits = DRIVE_OBJECTS.attribute("target_velocity").limits
        actual_limits = DRIVE_OBJECTS.attribute("velocity_actual").limits
        self._setpoint = _normalisation(self._setpoint_type, reference, limits)
        self._actual = _normalisation(self._actual_type, reference, actual_limits)
        self._window = max(1, int(reference * self.settings.standstill_window))

    def drive_restarted(self) -> None:
        self.power.lock()
        self._target = 0

    def sdo_done(self, error: str | None) -> None:
        """Velocity telegrams ask for no SDO writes."""

    def step(self, setpoints: Sequence[int] | None, feedback: DriveFeedback, drive_ok: bool, now: int) -> Sequence[int]:
        command = self.command
        actuals = self._actuals
        statusword = feedback.statusword
        velocity = feedback.velocity_actual
        actual = self._actual
        if actual is None or self._setpoint is None:
            return self._refuse(setpoints, statusword, drive_ok)
        connected = setpoints is not None
        in_control = False
        if setpoints is not None:
            word = setpoints[0]
            if word & CONTROL_BY_PLC:
                in_control = True
                self._word = word
                self._controlled = True
            elif not self._controlled:
                connected = False
        else:
            self._controlled = False
        word = self._word
        power = self.power
        window = self._window
        standstill = -window <= velocity <= window
        controlword = power.step(word, connected, drive_ok, statusword, standstill, now)
        reason = power.reason
        if power.ramping:
            self._target = 0
            state_bits = ZSW1_STOPPING
        else:
            state_bits = ZSW1_STATE[statusword & 0x7F]
            if controlword & 0xF != CW_ENABLE_OPERATION or not connected:
                self._target = 0
            elif word & _SETPOINT_BITS == _SETPOINT_BITS:
                if in_control and setpoints is not None:
                    wire = setpoints[self._setpoint_index]
                    if wire != self._wire:
                        self._convert(wire, self._setpoint)
                    self._target = self._value
            else:
                reason = Reason.SETPOINT_DISABLED
                if self._profidrive and not (word & _RAMP_GENERATOR and word & _ENABLE_SETPOINT):
                    self._target = 0
        target = self._target
        if self._stopped or statusword & StatusBit.INTERNAL_LIMIT:
            target = self._held_at_limit(target, statusword, standstill, now)
            if self._stopped and reason is None:
                reason = Reason.STOPPED_AT_LIMIT
        else:
            self._standing_since = -1
        if not in_control and setpoints is not None:
            reason = Reason.NO_CONTROL
        self.reason = reason
        command.controlword = controlword | (word & _DEVICE_BITS if connected else 0)
        command.target_velocity = target
        if not drive_ok:
            actuals[0] = statusword & ZSW1_TRANSPARENT | ZSW1_FAULT
        else:
            actuals[0] = state_bits | statusword & _TRANSPARENT | (_WARNING if self.warning else 0)
        actuals[self._actual_index] = actual.to_wire(velocity)
        return actuals

    def _held_at_limit(self, target: int, statusword: int, standstill: bool, now: int) -> int:
        """The target, or 0 while an axis that stood at a limit is asked for the same direction again."""
        if target * self._stopped > 0:
            return 0
        self._stopped = 0
        self.warning = False
        if not (target and standstill and statusword & StatusBit.INTERNAL_LIMIT):
            self._standing_since = -1
        elif self._standing_since < 0:
            self._standing_since = now
        elif now - self._standing_since >= LIMIT_STANDING_NS:
            self._stopped = target
            self.warning = True
            return 0
        return target

    def _convert(self, wire: int, conversion: Normalisation) -> None:
        self._wire = wire
        self._value = conversion.to_value(wire)
        if conversion.saturates(wire):
            self.saturations += 1

    def _refuse(self, setpoints: Sequence[int] | None, statusword: int, drive_ok: bool) -> Sequence[int]:
        """Without valid references nothing is converted, nothing is enabled and no OFF is taken note of."""
        self.power.lock()
        if setpoints is None:
            self._controlled = False
        self.reason = Reason.REFERENCE_INVALID if drive_ok else Reason.DRIVE_OFFLINE
        self._stopped = 0
        self.warning = False
        self.command.controlword = 0
        self.command.target_velocity = 0
        self._actuals[0] = statusword & ZSW1_TRANSPARENT | ZSW1_FAULT
        self._actuals[self._actual_index] = 0
        return self._actuals


def _normalisation(data_type: DataType, reference: Fraction, limits: tuple[int, int]) -> Normalisation:
    return n2(reference, limits) if data_type is DataType.N2 else n4(reference, limits)
