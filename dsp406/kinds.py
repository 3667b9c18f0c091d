"""Kinds of encoders, the bits of their registers, and the error root of this package.

Source: CiA DSP 406 V2.0 chapters 7.4 (device type), 8.1.1 (6000h), 8.4.1 (6500h), 8.4.2 (resolution), 8.4.4
(6503h), 8.4.6 (6505h), 8.4.11 (position limits). Resolutions and lengths are those of the simulated devices.
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
