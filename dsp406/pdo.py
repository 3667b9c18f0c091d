"""PDO layouts of encoders: one TPDO per channel, with the values the device can map.

Source: CiA DSP 406 V2.0 chapter 7; 1800h is used without SYNC (type 254, cyclic timer), 1802h with SYNC (type 1). The profile
maps the position alone; speed, area and cam state are added where the device says that they can be mapped.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import Pdo, PdoDirection, PdoLayout
from pdgw.dsp406.errors import Dsp406Error
from pdgw.dsp406.kinds import CHANNELS_MAX
from pdgw.dsp406.objects import AREA_STATE, CAM_STATE, POSITION, POSITION_MULTI_SENSOR, PROFILE, SPEED, ProfileObject

_ROWS: dict[int, ProfileObject] = {row.index: row for row in PROFILE}
_FURTHER = (SPEED, AREA_STATE, CAM_STATE)
CYCLIC = (POSITION, POSITION_MULTI_SENSOR, *_FURTHER)
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
        further = [(index, channel) for index in _FURTHER if (index, channel) in mappable]
        tpdos.append(Pdo(PdoDirection.TPDO, number, tuple(entry(*item) for item in (position, *further))))
    return PdoLayout((), tuple(tpdos))
