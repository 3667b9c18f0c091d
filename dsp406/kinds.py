"""Kinds of encoders, the bits of their registers, what they put out, and the error root of this package.

The bits of the encoder's registers, each with a number once. Source: CiA DSP 406 V2.0 chapters 8.1.1 (6000h), 8.3.1 (6400h),
8.4.1 (6500h), 8.4.4 (6503h) and 8.4.6 (6505h). Kinds of encoders: the encoder types of 1000h and the three devices of this
project.

Source: CiA DSP 406 V2.0 chapter 7.4 (device type), 8.4.2 (resolution), 8.4.11 (position limits). Resolutions and lengths
are those of the simulated devices.

From the physical position to what an encoder puts out: pure functions on integers.

Source: CiA DSP 406 V2.0 chapters 5.4 (order of the functions), 8.1.1-8.1.4 and 8.4.10 (code sequence, scaling, preset,
offset), 8.1.9 (speed), 8.2 (cams), 8.3 (work area). Where the profile is silent: the physical position counts on beyond the
number of distinguishable revolutions, so that the output wraps at the total measuring range only; hysteresis widens a cam
on both sides once it is active.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

from pdgw.ds301.aborts import CanopenError


class Dsp406Error(CanopenError):
    """An encoder fault or unusable encoder data: names the field, the value and what would have been allowed."""


class Operating(enum.IntFlag):
    """Operating parameters 6000h; operating status 6500h shows them, but bit 1 there means "diagnostics supported"."""

    COUNTERCLOCKWISE = 1 << 0
    """Code sequence: the position increases when the shaft turns counterclockwise, as seen on the shaft."""
    COMMISSIONING_DIAGNOSTICS = 1 << 1
    SCALING = 1 << 2


OPERATING_RESERVED = 0x0FF8
"""Bits 3-11 of 6000h; 12-15 are the manufacturer's."""


class Alarm(enum.IntFlag):
    """Alarms 6503h: the position may be wrong. 6504h says which are supported."""

    POSITION_ERROR = 1 << 0
    COMMISSIONING_DIAGNOSTICS = 1 << 1


class Warnings(enum.IntFlag):
    """Warnings 6505h: a tolerance is exceeded, the position is right. 6506h says which are supported."""

    FREQUENCY_EXCEEDED = 1 << 0
    LIGHT_CONTROL_RESERVE = 1 << 1
    CPU_WATCHDOG = 1 << 2
    OPERATING_TIME = 1 << 3
    BATTERY_CHARGE = 1 << 4
    REFERENCE_POINT = 1 << 5


class AreaState(enum.IntFlag):
    """Area state register 6400h of a channel."""

    OUT_OF_RANGE = 1 << 0
    """Beyond the manufacturer's minimum or maximum position (650Ah)."""
    OVERFLOW = 1 << 1
    UNDERFLOW = 1 << 2


def names(value: enum.IntFlag) -> str:
    """The set bits in words: ``position error, commissioning diagnostics``; ``none`` without any."""
    return ", ".join((bit.name or "").lower().replace("_", " ") for bit in value) or "none"


ENCODER_PROFILE = 406
CHANNELS_MAX = 254
_STEPS_MAX = 1 << 31
"""650Ah and the limits of cams and work area are Integer32."""


class EncoderType(enum.IntEnum):
    """High word of the device type 1000h."""

    SINGLE_TURN = 1
    MULTI_TURN = 2
    SINGLE_TURN_COUNTING = 3
    INCREMENTAL = 4
    INCREMENTAL_COUNTING = 5
    LINEAR_INCREMENTAL = 6
    LINEAR_INCREMENTAL_COUNTING = 7
    LINEAR = 8
    LINEAR_CYCLIC = 9
    MULTI_SENSOR = 10


LINEAR_TYPES = frozenset(
    {
        EncoderType.LINEAR_INCREMENTAL,
        EncoderType.LINEAR_INCREMENTAL_COUNTING,
        EncoderType.LINEAR,
        EncoderType.LINEAR_CYCLIC,
    }
)


@dataclass(frozen=True, slots=True)
class EncoderDevice:
    """One model of encoder: what its hardware can do.

    ``resolution`` is 6501h: steps per revolution, of a linear encoder the measuring step in 0.001 mm. ``turns`` is 6502h
    (1..65535). ``length`` is the number of steps a linear encoder has. All channels of a multi-sensor device are alike.
    """

    name: str
    type: EncoderType
    product_code: int
    resolution: int
    turns: int = 1
    length: int = 0
    channels: int = 1
    tpdos: tuple[int, ...] = (1, 3)
    """Numbers of its TPDOs: 1800h is asynchronous, 1802h synchronous."""

    def __post_init__(self) -> None:
        highest = CHANNELS_MAX if self.type is EncoderType.MULTI_SENSOR else 1
        for field, value, low, high in (
            ("channels", self.channels, 1, highest),
            ("resolution", self.resolution, 1, _STEPS_MAX),
            ("distinguishable revolutions", self.turns, 1, 0xFFFF),
            ("measuring steps", self.steps, 1, _STEPS_MAX),
            ("0.001 mm of measuring length", self.steps * self.resolution if self.is_linear else 1, 1, _STEPS_MAX),
        ):
            if not low <= value <= high:
                raise Dsp406Error(f"{field} of the {self.name} encoder", value, f"{low}..{high}")

    @property
    def is_linear(self) -> bool:
        return self.type in LINEAR_TYPES

    @property
    def device_type(self) -> int:
        """1000h."""
        return self.type << 16 | ENCODER_PROFILE

    @property
    def steps(self) -> int:
        """Distinguishable positions of the hardware."""
        return self.length if self.is_linear else self.resolution * self.turns

    @property
    def unit(self) -> str:
        """Unit of the mechanical position."""
        return "mm" if self.is_linear else "revolutions"

    @property
    def steps_per_unit(self) -> float:
        """Physical steps per revolution or millimetre."""
        return 1000 / self.resolution if self.is_linear else self.resolution


