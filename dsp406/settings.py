"""Settings of one encoder beside those of every node."""

from __future__ import annotations

from dataclasses import dataclass

from pdgw.ds301.node.node import NodeSettings
from pdgw.dsp406.kinds import ROTARY, EncoderDevice


@dataclass(frozen=True, slots=True)
class EncoderSettings(NodeSettings):
    """Choices for one encoder; times in milliseconds. ``tpdo_event_ms`` is its cyclic timer 6200h (1..65535)."""

    channels: tuple[int, ...] = (1,)
    """The channels to exchange, 1..254; those for which the device has no TPDO are read by SDO."""
    device: EncoderDevice = ROTARY
    """Whose EDS is taken when ``eds`` is None."""
    diagnosis_ms: int = 200
    """Interval of reading alarms and warnings; an EMCY triggers it at once."""
