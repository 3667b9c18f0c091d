"""Values of an encoder as its objects show them: the process image of its TPDOs, and the parameters that define its meaning."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from types import SimpleNamespace

from pdgw.dsp406.kinds import Dsp406Error, Operating
from pdgw.dsp406.objects import (
    MEASURING_STEPS,
    OFFSET,
    OPERATING_PARAMETERS,
    OPERATING_TIME,
    RESOLUTION,
    REVOLUTIONS,
    TOTAL_RANGE,
    UNITS_PER_REVOLUTION,
)


def position_of(channel: int) -> str:
    """The image attribute of a channel's position (6004h, 6020h)."""
    return f"position_{channel}"


def speed_of(channel: int) -> str:
    """The image attribute of a channel's speed (6030h)."""
    return f"speed_{channel}"


class ChannelFeedback:
    """Cyclic values of one channel, in the image of its encoder: a TPDO may have those of several channels."""

    __slots__ = ("_image", "_position", "_speed")

    def __init__(self, image: SimpleNamespace, channel: int) -> None:
        self._image = image
        self._position, self._speed = position_of(channel), speed_of(channel)
        setattr(image, self._position, 0)
        setattr(image, self._speed, 0)

    @property
    def position(self) -> int:
        """6004h (Unsigned32) or 6020h (Integer32), in measuring units."""
        return int(getattr(self._image, self._position))

    @property
    def speed(self) -> int:
        """6030h in measuring units per second, of a linear encoder in steps of 6005h/2; saturates at the Integer16 limits."""
        return int(getattr(self._image, self._speed))


class EncoderFeedback:
    """Values of one encoder: its channels by number (1 = first), and what concerns the whole device.

    ``alarms`` (6503h), ``warnings`` (6505h) and ``error_register`` (1001h) come by SDO, some time after they change;
    ``error_register`` and ``error_code`` are also those of the last EMCY, whose code 0 says that no error is left.
    """

    __slots__ = ("alarms", "channels", "error_code", "error_register", "image", "warnings")

    def __init__(self, channels: Iterable[int] = (1,)) -> None:
        self.image = SimpleNamespace()
        """The values of TPDOs, by image attribute."""
        self.channels = {channel: ChannelFeedback(self.image, channel) for channel in channels}
        self.alarms = 0
        self.warnings = 0
        self.error_register = 0
        self.error_code = 0

    def channel(self, number: int) -> ChannelFeedback:
        """One channel's values; Dsp406Error for a channel that is not exchanged."""
        try:
            return self.channels[number]
        except KeyError:
            raise Dsp406Error("encoder channel", number, f"one of {list(self.channels)}") from None


@dataclass(frozen=True, slots=True)
class EncoderParameters:
    """Parameters of an encoder, read at start and after every change. Objects it lacks are 0."""

    operating: int = 0
    """6000h."""
    units_per_revolution: int = 0
    """6001h."""
    scaled_range: int = 0
    """6002h."""
    position_step: int = 0
    """6005h/1 of a linear encoder in 0.001 mm."""
    speed_step: int = 0
    """6005h/2 of a linear encoder in 0.01 mm/s."""
    resolution: int = 0
    """6501h: steps per revolution, of a linear encoder 0.001 mm."""
    turns: int = 0
    """6502h; 0 means 65536, the largest number of revolutions."""
    offset: int = 0
    """6509h."""
    operating_time: int = 0
    """6508h in 0.1 h."""

    @property
    def is_scaled(self) -> bool:
        return bool(self.operating & Operating.SCALING)

    @property
    def units_per_turn(self) -> int:
        """Measuring units of one revolution (rotary)."""
        return self.units_per_revolution if self.is_scaled else self.resolution

    @property
    def total_range(self) -> int:
        """Number of different position values; the position wraps there. 2^32 when the encoder does not say."""
        turns = self.turns or 0x1_0000
        positions = self.scaled_range if self.is_scaled or self.position_step else self.resolution * turns
        return positions or 1 << 32


PARAMETER_OBJECTS: tuple[tuple[str, int, int], ...] = (
    ("operating", OPERATING_PARAMETERS, 0),
    ("units_per_revolution", UNITS_PER_REVOLUTION, 0),
    ("scaled_range", TOTAL_RANGE, 0),
    ("position_step", MEASURING_STEPS, 1),
    ("speed_step", MEASURING_STEPS, 2),
    ("resolution", RESOLUTION, 0),
    ("turns", REVOLUTIONS, 0),
    ("offset", OFFSET, 0),
    ("operating_time", OPERATING_TIME, 0),
)
"""Object of each field of ``EncoderParameters``."""
