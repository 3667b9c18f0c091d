"""Telegrams 81 to 84: an encoder's position, speed and sensor commands.

Source: docs/dsp406-encoder.md "Encoder telegrams", docs/telegrams.md; PROFIdrive encoder profile 4.1. ``SensorChannel``
is the part that telegram 3 has as well. Left out: cams, work area and the reading of alarms, which the encoder's owner
hands in.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

from pdgw.dsp406.encoder import PRESET, PRESET_MULTI_SENSOR
from pdgw.dsp406.faults import MEMORY_ERROR
from pdgw.dsp406.images import EncoderParameters
from pdgw.gateway.reasons import Reason
from pdgw.gateway.translator.base import BaseTranslator, FaultEvent, SdoWrite
from pdgw.profidrive.datatypes import DataType, Normalisation
from pdgw.profidrive.encoder import (
    EncoderControl,
    PresetRequest,
    SensorError,
    SensorInterface,
    SensorState,
    rotary_speed_reference,
    speed_normalisation,
)
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.sign_of_life import MONITORING_OFF, SignOfLife
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Telegram

SPEED_LIMITS = DataType.INTEGER16.integer_range
"""6030h stops here; at a limit it says only that the speed is not below."""
SPEED_WINDOW_NS = 50_000_000
"""Time over which a differentiated speed is a mean."""
STANDING_NS = 100_000_000
"""Without a new position for this long, and for several of the usual intervals, an encoder stands."""
_STANDING_INTERVALS = 4
_SECOND_NS = 1_000_000_000
_ZSW2_ENC_FAULT = signal("ZSW2_ENC").bit("FAULT").mask
_SENSOR_REASONS = {
    SensorState.ERROR: Reason.SENSOR_ERROR,
    SensorState.ACKNOWLEDGING: Reason.SENSOR_ERROR,
    SensorState.PARKED: Reason.SENSOR_PARKED,
    SensorState.PRESETTING: Reason.SENSOR_PRESETTING,
}


class EncoderInput(Protocol):
    """What one channel of an encoder tells; raw object values."""

    @property
    def position(self) -> int:
        """6004h or 6020h/n in measuring units."""

    @property
    def position_time(self) -> int:
        """When the position arrived, monotonic nanoseconds."""

    @property
    def speed(self) -> int | None:
        """6030h/n, None where the device has no speed."""

    @property
    def alarms(self) -> int:
        """6503h."""

    @property
    def warnings(self) -> int:
        """6505h."""

    @property
    def error_register(self) -> int:
        """1001h, as the last EMCY told it."""

    @property
    def error_code(self) -> int:
        """Of the last EMCY, 0 when it said that no error is left."""

    @property
    def valid(self) -> bool:
        """The position is one the device measured."""


@dataclass(frozen=True, slots=True)
class EncoderReferences:
    """What gives the values of an encoder their meaning; read from it at start and after every change."""

    total_range: int
    """Number of different positions, in measuring units."""
    speed_reference: Fraction
    """100 % of NIST_A and NIST_B in measuring units per second."""
    channel: int | None = None
    """Channel of a multi-sensor device (6010h/n), None where the preset is 6003h."""
    preset_supported: bool = True
    speed_unit: Fraction = Fraction(1)
    """Measuring units per second of one step of the speed object."""

    @classmethod
    def rotary(cls, parameters: EncoderParameters, rpm: Fraction, channel: int | None = None) -> EncoderReferences:
        """Of a rotary encoder; ``rpm``: 100 % of the speed in 1/min (P60000)."""
        return cls(parameters.total_range, rotary_speed_reference(rpm, parameters.units_per_turn), channel)

    @classmethod
    def linear(
        cls, parameters: EncoderParameters, mm_per_second: Fraction, channel: int | None = None
    ) -> EncoderReferences:
        """Of a linear encoder; ``mm_per_second``: 100 % of the speed. One that does not tell its step is refused later."""
        step = parameters.position_step or parameters.resolution  # 0.001 mm
        if not step:
            return cls(parameters.total_range, Fraction(0), channel)
        unit = Fraction(10 * parameters.speed_step, step) if parameters.speed_step else Fraction(1)
        return cls(parameters.total_range, mm_per_second * 1000 / step, channel, speed_unit=unit)


@dataclass(frozen=True, slots=True)
class EncoderTranslatorSettings:
    """The user's choices for one encoder."""

    sign_of_life_failures: int = MONITORING_OFF
    """P925: tolerated failures of the PLC's sign of life in succession; 65535 (off) where PLC and gateway cycles drift."""


