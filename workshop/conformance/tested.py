"""What was tested: the configurations of the gateways of a run, and the simulated devices behind them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pdgw.ds301.communication import DEVICE_NAME
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import config_text
from pdgw.peers.node.node import SimulatedNode


@dataclass(frozen=True, slots=True)
class Tested:
    """The gateway of one case. ``devices``: the names of what is behind it (1008h)."""

    devices: str
    configuration: str
    """TOML, without what is as by default; data sheets by their file names, since every machine has them elsewhere."""

    @classmethod
    def of(cls, config: GatewayConfig, nodes: Iterable[SimulatedNode]) -> Tested:
        """A gateway with this configuration and these simulated nodes."""
        axes = [axis.model_copy(update={"eds": Path(axis.eds.name)}) if axis.eds else axis for axis in config.axis]
        text = config_text(config.model_copy(update={"axis": tuple(axes)}))
        return cls(", ".join(map(_name, nodes)), text.strip())


def _name(node: SimulatedNode) -> str:
    data: bytes = node.get_data(DEVICE_NAME, 0)
    return data.decode("ascii", "replace")


def text_of(tested: Iterable[Tested]) -> str:
    """Each configuration once, behind a comment with the devices it was tested with."""
    devices: dict[str, list[str]] = {}
    for item in tested:
        known = devices.setdefault(item.configuration, [])
        if item.devices not in known:
            known.append(item.devices)
    return "\n\n".join(f"# simulated: {'; '.join(names)}\n{text}" for text, names in devices.items())