ROTARY = EncoderDevice("rotary", EncoderType.MULTI_TURN, 2, resolution=4096, turns=4096)
LINEAR = EncoderDevice("linear", EncoderType.LINEAR, 8, resolution=5, length=800_000)
MULTI_SENSOR = EncoderDevice(
    "multi-sensor", EncoderType.MULTI_SENSOR, 10, resolution=4096, turns=4096, channels=2, tpdos=(1, 2, 3, 4)
)
DEVICES: dict[str, EncoderDevice] = {device.name: device for device in (ROTARY, LINEAR, MULTI_SENSOR)}


def multi_sensor(channels: int) -> EncoderDevice:
    """The multi-sensor device with 1..254 channels; Dsp406Error for another number."""
    return replace(MULTI_SENSOR, channels=channels)


INT16 = (-0x8000, 0x7FFF)


@dataclass(frozen=True, slots=True)
class Chain:
    """Code sequence, scaling and range in force: physical step ``p`` gives ``floor(+-p * numerator / denominator)``.

    ``total_range`` is the number of position values (1..2^32).
    """

    counterclockwise: bool
    numerator: int
    denominator: int
    total_range: int

    def scaled(self, physical: int) -> int:
        """The position before the offset, in measuring units, not wrapped."""
        return (-physical if self.counterclockwise else physical) * self.numerator // self.denominator

    def output(self, physical: int, offset: int) -> int:
        """The position value, 0..total_range-1."""
        return (self.scaled(physical) + offset) % self.total_range

    def offset_for(self, physical: int, preset: int) -> int:
        """The offset (6509h) that makes ``preset`` the position value; the nearest to 0, so that it fits Integer32."""
        offset = (preset - self.scaled(physical)) % self.total_range
        return offset - self.total_range if 2 * offset >= self.total_range else offset

    def speed(self, physical_per_second: float) -> float:
        """Measuring units per second, positive while the position value grows."""
        speed = physical_per_second * self.numerator / self.denominator
        return -speed if self.counterclockwise else speed


def chain(
    *, counterclockwise: bool, scaling: bool, numerator: int, denominator: int, total_range: int, steps: int
) -> Chain:
    """The chain of the present parameters.

    ``numerator`` and ``denominator`` are 6001h and 6501h, of a linear encoder 6501h and 6005h/1; ``total_range`` is 6002h.
    ``steps`` is what the hardware distinguishes: a larger range is not reached.
    """
    if not scaling:
        return Chain(counterclockwise, 1, 1, steps)
    reachable = steps * numerator // denominator
    return Chain(counterclockwise, numerator, denominator, max(1, min(total_range, reachable)))


def speed_value(speed: float) -> int:
    """A speed as 6030h shows it: the Integer16 saturates."""
    low, high = INT16
    return min(max(round(speed), low), high)


def within(position: int, low: int, high: int) -> bool:
    """Whether a position is between two limits; low > high is the area around the end of the range."""
    if low <= high:
        return low <= position <= high
    return position >= low or position <= high


def cam_active(position: int, low: int, high: int, hysteresis: int, active: bool, total_range: int) -> bool:
    """The next state of a cam: it becomes active between its limits and inactive beyond limit and hysteresis.

    The hysteresis reaches across the end of the range, where the position wraps.
    """
    if within(position, low, high):
        return True
    if not active:
        return False
    if low > high:
        return low - hysteresis <= high + hysteresis or within(position, low - hysteresis, high + hysteresis)
    return any(
        low - hysteresis <= turned <= high + hysteresis
        for turned in (position - total_range, position, position + total_range)
    )


def cam_state(active: int, enable: int, polarity: int) -> int:
    """Cam state register 6300h of a channel: polarity inverts, a disabled cam reads 0."""
    return (active ^ polarity) & enable & 0xFF


def area_state(position: int, low: int, high: int, *, out_of_range: bool) -> AreaState:
    """Area state register 6400h of a channel.

    With low > high a position outside the area is below the low and above the high limit: both bits are set.
    """
    state = AreaState.OUT_OF_RANGE if out_of_range else AreaState(0)
    if not within(position, low, high):
        if position < low:
            state |= AreaState.UNDERFLOW
        if position > high:
            state |= AreaState.OVERFLOW
    return state