class SpeedFromPosition:
    """Measuring units per second from positions and the times they arrived at."""

    __slots__ = ("_samples",)

    def __init__(self) -> None:
        self._samples: deque[tuple[int, int]] = deque()

    def reset(self) -> None:
        """What came before has nothing to do with what follows."""
        self._samples.clear()

    def step(self, count: int, time: int, now: int) -> int:
        """The mean speed over the last 50 ms, or over the last interval where positions come more seldom.

        ``count``: position across wraps; ``time``: when it arrived, ``now``: monotonic nanoseconds. 0 until there are two
        positions, and when none came for so long that the encoder stands.
        """
        samples = self._samples
        if not samples or time > samples[-1][0]:
            samples.append((time, count))
            while len(samples) > 2 and samples[1][0] <= time - SPEED_WINDOW_NS:
                samples.popleft()
        if len(samples) < 2:
            return 0
        first_time, first_count = samples[0]
        last_time, last_count = samples[-1]
        interval = last_time - samples[-2][0]
        if now - last_time > max(STANDING_NS, _STANDING_INTERVALS * interval):
            return 0
        span = last_time - first_time
        doubled = 2 * (last_count - first_count) * _SECOND_NS
        return (doubled + span) // (2 * span) if doubled >= 0 else -((span - doubled) // (2 * span))


class SensorChannel:
    """G1 of a telegram: the sensor interface joined to one channel of an encoder."""

    def __init__(self) -> None:
        self.sensor = SensorInterface(1 << 32)
        self.preset_write: SdoWrite | None = None
        """What the encoder has to take for the present request; another object for each request."""
        self.valid = False
        """The last step had a position."""
        self._references: EncoderReferences | None = None
        self._request: PresetRequest | None = None
        self._speed = SpeedFromPosition()

    def set_references(self, references: EncoderReferences | None) -> None:
        """ProfidriveError for a range no sensor has; without references no position is valid."""
        self._references = None
        self._speed.reset()
        if references is not None:
            self.sensor.set_total_range(references.total_range)
            self.sensor.preset_supported = references.preset_supported
            self._references = references

    def step(
        self, g1_stw: int | None, feedback: EncoderInput, ok: bool, now: int, error: SensorError | None = None
    ) -> tuple[int, int, int]:
        """One cycle; returns G1_ZSW, G1_XIST1 and G1_XIST2. ``ok``: the encoder is configured and its data is fresh."""
        sensor = self.sensor
        self.valid = valid = ok and feedback.valid and self._references is not None
        # Every alarm says that the position may be wrong.
        if ok and feedback.alarms:
            error = SensorError.MEMORY if feedback.error_code == MEMORY_ERROR else SensorError.SENSOR_GROUP
        values = sensor.step(g1_stw, feedback.position, now, valid=valid, error=error)
        if sensor.preset_request is not self._request:
            self._request = sensor.preset_request
            self.preset_write = self._write()
        return values

    def _write(self) -> SdoWrite | None:
        request, references = self._request, self._references
        if request is None or references is None:
            return None
        if references.channel is None:
            return SdoWrite(PRESET, 0, request.position)
        return SdoWrite(PRESET_MULTI_SENSOR, references.channel, request.position)

    def speed(self, feedback: EncoderInput, ok: bool, now: int) -> int:
        """Measuring units per second: the device's own where it has one that is not at its limit; 0 when not valid."""
        references = self._references
        if references is None or not ok or not feedback.valid:
            self._speed.reset()
            return 0
        mean = self._speed.step(self.sensor.count, feedback.position_time, now)
        own = feedback.speed
        if own is None or own in SPEED_LIMITS:
            return mean
        return own if references.speed_unit == 1 else round(own * references.speed_unit)


