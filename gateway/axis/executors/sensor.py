"""The sensor interface (G1, G2) joined to a position: of a channel of an encoder, or a drive's own.

Source: docs/devices.md; PROFIdrive encoder profile 4.1. Left out: cams, work area and the reading of alarms, which the
encoder's owner hands in.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import POSITIONS
from pdgw.dsp406.faults import MEMORY_ERROR
from pdgw.dsp406.images import EncoderParameters
from pdgw.dsp406.objects import PRESET, PRESET_MULTI_SENSOR
from pdgw.gateway.axis.demand_report import Demand
from pdgw.gateway.axis.settings import AxisSettings, SecondSensor
from pdgw.gateway.axis.supervision.encoder_speed import EncoderSpeedCheck
from pdgw.gateway.axis.values import EncoderInput, Inputs, PresetAnswer, ProbeAnswer, ProbeWish, SdoWrite
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.encoder import PRESET_EFFECT_NS, PresetRequest, SensorInterface, rotary_speed_reference
from pdgw.profidrive.measuring import FUNCTIONS, Measuring, Search
from pdgw.profidrive.sensor_states import SENSOR_STATUS, SensorError, SensorState

SPEED_LIMITS = DataType.INTEGER16.integer_range
"""6030h stops here; at a limit it says only that the speed is not below."""
SPEED_WINDOW_NS: Final = 50 * MS
"""Time over which a differentiated speed is a mean."""
STANDING_NS: Final = 100 * MS
"""Without a new position for this time, and for several usual intervals, an encoder is at standstill."""
_STANDING_INTERVALS = 4


@dataclass(frozen=True, slots=True)
class EncoderReferences:
    """Reference values of an encoder; read from it at the start and after every change."""

    total_range: int
    """Number of different positions, in measuring units."""
    speed_reference: Fraction
    """100 % of NIST_A and NIST_B in measuring units per second."""
    channel: int | None = None
    """Channel of a multi-sensor device (6010h/n), None where the preset is 6003h."""
    preset_supported: bool = True
    speed_unit: Fraction = Fraction(1)
    """Measuring units per second of one step of the speed object."""
    position_age_ns: int = 0
    """Longest age of a position that counts."""

    @classmethod
    def rotary(cls, parameters: EncoderParameters, rpm: Fraction, channel: int | None = None) -> EncoderReferences:
        """Of a rotary encoder; ``rpm``: 100 % of the speed in 1/min (P60000)."""
        return cls(parameters.total_range, rotary_speed_reference(rpm, parameters.units_per_turn), channel)

    @classmethod
    def linear(
        cls, parameters: EncoderParameters, mm_per_second: Fraction, channel: int | None = None
    ) -> EncoderReferences:
        """Scaling of a linear encoder; ``mm_per_second``: 100 % of the speed. An encoder with an unknown step is refused
        later."""
        step = parameters.position_step or parameters.resolution  # 0.001 mm
        if not step:
            return cls(parameters.total_range, Fraction(0), channel)
        unit = Fraction(10 * parameters.speed_step, step) if parameters.speed_step else Fraction(1)
        return cls(parameters.total_range, mm_per_second * 1000 / step, channel, speed_unit=unit)


class SpeedFromPosition:
    """Measuring units per second from positions and the times they arrived at."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, int]] = deque()

    def reset(self) -> None:
        """Forget the earlier positions."""
        self._samples.clear()

    def add(self, count: int, time: int) -> None:
        """Add a position across wraps; ``time``: its arrival in monotonic nanoseconds."""
        samples = self._samples
        if not samples or time > samples[-1][0]:
            samples.append((time, count))
            while len(samples) > 2 and samples[1][0] <= time - SPEED_WINDOW_NS:
                samples.popleft()

    def mean(self, now: int) -> int:
        """Mean speed over the last 50 ms, or over the last interval if positions arrive less often.

        0 before the second position, and when the encoder must be at standstill because no position arrived.
        """
        samples = self._samples
        if len(samples) < 2:
            return 0
        first_time, first_count = samples[0]
        last_time, last_count = samples[-1]
        interval = last_time - samples[-2][0]
        if now - last_time > max(STANDING_NS, _STANDING_INTERVALS * interval):
            return 0
        span = last_time - first_time
        doubled = 2 * (last_count - first_count) * SECOND
        return (doubled + span) // (2 * span) if doubled >= 0 else -((span - doubled) // (2 * span))


class SensorChannel:
    """G1 of a telegram: the sensor interface joined to one channel of an encoder."""

    def __init__(self) -> None:
        self.sensor = SensorInterface(1 << 32)
        self.preset_write: SdoWrite | None = None
        """Preset for the encoder; a new object for each request."""
        self.valid = False
        """The last step had a position."""
        self._references: EncoderReferences | None = None
        self._request: PresetRequest | None = None
        self._speed = SpeedFromPosition()
        self._unit: Fraction | None = None
        """Measuring units per second of one step of the speed, if it is not 1."""
        self.check = EncoderSpeedCheck()
        self.contradiction = ""
        """What the check has found in this step."""

    def set_references(self, references: EncoderReferences | None) -> None:
        """Set range and speed unit; None: no position is valid. ProfidriveError for an impossible range."""
        self._references = None
        self._speed.reset()
        if references is not None:
            unit = references.speed_unit
            self.check.set_scaling(float(unit), float(references.speed_reference), references.total_range)
            self._unit = None if unit == 1 else unit
            self.sensor.set_total_range(references.total_range)
            self.sensor.preset_supported = references.preset_supported
            self.sensor.settle_ns = PRESET_EFFECT_NS + references.position_age_ns
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
        self.contradiction = ""
        if references is None or not ok or not feedback.valid:
            self._speed.reset()
            self.check.restart()
            return 0
        time = feedback.position_time
        self._speed.add(self.sensor.count, time)
        own = feedback.speed
        if own is None or own in SPEED_LIMITS:
            self.check.restart()
            return self._speed.mean(now)
        self.contradiction = self.check.step(own, feedback.position, time, now)
        return own if self._unit is None else round(own * self._unit)


