"""The simulated encoder without CANopen: channels, registers and diagnostics, and its habits.

Source: CiA DSP 406 V2.0 chapters 6.2 and 8, CiA DS 301 (error register 1001h). Which alarm goes with which code is our choice:
the profile leaves it to the manufacturer. The caller passes the time in nanoseconds. The habits are those of an encoder, in
addition to those of any CANopen node. Not simulated: wrong positions. An alarm says that the position may be wrong; here it
stays correct.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random
from typing import Final, cast

from pdgw.base.durations import MS, SECOND
from pdgw.dsp406 import objects
from pdgw.dsp406.kinds import OPERATING_RESERVED, Alarm, Dsp406Error, EncoderDevice, Operating
from pdgw.peers.encoder.motion import Motion, Standstill, still
from pdgw.peers.encoder.outputs import Chain, area_state, cam_active, cam_state, chain, speed_value
from pdgw.peers.habits import HABITS
from pdgw.peers.node.behaviour import Behaviour, catalogue
from pdgw.peers.node.node_behaviours import NODE_BEHAVIOURS, NODE_HABITS


@dataclass(frozen=True, slots=True)
class EncoderFault:
    """Effects of a cause: EMCY error code (0: none), bits of the error register 1001h, alarms and warnings."""

    error_code: int = 0
    error_register: int = 0
    alarms: int = 0
    warnings: int = 0


ENCODER_FAULTS: Final = {habit.name: EncoderFault(**habit.fixed) for habit in HABITS.values() if habit.does == "Cause"}
"""The causes by name."""
_SENSOR_DEFECT: Final = "sensor-defect"
"""The cause that only the commissioning diagnostics find."""
_DIAGNOSIS: Final = "commissioning diagnostics"
_COMMISSIONING_FAULT: Final = EncoderFault(0x5000, 0x21, Alarm.COMMISSIONING_DIAGNOSTICS)
"""Result of the diagnostics; not a cause of its own."""


class Cause(Behaviour):
    """A cause of ``ENCODER_FAULTS`` in the encoder, present until the habit ends."""

    def begin(self) -> None:
        cast("EncoderModel", self.node.image).inject(self.habit.name)

    def end(self) -> None:
        cast("EncoderModel", self.node.image).clear(self.habit.name)


ENCODER_HABITS: Final = {**NODE_HABITS, **catalogue("encoder", (*NODE_BEHAVIOURS, Cause))}
"""All habits of a simulated encoder."""


ObjectReader = Callable[[int, int], int]
_NOISE_NS = 10 * MS
"""Time for which a position has the same error."""
_PERCENT = 100
_TENTH_OF_AN_HOUR = 360 * SECOND
_STEP_NS = MS
"""Interval of reading a sensor that may move."""


@dataclass(slots=True)
class _Channel:
    """One sensor: its motion, its position, and the state of its encoder part."""

    motion: Motion
    since: int = 0
    mechanical: float = 0.0
    physical: int = 0
    out_of_range: bool = False
    speed: float = 0.0
    """Revolutions or millimetres per second."""
    at_standstill: bool = False
    """At standstill: the measured speed is 0."""
    speed_from: tuple[int, float] | None = None
    offset: int = 0
    active_cams: int = 0

    def move(self, time: int, gate: int) -> None:
        """Read position and speed at a time. ``gate``: nanoseconds over which the speed is measured."""
        self.mechanical = self.motion(time - self.since)
        if self.speed_from is None:
            self.speed_from = (time, self.mechanical)
        begin, position = self.speed_from
        if time - begin >= gate:
            self.speed = (self.mechanical - position) * SECOND / (time - begin)
            self.speed_from = (time, self.mechanical)
            self.at_standstill = self.speed == 0


class EncoderModel:
    """The image of the mappable objects (as attributes) and the encoder.

    ``read`` returns the value of the other objects (index, sub-index). ``emcy`` collects (error code, error register).
    ``operating_time`` is 6508h at power-on in 0.1 h; None for a device without it.
    """

    def __init__(
        self,
        device: EncoderDevice,
        read: ObjectReader,
        motions: Sequence[Motion] = (),
        operating_time: int | None = 0,
    ) -> None:
        if len(motions) > device.channels:
            raise Dsp406Error(f"motions of the {device.name} encoder", len(motions), f"at most {device.channels}")
        self.device = device
        self.read = read
        self.emcy: list[tuple[int, int]] = []
        self.faults: dict[str, EncoderFault] = {}
        """The present causes, by name."""
        idle = [still()] * (device.channels - len(motions))
        self.channels = {number: _Channel(motion) for number, motion in enumerate((*motions, *idle), 1)}
        self._stored_offsets = dict.fromkeys(self.channels, 0)
        self._hours = operating_time
        self.noise = 0
        """Largest difference of a position from that of the shaft, at random, in steps."""
        self.gate_ms = 10
        """Time over which the speed is measured."""
        self.speed_percent = _PERCENT
        """Share of the speed that 6030h shows."""
        self._power_on = -1
        self._time = 0
        self.reset()

    # Attributes of the catalogue that are not per channel, for the type checker; ``reset`` sets all of them.
    operating_status: int
    alarms: int
    warnings: int
    operating_time: int
    offset: int
    error_register: int

    def reset(self) -> None:
        """Restart the firmware. Faults, motion, offsets and operating time stay."""
        for entry in objects.encoder_catalogue(self.device).entries:
            if entry.attribute:
                setattr(self, entry.attribute, entry.default)
        for number, channel in self.channels.items():
            channel.offset = self._stored_offsets[number]
            channel.active_cams = 0
        self.faults.pop(_DIAGNOSIS, None)
        self._show_faults()

    def restore_defaults(self) -> None:
        """1011h: restore the offsets of the delivery, valid after the next reset."""
        self._stored_offsets = dict.fromkeys(self.channels, 0)

    # -- commands -----------------------------------------------------------------------------------------------------

    def set_motion(self, motion: Motion, channel: int = 1) -> None:
        """Set another motion; Dsp406Error for a missing channel."""
        moved = self._channel(channel)
        moved.motion = motion
        moved.since = self._time
        moved.speed_from = None
        moved.at_standstill = False

    def preset(self, value: int, channel: int = 1) -> None:
        """Set the present position to ``value`` and store the offset. Dsp406Error outside the range or for a wrong channel."""
        shifted = self._channel(channel)
        present = self.chain
        if not 0 <= value < present.total_range:
            raise Dsp406Error("preset value", value, f"0..{present.total_range - 1}")
        shifted.offset = self._stored_offsets[channel] = present.offset_for(shifted.physical, value)
        self._show()

    def inject(self, name: int | str) -> None:
        """Raise one of ``ENCODER_FAULTS``; its cause stays until ``clear``. Dsp406Error for another name, or a number."""
        fault = ENCODER_FAULTS.get(str(name))
        if fault is None:
            raise Dsp406Error("encoder fault", name, f"one of {', '.join(ENCODER_FAULTS)}")
        self._raise(str(name), fault)

    def clear(self, name: str | None = None) -> None:
        """Remove a cause, or all of them without a name; no error if it is not present.

        Results of the commissioning diagnostics stay until its next run.
        """
        for cause in set(self.faults) - {_DIAGNOSIS} if name is None else [name]:
            self._drop(cause)

    def _channel(self, number: int) -> _Channel:
        try:
            return self.channels[number]
        except KeyError:
            raise Dsp406Error("encoder channel", number, f"1..{self.device.channels}") from None

    def _raise(self, name: str, fault: EncoderFault) -> None:
        if name not in self.faults:
            self.faults[name] = fault
            self._show_faults()
            if fault.error_code:
                self.emcy.append((fault.error_code, self.error_register))

    def _drop(self, name: str) -> None:
        fault = self.faults.pop(name, None)
        self._show_faults()
        if fault is not None and fault.error_code and not any(f.error_code for f in self.faults.values()):
            self.emcy.append((0, 0))

    def _show_faults(self) -> None:
        self.alarms = self.warnings = self.error_register = 0
        for fault in self.faults.values():
            self.alarms |= fault.alarms
            self.warnings |= fault.warnings
            self.error_register |= fault.error_register

    # -- time ---------------------------------------------------------------------------------------------------------

    @property
    def chain(self) -> Chain:
        """Code sequence, scaling and range from the present objects."""
        read, resolution = self.read, self.device.resolution
        operating = read(objects.OPERATING_PARAMETERS, 0)
        linear = self.device.is_linear
        return chain(
            counterclockwise=bool(operating & Operating.COUNTERCLOCKWISE),
            scaling=bool(operating & Operating.SCALING),
            numerator=resolution if linear else read(objects.UNITS_PER_REVOLUTION, 0),
            denominator=read(objects.MEASURING_STEPS, 1) if linear else resolution,
            total_range=read(objects.TOTAL_RANGE, 0),
            steps=self.device.steps,
        )

    def advance(self, now: int) -> None:
        """Bring everything up to ``now`` (monotonic ns)."""
        if self._power_on < 0:
            self._power_on = now
        self._time = now - self._power_on
        low, high = self.read(objects.MODULE_IDENTIFICATION, 2), self.read(objects.MODULE_IDENTIFICATION, 3)
        for channel in self.channels.values():
            channel.move(self._time, self.gate_ms * MS)
            physical = math.floor(channel.mechanical * self.device.steps_per_unit)
            if self.noise:
                physical += Random(now // _NOISE_NS).randint(-self.noise, self.noise)
            if self.device.is_linear:
                # Outside the scale, the head keeps its last step.
                channel.out_of_range = not low <= physical <= high
                physical = min(max(physical, low), high)
            channel.physical = physical
        self._diagnose()
        self._show()

    def next_change(self) -> int | None:
        """Time of the next possible change of the image without an input; None while all sensors are at standstill."""
        if all(channel.at_standstill and isinstance(channel.motion, Standstill) for channel in self.channels.values()):
            return None
        return self._power_on + self._time + _STEP_NS

    def _diagnose(self) -> None:
        """Commissioning diagnostics: check the sensor at standstill."""
        if not self.read(objects.OPERATING_PARAMETERS, 0) & Operating.COMMISSIONING_DIAGNOSTICS:
            self._drop_diagnosis()
        elif all(channel.at_standstill for channel in self.channels.values()):
            if _SENSOR_DEFECT in self.faults:
                self._raise(_DIAGNOSIS, _COMMISSIONING_FAULT)
            else:
                self._drop_diagnosis()

    def _drop_diagnosis(self) -> None:
        if _DIAGNOSIS in self.faults:
            self._drop(_DIAGNOSIS)

    def _show(self) -> None:
        """Update the image from the states of the channels."""
        present = self.chain
        for number, channel in self.channels.items():
            position = present.output(channel.physical, channel.offset)
            setattr(self, f"position_{number}", position)
            setattr(self, f"speed_{number}", self._speed(channel, present))
            setattr(self, f"cam_state_{number}", self._cams(number, channel, position, present.total_range))
            limits = self.read(objects.WORK_AREA_LOW, number), self.read(objects.WORK_AREA_HIGH, number)
            setattr(self, f"area_state_{number}", area_state(position, *limits, out_of_range=channel.out_of_range))
        self.offset = self.channels[1].offset
        operating = self.read(objects.OPERATING_PARAMETERS, 0) & ~OPERATING_RESERVED
        self.operating_status = operating | Operating.COMMISSIONING_DIAGNOSTICS
        self.operating_time = objects.UNUSED if self._hours is None else self._hours + self._time // _TENTH_OF_AN_HOUR

    def _speed(self, channel: _Channel, present: Chain) -> int:
        if self.device.is_linear:
            steps = channel.speed * 100 / self.read(objects.MEASURING_STEPS, 2)
            speed = -steps if present.counterclockwise else steps
        else:
            speed = present.speed(channel.speed * self.device.steps_per_unit)
        return speed_value(speed * self.speed_percent / _PERCENT)

    def _cams(self, number: int, channel: _Channel, position: int, total_range: int) -> int:
        enable: int = getattr(self, f"cam_enable_{number}")
        active = 0
        for cam in range(objects.CAMS):
            if enable >> cam & 1:
                low, high = (
                    self.read(objects.CAM_LOW_LIMIT + cam, number),
                    self.read(objects.CAM_HIGH_LIMIT + cam, number),
                )
                was = bool(channel.active_cams >> cam & 1)
                is_ = cam_active(position, low, high, self.read(objects.CAM_HYSTERESIS + cam, number), was, total_range)
                active |= is_ << cam
        channel.active_cams = active
        return cam_state(active, enable, getattr(self, f"cam_polarity_{number}"))