class EncoderTranslator(BaseTranslator[EncoderInput, EncoderReferences]):
    """Sensor commands to presets (6003h, 6010h/n), position and speed to G1_XIST1/2/3 and NIST_A/B."""

    def __init__(self, telegram: Telegram, settings: EncoderTranslatorSettings) -> None:
        super().__init__(telegram)
        self.settings = settings
        self.reason = Reason.ENCODER_NO_PLC
        self.channel = SensorChannel()
        self.control = EncoderControl(SignOfLife(settings.sign_of_life_failures))
        names = telegram.actuals.names
        self._actuals = [0] * len(names)
        self._xist1 = names.index("G1_XIST1") if "G1_XIST1" in names else None
        self._xist2 = names.index("G1_XIST2")
        speeds = [index for index, name in enumerate(names) if name.startswith("NIST")]
        self._speed_index = speeds[0] if speeds else None
        self._speed: Normalisation | None = None
        self._usable = False
        self._g1_stw: int | None = None
        self._life_failed = False
        self._preset_write: SdoWrite | None = None
        self._fault_told = False

    def fault_told(self) -> None:
        """The encoder's owner entered a fault in P947: ZSW2_ENC.3 shows it until the cause is gone and the PLC acknowledged."""
        self._fault_told = True

    def set_references(self, references: EncoderReferences | None, homing_method: int = 0) -> None:
        self._usable = False
        self._speed = None
        self.channel.set_references(None)
        if references is None:
            return
        try:
            if self._speed_index is not None:
                speed_type = self.telegram.actuals.signals[self._speed_index].type
                self._speed = speed_normalisation(speed_type, references.speed_reference)
            self.channel.set_references(references)
        except ProfidriveError as error:
            self.events.append(FaultEvent(104, str(error)))
            return
        self._usable = True

    def drive_restarted(self) -> None:
        """The sensor has shown the loss as error 0001h; requests are edges, so that none stands."""

    def sdo_done(self, error: str | None) -> None:
        if error is None:
            self.channel.sensor.preset_done()
        else:
            self.events.append(FaultEvent(118, error))
            self.channel.sensor.preset_failed()

    def step(self, setpoints: Sequence[int] | None, feedback: EncoderInput, drive_ok: bool, now: int) -> Sequence[int]:
        control, channel, actuals = self.control, self.channel, self._actuals
        if drive_ok:
            fault = self._fault_told or bool(feedback.alarms or feedback.error_register)
        else:
            # Without the encoder there is nothing an acknowledge could see gone.
            fault = self._fault_told or control.fault
        self._fault_told = False
        warning = drive_ok and feedback.warnings != 0
        status = control.step(None if setpoints is None else setpoints[0], fault=fault, warning=warning)
        if setpoints is None:
            self._g1_stw = None
        elif control.has_control:
            self._g1_stw = setpoints[1]
        values = channel.step(self._g1_stw, feedback, drive_ok, now, self._sign_of_life_error())
        actuals[0] = status if drive_ok and self._usable else status | _ZSW2_ENC_FAULT
        actuals[1] = values[0]
        if self._xist1 is None:
            actuals[2] = channel.sensor.xist3
        else:
            actuals[self._xist1] = values[1]
        actuals[self._xist2] = values[2]
        if self._speed_index is not None:
            actuals[self._speed_index] = self._normalised(channel.speed(feedback, drive_ok, now))
        if channel.preset_write is not self._preset_write:
            write = self._preset_write = channel.preset_write
            self.sdo_request = None if write is None else (write,)
        self.reason = self._reason_of(setpoints, drive_ok)
        return actuals

    def _sign_of_life_error(self) -> SensorError | None:
        failed = self.control.sign_of_life.failed
        if failed and not self._life_failed:
            self.events.append(
                FaultEvent(124, f"more than {self.settings.sign_of_life_failures} failures in succession")
            )
        self._life_failed = failed
        return SensorError.CONTROLLER_SIGN_OF_LIFE if failed else None

    def _normalised(self, speed: int) -> int:
        if self._speed is None:
            return 0
        wire = self._speed.to_wire(speed)
        if wire in (self._speed.wire_min, self._speed.wire_max):
            self.saturations += 1
        return wire

    def _reason_of(self, setpoints: Sequence[int] | None, drive_ok: bool) -> Reason | None:
        if not drive_ok:
            return Reason.ENCODER_OFFLINE
        if not self._usable:
            return Reason.REFERENCE_INVALID
        if setpoints is None:
            return Reason.ENCODER_NO_PLC
        if not self.control.has_control:
            return Reason.ENCODER_NO_CONTROL
        return _SENSOR_REASONS.get(self.channel.sensor.state)
