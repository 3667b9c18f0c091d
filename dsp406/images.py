"""Values of an encoder, and its PDO layouts."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import Pdo, PdoDirection, PdoLayout
from pdgw.dsp406.kinds import CHANNELS_MAX, Dsp406Error, Operating
from pdgw.dsp406.objects import (
    MEASURING_STEPS,
    OFFSET,
    OPERATING_PARAMETERS,
    OPERATING_TIME,
    POSITION,
    POSITION_MULTI_SENSOR,
    PROFILE,
    RESOLUTION,
    REVOLUTIONS,
    SPEED,
    TOTAL_RANGE,
    UNITS_PER_REVOLUTION,
    ProfileObject,
)

# PDO layouts of encoders: one TPDO per channel, with the values the device can map.
#
# Source: CiA DSP 406 V2.0 chapter 7; 1800h is used without SYNC (type 254, cyclic timer), 1802h with SYNC (type 1). The
# profile maps the position alone; the speed is added where the device says that it can be mapped.


_ROWS: dict[int, ProfileObject] = {row.index: row for row in PROFILE}
CYCLIC = (POSITION, POSITION_MULTI_SENSOR, SPEED)
"""Objects that the TPDOs of a layout may carry."""
_NUMBERS = {False: (1, 2, 3, 4), True: (3, 4, 1, 2)}
"""TPDO numbers in the order in which channels take them, without and with SYNC."""


def entry(index: int, subindex: int) -> Entry:
    """A cyclic object of the profile, with the attribute it has in ``ChannelFeedback``."""
    row = _ROWS[index]
    attribute = row.attribute.removesuffix("_1")
    return Entry(index, subindex, row.name, row.type, row.access, row.pdo, unit=row.unit, attribute=attribute)


def encoder_layout(mappable: Collection[tuple[int, int]], channels: Sequence[int], *, sync: bool) -> PdoLayout:
    """One TPDO for each of the channels; those after the fourth have numbers no device offers, they are read by SDO.

    ``mappable``: (index, sub-index) of the objects the device can map. Dsp406Error for a channel without a
    position, one that is named twice, or none at all.
    """
    if not channels or len(set(channels)) < len(channels):
        raise Dsp406Error("encoder channels", list(channels), "at least one, and each only once")
    tpdos = []
    numbers = (*_NUMBERS[sync], *range(5, CHANNELS_MAX + 1))
    for number, channel in zip(numbers, channels, strict=False):
        position = (POSITION_MULTI_SENSOR, channel)
        if position not in mappable and channel == 1:
            position = (POSITION, 0)
        if position not in mappable:
            raise Dsp406Error(
                "encoder channel", channel, "an encoder whose position (6004h, 6020h) can be mapped to a PDO"
            )
        speed = [item for item in mappable if item == (SPEED, channel)]
        tpdos.append(Pdo(PdoDirection.TPDO, number, tuple(entry(*item) for item in (position, *speed))))
    return PdoLayout((), tuple(tpdos))


# Values of an encoder: the process images that the PDO codecs write, and the parameters that define their meaning.
#
# Attribute names are those of the profile's table (``dsp406.objects.PROFILE``). Values are raw object values.


class ChannelFeedback:
    """Cyclic values of one channel (TPDO objects), updated in place."""

    __slots__ = ("position", "speed")

    def __init__(self) -> None:
        self.position = 0
        """6004h (Unsigned32) or 6020h (Integer32), in measuring units."""
        self.speed = 0
        """6030h in measuring units per second, of a linear encoder in steps of 6005h/2; saturates at the Integer16 limits."""


class EncoderFeedback:
    """Values of one encoder: its channels by number (1 = first), and what concerns the whole device.

    ``alarms`` (6503h), ``warnings`` (6505h) and ``error_register`` (1001h) come by SDO, some time after they change;
    ``error_register`` and ``error_code`` are also those of the last EMCY, whose code 0 says that no error is left.
    """

    __slots__ = ("alarms", "channels", "error_code", "error_register", "warnings")

    def __init__(self, channels: Iterable[int] = (1,)) -> None:
        self.channels = {channel: ChannelFeedback() for channel in channels}
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