class DriveSensor:
    """The drive's own position as an encoder: 6064h, which has no preset."""

    alarms: Final = 0
    warnings: Final = 0
    error_register: Final = 0
    error_code: Final = 0
    position_time: Final = 0
    speed: Final = None
    valid: Final = True

    def __init__(self, feedback: DriveFeedback) -> None:
        self._feedback = feedback
        self.references = EncoderReferences(POSITIONS, Fraction(1), preset_supported=False)

    @property
    def position(self) -> int:
        """6064h."""
        return self._feedback.position_actual


class SecondDriveSensor(DriveSensor):
    """The position of the drive's second encoder: 60E4h."""

    @property
    def position(self) -> int:
        return self._feedback.second_position


NO_SENSOR: Final = (SENSOR_STATUS[SensorState.ERROR], 0, SensorError.COMMAND_NOT_SUPPORTED.value)
"""Words of a missing sensor."""


class SensorWords:
    """G1 (``place`` 0) or G2 (1) in the telegram of a drive, beside its executor.

    ``own``: the drive's position, which counts without an encoder of its own.
    """

    def __init__(self, place: int, own: DriveSensor, words: tuple[int, int]) -> None:
        self.channel = SensorChannel()
        self.own = own
        self._place = place
        self._control, self._status = words
        """Places of G1_STW and G1_ZSW in the telegram; G1_XIST1 and G1_XIST2 follow."""
        self._word: int | None = None
        """G1_STW, None without a PLC; the last one without its control."""
        self.probe: ProbeWish | None = None
        """Positions that the drive's touch probe must latch; a new object for each request."""
        self._search: Search | None = None

    def measure(self, *, possible: bool) -> None:
        """Whether the sensor is the drive's own, which may latch positions."""
        self.channel.sensor.measuring = Measuring() if possible else None

    def set_span(self, span: int) -> None:
        """Set the number of different positions of the drive, whose sensor this is."""
        if self.own.references.total_range != span:
            self.own.references = replace(self.own.references, total_range=span)
            self.channel.set_references(self.own.references)

    def probed(self, answer: ProbeAnswer) -> None:
        """Process an answer of the touch probe. An answer to a withdrawn request is ignored."""
        sensor, search = self.channel.sensor, self._search
        if answer.wish is not self.probe or search is None:
            return
        if answer.error is None:
            sensor.measured(search, answer.positions)
        else:
            sensor.measurement_failed(search, supported=answer.supported)

    def _detect_search(self, measuring: Measuring) -> None:
        search = measuring.search
        if search is not self._search:
            self._search = search
            self.probe = None
            if search is not None:
                edges = tuple(edge for edge in range(FUNCTIONS) if search.functions >> edge & 1)
                self.probe = ProbeWish(edges, zero_pulse=not search.on_the_fly)

    def answered(self, answer: PresetAnswer) -> None:
        """An answer to a withdrawn preset is ignored."""
        channel = self.channel
        if answer.write is not channel.preset_write:
            return
        if answer.error is None:
            channel.sensor.preset_done()
        else:
            channel.sensor.preset_failed()

    def step(self, demand: Demand, inputs: Inputs, error: SensorError | None, actuals: list[int]) -> None:
        """One cycle: sets G1_ZSW, G1_XIST1 and G1_XIST2, or those of G2."""
        channel, encoder, setpoints = self.channel, inputs.encoders[self._place], inputs.setpoints
        ok = inputs.drive_ok if encoder is None else inputs.encoders_ok[self._place]
        if not demand.connected or setpoints is None:
            self._word = None
        elif demand.in_control:
            self._word = setpoints[self._control]
        values = channel.step(self._word, self.own if encoder is None else encoder, ok, inputs.now, error)
        measuring = channel.sensor.measuring
        if measuring is not None:
            self._detect_search(measuring)
        if not channel.valid and channel.sensor.state is SensorState.NORMAL:
            # No position has arrived yet, but the drive's IOPS may be good: not stored, it ends with the first position.
            values = SENSOR_STATUS[SensorState.ERROR], values[1], SensorError.SENSOR_GROUP
        actuals[self._status : self._status + len(values)] = values


def make_sensors(
    settings: AxisSettings, places: tuple[tuple[int, int], ...], feedback: DriveFeedback, actuals: list[int]
) -> tuple[SensorWords | None, SensorWords | None]:
    """G1 and G2 of an axis, None where its telegram or its settings have none. ``places``: of their words, as ``SensorWords`` has
    them; -1 without them. ``actuals``: those of the telegram, where a G2 that the axis lacks shows its error."""
    first_words, second_words = places
    first = None
    if first_words[0] >= 0:
        first = SensorWords(0, DriveSensor(feedback), first_words)
        first.channel.set_references(first.own.references)
        first.measure(possible=not settings.g1_is_encoder)
    if second_words[0] < 0:
        return first, None
    if settings.second_sensor is SecondSensor.NONE:
        place = second_words[1]
        actuals[place : place + len(NO_SENSOR)] = NO_SENSOR
        return first, None
    second = SensorWords(1, SecondDriveSensor(feedback), second_words)
    if settings.second_sensor is SecondSensor.DRIVE:
        second.channel.set_references(second.own.references)
    return first, second
