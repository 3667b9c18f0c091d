"""The axes of a configuration as the decoder knows them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pdgw.decoder.frames.engine import Axis
from pdgw.profidrive.telegrams import telegram

if TYPE_CHECKING:
    from pdgw.gateway.configuration.config import GatewayConfig


def configured_axes(config: GatewayConfig, telegrams: Sequence[int] = ()) -> list[Axis]:
    """Axes and encoders in the order of the frame; ``telegrams`` replace the configured ones. ProfidriveError for an unknown
    telegram."""
    single = len(config.can) == 1
    return [
        Axis(
            axis.do_id,
            telegram(telegrams[position] if position < len(telegrams) else axis.telegram).number,
            axis.node_id,
            "" if single else str(config.bus_of(axis).channel),
        )
        for position, axis in enumerate(config.objects)
    ]
