"""The encoder machine: one ``step`` is one cycle of one channel of an encoder with telegrams 81 to 84.

Sensor commands become presets (6003h, 6010h/n), position and speed G1_XIST1/2/3 and NIST_A/B. Source: docs/devices.md
"Encoder telegrams".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from pdgw.base.durations import MS
from pdgw.ds301.node.node import NodeNotice
from pdgw.gateway.axis.adapters.encoder_words import EncoderAdapter
from pdgw.gateway.axis.executors.sensor import EncoderReferences, SensorChannel
from pdgw.gateway.axis.settings import SensorSettings
from pdgw.gateway.axis.supervision.drive_events import CANOPEN_FAULT, Acknowledgement, NodeWatch
from pdgw.gateway.axis.supervision.encoder_speed import REMEDY
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.axis.values import (
    EncoderInput,
    News,
    Outputs,
    RestartAsked,
    SdoAnswer,
    SdoWrite,
    gateway_fault,
)
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import DEVICE_WARNING, EMCY_WARNING, INTERNAL_FAULT, FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.profidrive.encoder import EncoderControl, PresetRequest, speed_normalisation
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.normalisation import Normalisation
from pdgw.profidrive.sensor_states import SensorError, SensorState
from pdgw.profidrive.sign_of_life import SignOfLife
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram

_FAULT = signal("ZSW2_ENC").bit("FAULT").mask
_WARNING = signal("ZSW2_ENC").bit("WARNING").mask
_DEVIATES = warning_bits(FaultNumber.VELOCITY_DEVIATES)
_SENSOR_REASONS = {
    SensorState.ERROR: Reason.SENSOR_ERROR,
    SensorState.ACKNOWLEDGING: Reason.SENSOR_ERROR,
    SensorState.PARKED: Reason.SENSOR_PARKED,
    SensorState.PRESETTING: Reason.SENSOR_PRESETTING,
}
_IN_ERROR = (SensorState.ERROR, SensorState.ACKNOWLEDGING)
_LATCHED = (
    INTERNAL_FAULT,
    CANOPEN_FAULT,
    FaultNumber.NODE_LOST,
    FaultNumber.BUS_LOST,
    FaultNumber.NODE_RESTARTED,
)
"""Fault numbers after which the PLC has to acknowledge: an EMCY, and the loss of an encoder that was online."""


@dataclass(slots=True, eq=False)
class EncoderInputs:
    """Inputs of one step of an encoder; one object, filled again for each step. The step empties ``news``. The recorder takes
    every field."""

    source: EncoderInput
    now: int = 0
    """Monotonic nanoseconds."""
    setpoints: Sequence[int] | None = None
    """Raw signal values in telegram order, None without a valid PLC."""
    ok: bool = False
    """The encoder is configured and its data is fresh."""
    unacknowledged: bool = False
    """The fault buffer has a fault that is not acknowledged."""
    news: list[News] = field(default_factory=list)


class EncoderMachine:
    """An encoder channel with one telegram; GatewayError if the telegram is not for encoders.

    The driver fills ``inputs`` before each ``step``. ``outputs`` has the result until the next step.
    """

    def __init__(self, number: int, settings: SensorSettings, source: EncoderInput) -> None:
        if number not in ENCODER_TELEGRAM_NUMBERS:
            raise GatewayError(
                f"telegram: {number} is not supported for an encoder, allowed {list(ENCODER_TELEGRAM_NUMBERS)}"
            )
        self.telegram = telegram(number)
        self.settings = settings
        self.adapter = EncoderAdapter(self.telegram)
        self.inputs = EncoderInputs(source)
        self.outputs = Outputs(len(self.telegram.actuals.signals), Reason.ENCODER_NO_PLC)
        self.channel = SensorChannel()
        self.control = EncoderControl(SignOfLife(settings.sign_of_life_failures))
        self._node = NodeWatch(self.outputs, proven=True)
        self._acknowledgement = Acknowledgement()
        self._speed: Normalisation | None = None
        self.usable = False
        """The encoder is known: its references were read and can be used."""
        self._sensor_word: int | None = None
        self._sign_of_life_failed = False
        self._preset: SdoWrite | None = None
        self._ineffective: PresetRequest | None = None
        self._refused: ProfidriveError | None = None

    def set_references(self, references: EncoderReferences | None) -> None:
        """Set new reference values. Impossible values refuse operation; the next step reports fault 104."""
        self.usable = False
        self._speed = self._refused = None
        self.channel.set_references(None)
        if references is None:
            return
        speed_type = self.adapter.speed_type
        try:
            if speed_type is not None:
                self._speed = speed_normalisation(speed_type, references.speed_reference)
            self.channel.set_references(references)
        except ProfidriveError as error:
            self._refused = error
            return
        self.usable = True

    @property
    def in_error(self) -> bool:
        """The sensor shows an error to the PLC."""
        return self.channel.sensor.state in _IN_ERROR

    @property
    def in_fault(self) -> bool:
        """ZSW2_ENC.3 is 1, whatever the fault buffer has."""
        return self.control.fault or not self.inputs.ok or not self.usable

    @property
    def faulty(self) -> bool:
        """The encoder shows an alarm or an error."""
        source = self.inputs.source
        return bool(source.alarms or source.error_register)

    def adopt(self, other: EncoderMachine) -> None:
        """Continue after the machine of another telegram of the same encoder."""
        self.channel.sensor.preset_value = other.channel.sensor.preset_value
        self._node = other._node
        self._node.report_to(self.outputs)

    def tolerate(self, failures: int) -> None:
        """Set P925, the number of consecutive failures of the sign of life, and restart the count."""
        self.settings = replace(self.settings, sign_of_life_failures=failures)
        self.control.sign_of_life = SignOfLife(failures)

    def step(self) -> Outputs:
        """One cycle; the object returned is the same each time."""
        inputs, outputs, adapter = self.inputs, self.outputs, self.adapter
        control, channel = self.control, self.channel
        now, ok, source = inputs.now, inputs.ok, inputs.source
        outputs.events = None
        new_fault = False
        if inputs.news:
            self._process_news()
            new_fault = self._has_new_fault()
        if self._refused is not None:
            outputs.fault(gateway_fault(FaultNumber.REFERENCE, str(self._refused), now))
            self._refused = None
        # Without the encoder an acknowledgement cannot check that the error is gone.
        cause = self.faulty
        fault = new_fault or (cause if ok else control.fault)
        adapter.read(inputs.setpoints)
        status = control.step(adapter.control, fault=fault, warning=False)
        if adapter.control is None:
            self._sensor_word = None
        elif control.has_control:
            self._sensor_word = adapter.sensor_word
        values = channel.step(self._sensor_word, source, ok, now, self._sign_of_life_error())
        if self.in_fault or inputs.unacknowledged:
            status |= _FAULT
        self._report_preset()
        speed = self._step_speed(ok, cause) if self._speed is not None else 0
        if not self.in_error:
            outputs.warned = 0
        outputs.warning = outputs.warned | EMCY_WARNING if self._node.warnings else outputs.warned
        if channel.check.deviates:
            outputs.warning |= _DEVIATES
        if ok and source.warnings:
            outputs.warning |= DEVICE_WARNING
        if outputs.warning:
            status |= _WARNING
        adapter.write(status, values, channel.sensor.xist3, speed, outputs.actuals)
        if channel.preset_write is not self._preset:
            write = self._preset = channel.preset_write
            outputs.writes = None if write is None else (write,)
        outputs.good = ok
        if self._acknowledgement.step(control.acknowledged, ok, cause, now):
            outputs.happened().acknowledged = True
            self._node.acknowledged()
        outputs.reason = self._reason(ok)
        return outputs

    def _has_new_fault(self) -> bool:
        """An event of this step has to be acknowledged by the PLC."""
        events = self.outputs.events
        return events is not None and any(
            record.number in _LATCHED and not record.is_warning for record in events.faults
        )

    def _process_news(self) -> None:
        for item in self.inputs.news:
            if isinstance(item, NodeNotice):
                self._node.process(item)
            elif isinstance(item, SdoAnswer):
                self._answered(item)
            elif isinstance(item, RestartAsked):
                self._node.restart_asked = True
        self.inputs.news.clear()

    def _answered(self, answer: SdoAnswer) -> None:
        outputs = self.outputs
        if outputs.writes is not answer.writes:
            return
        outputs.writes = None
        if answer.error is None:
            self.channel.sensor.preset_done()
        else:
            self._preset_failed(answer.error)
            self.channel.sensor.preset_failed()

    def _report_preset(self) -> None:
        sensor = self.channel.sensor
        ineffective = sensor.ineffective
        if ineffective is not self._ineffective and ineffective is not None:
            text = (
                f"confirmed, but the position did not become {ineffective.position} within {sensor.settle_ns // MS} ms"
            )
            self._preset_failed(text)
        self._ineffective = ineffective

    def _preset_failed(self, text: str) -> None:
        self.outputs.warned = warning_bits(FaultNumber.PRESET)
        self.outputs.fault(gateway_fault(FaultNumber.PRESET, text, self.inputs.now))

    def _sign_of_life_error(self) -> SensorError | None:
        failed = self.control.sign_of_life.failed
        if failed and not self._sign_of_life_failed:
            detail = (
                f"more than {self.settings.sign_of_life_failures} frames (P925) in succession without the next counter"
            )
            self.outputs.fault(gateway_fault(FaultNumber.SIGN_OF_LIFE, detail, self.inputs.now))
        self._sign_of_life_failed = failed
        return SensorError.CONTROLLER_SIGN_OF_LIFE if failed else None

    def _step_speed(self, ok: bool, faulty: bool) -> int:
        """The speed for the PLC, compared with the position."""
        channel, inputs = self.channel, self.inputs
        speed = channel.speed(inputs.source, ok, inputs.now)
        if faulty:
            channel.check.restart()  # the position may be wrong
        elif channel.contradiction:
            self.outputs.fault(
                gateway_fault(FaultNumber.VELOCITY_DEVIATES, channel.contradiction, inputs.now, remedy=REMEDY)
            )
        return self._normalised(speed)

    def _normalised(self, speed: int) -> int:
        conversion = self._speed
        if conversion is None:
            return 0
        wire = conversion.to_wire(speed)
        if wire in (conversion.wire_min, conversion.wire_max):
            self.outputs.saturations += 1
        return wire

    def _reason(self, ok: bool) -> Reason | None:
        if not ok:
            return Reason.ENCODER_OFFLINE
        if not self.usable:
            return Reason.REFERENCE_INVALID
        if self.adapter.control is None:
            return Reason.ENCODER_NO_PLC
        if not self.control.has_control:
            return Reason.ENCODER_NO_CONTROL
        return _SENSOR_REASONS.get(self.channel.sensor.state)
