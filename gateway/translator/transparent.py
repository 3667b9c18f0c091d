"""Telegram 100: the manufacturer's transparent telegram.

Source: docs/telegrams.md "Telegram 100", docs/translation.md; the manufacturer's guide 4.3.3. Values pass unchanged but
for the range check against the objects' limits. The one thing the gateway adds is what no drive can know: after loss of
the PLC the drive is stopped, and an ON that stands when the PLC (re)connects, a fault is reset, the drive restarts or
takes the enable back is not passed until the PLC has shown Controlword bit 0 = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter

from pdgw.dsp402.images import DriveFeedback, References
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.states import STATE_OF_STATUS, ControlBit, State
from pdgw.gateway.reasons import Reason
from pdgw.gateway.translator.base import PlcLossReaction, Translator, TranslatorSettings
from pdgw.gateway.translator.power import CW_DISABLE_VOLTAGE, CW_ENABLE_OPERATION, CW_QUICK_STOP, CW_SHUTDOWN
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

_MODES = frozenset(mode.value for mode in Mode) - {Mode.VL_VELOCITY, Mode.CYCLIC_POSITION, Mode.CYCLIC_VELOCITY}
_COMMAND = CW_ENABLE_OPERATION
_FAULTS = (State.FAULT, State.FAULT_REACTION_ACTIVE)
_STATE_BITS = 0x6F


class TransparentTranslator(Translator):
    """Controlword, mode and values to the drive as they come, under the gateway's interlock."""

    def __init__(self, telegram: Telegram, settings: TranslatorSettings) -> None:
        super().__init__(telegram, settings)
        self._limits = tuple((name, *DRIVE_OBJECTS.attribute(name).limits) for name in SETPOINT_ATTRIBUTES[2:])
        self._read = attrgetter(*ACTUAL_ATTRIBUTES)
        self._references_valid = False
        self._window = 0
        self._last: Sequence[int] | None = None
        self._mode_refused = False
        self._locked = True
        self._ever_connected = False
        self._connected = False
        self._stopping = False
        self._doubt = False
        self._acknowledge_armed = False
        self._previous: State | None = None

    @property
    def released(self) -> bool:
        return not self._locked

    def set_references(self, references: References | None, homing_method: int = 0) -> None:
        self._references_valid = False
        if references is None or not self._usable(references):
            return
        self._references_valid = True
        self._window = max(1, int(references.speed_reference * self.settings.standstill_window))

    def drive_restarted(self) -> None:
        self._lock()

    def sdo_done(self, error: str | None) -> None:
        """Telegram 100 asks for no SDO writes."""

    def step(self, setpoints: Sequence[int] | None, feedback: DriveFeedback, drive_ok: bool, now: int) -> Sequence[int]:
        statusword = feedback.statusword
        state = STATE_OF_STATUS[statusword & 0x7F]
        previous = self._previous
        self._previous = state
        command = self.command
        self.reason = None
        if setpoints is None:
            if self._connected:
                self._connected = False
                self._stopping = True
                self._lock()
            self.reason = Reason.PLC_LOST if self._ever_connected else Reason.NO_PLC
        elif not self._connected:
            self._connected = self._ever_connected = True
            self._acknowledge_armed = False
            self._lock()
        if not self._references_valid:
            command.controlword = CW_DISABLE_VOLTAGE
            self.reason = Reason.REFERENCE_INVALID if drive_ok else Reason.DRIVE_OFFLINE
        elif not drive_ok:
            self._lock()
            command.controlword = CW_QUICK_STOP
            self.reason = Reason.DRIVE_OFFLINE
        else:
            if setpoints is not None:
                self._take_values(setpoints)
            word = setpoints[0] if setpoints is not None else 0
            command.controlword = self._controlword(word, state, previous, feedback.velocity_actual)
            if self._mode_refused and self.reason is None:
                self.reason = Reason.MODE_VALUE
        actuals = list(self._read(feedback))
        actuals[1] &= 0xFF
        if not drive_ok:
            actuals[0] = statusword & ~_STATE_BITS | 0x08
        return actuals

    def _lock(self) -> None:
        self._locked = True

    def _controlword(self, word: int, state: State | None, previous: State | None, velocity: int) -> int:
        if state is None:
            self._lock()
            self.reason = Reason.DRIVE_UNKNOWN_STATE
            return CW_QUICK_STOP
        fell_back = (
            previous is State.OPERATION_ENABLED
            and state in {State.SWITCHED_ON, State.READY_TO_SWITCH_ON}
            and self.command.controlword & _COMMAND == _COMMAND
        )
        if fell_back or state in _FAULTS:
            self._lock()
            self._doubt = fell_back
        elif state is State.SWITCH_ON_DISABLED:
            self._doubt = False
        if not self._locked:
            if state is not State.OPERATION_ENABLED:
                self.reason = Reason.NOT_OPERATING
            return word
        powered = state is State.OPERATION_ENABLED or state is State.QUICK_STOP_ACTIVE
        if self._stopping and powered and (not self._connected or word & ControlBit.ENABLE_VOLTAGE):
            return self._stop(state, velocity)
        self._stopping = False
        if not self._connected:
            coast = self.settings.on_plc_loss is PlcLossReaction.COAST or not powered
            return CW_DISABLE_VOLTAGE if coast else CW_QUICK_STOP
        if not word & ControlBit.SWITCH_ON and state not in _FAULTS:
            self._locked = self._doubt = False
            return word
        self.reason = Reason.DRIVE_FAULT if state in _FAULTS else Reason.NEEDS_OFF
        if (powered or self._doubt) and word & ControlBit.ENABLE_VOLTAGE:
            return CW_QUICK_STOP  # in operation by no command of this PLC, or its Statusword is wrong about that
        if not word & ControlBit.FAULT_RESET:
            self._acknowledge_armed = True
        return word & ControlBit.FAULT_RESET if self._acknowledge_armed else CW_DISABLE_VOLTAGE

    def _stop(self, state: State, velocity: int) -> int:
        """The loss reaction, kept up to standstill even when the PLC is back."""
        reaction = self.settings.on_plc_loss
        if reaction is PlcLossReaction.QUICK_STOP or state is State.QUICK_STOP_ACTIVE:
            return CW_QUICK_STOP
        if reaction is PlcLossReaction.COAST:
            return CW_DISABLE_VOLTAGE
        if -self._window <= velocity <= self._window:
            return CW_SHUTDOWN
        self.command.target_velocity = 0
        return CW_ENABLE_OPERATION | ControlBit.HALT

    def _take_values(self, setpoints: Sequence[int]) -> None:
        """Values and mode, limited to what the objects allow; the Controlword is decided elsewhere."""
        if setpoints == self._last:
            return
        self._last = setpoints
        command = self.command
        mode = setpoints[1] & 0xFF
        if mode & 0x80:
            mode -= 0x100
        known = mode in _MODES
        self._mode_refused = bool(mode) and not known
        if known:
            command.modes_of_operation = mode
        for (attribute, low, high), value in zip(self._limits, setpoints[2:], strict=True):
            if value < low or value > high:
                self.saturations += 1
                value = low if value < low else high  # noqa: PLW2901
            setattr(command, attribute, value)
