"""The tested configurations of the gateways of a run, and their simulated devices."""

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
    """The gateway of one case. ``devices``: the names (1008h) of its devices."""

    devices: str
    configuration: str
    """TOML without the defaults. Data sheets have only their file names, because the folders differ between machines."""

    @classmethod
    def of(cls, config: GatewayConfig, nodes: Iterable[SimulatedNode]) -> Tested:
        """Create it from a configuration and the simulated nodes."""
        axes = [axis.model_copy(update={"eds": Path(axis.eds.name)}) if axis.eds else axis for axis in config.axis]
        text = config_text(config.model_copy(update={"axis": tuple(axes)}))
        return cls(", ".join(map(_name, nodes)), text.strip())


def _name(node: SimulatedNode) -> str:
    data: bytes = node.get_data(DEVICE_NAME, 0)
    return data.decode("ascii", "replace")


def text_of(tested: Iterable[Tested]) -> str:
    """Each configuration once, after a comment with the tested devices."""
    devices: dict[str, list[str]] = {}
    for item in tested:
        known = devices.setdefault(item.configuration, [])
        if item.devices not in known:
            known.append(item.devices)
    return "\n\n".join(f"# simulated: {'; '.join(names)}\n{text}" for text, names in devices.items())
