"""The PDO layout of an encoder: one TPDO for each channel, with its position and speed.

Source: CiA DSP 406 V2.0 chapter 7. The profile maps the position alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, count
from typing import Final

import canopen

from pdgw.ds301.configuration import SYNC_TYPES
from pdgw.ds301.eds.pdos import variable
from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import PDOS_MAX, Pdo, PdoCapabilities, PdoDirection, PdoLayout
from pdgw.dsp406.images import position_of, speed_of
from pdgw.dsp406.kinds import Dsp406Error
from pdgw.dsp406.objects import POSITION, POSITION_MULTI_SENSOR, PROFILE, SPEED

_ROWS: Final = {row.index: row for row in PROFILE}
_BY_POSITION: Final = "the speed is the mean speed of the position"


def encoder_layout(
    dictionary: canopen.ObjectDictionary, device: PdoCapabilities, channels: Sequence[int], *, sync: bool
) -> PdoLayout:
    """A TPDO for each channel, first those that the data sheet sends on SYNC (without ``sync``: not on SYNC).

    Dsp406Error for a channel without a position, one that is named twice, or none at all.
    """
    if not channels or len(set(channels)) < len(channels):
        raise Dsp406Error("encoder channels", list(channels), "at least one, and each only once")
    suited = sorted(device.tpdos, key=lambda slot: (slot.type in SYNC_TYPES) is not sync)
    numbers = chain((slot.number for slot in suited), count(PDOS_MAX + 1))  # no device has those at the end
    tpdos = tuple(
        Pdo(PdoDirection.TPDO, number, tuple(_entries(dictionary, channel)))
        for number, channel in zip(numbers, channels, strict=False)
    )
    speeds = dict.fromkeys(map(speed_of, channels), _BY_POSITION)
    return PdoLayout((), tpdos, speeds, frozenset(speeds))


def _entries(dictionary: canopen.ObjectDictionary, channel: int) -> Iterator[Entry]:
    """Position and speed of a channel, as far as the data sheet has them."""
    position = (POSITION_MULTI_SENSOR, channel)
    if channel == 1 and variable(dictionary, *position) is None:
        position = (POSITION, 0)
    if channel < 1 or variable(dictionary, *position) is None:
        raise Dsp406Error("encoder channel", channel, "an encoder whose data sheet has its position (6004h, 6020h)")
    yield _entry(*position, position_of(channel))
    if variable(dictionary, SPEED, channel) is not None:
        yield _entry(SPEED, channel, speed_of(channel))


def _entry(index: int, subindex: int, attribute: str) -> Entry:
    row = _ROWS[index]
    return Entry(index, subindex, row.name, row.type, attribute=attribute)
