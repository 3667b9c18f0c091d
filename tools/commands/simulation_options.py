"""What the simulators of devices are given alike."""

from __future__ import annotations

from typing import Annotated

import typer

from pdgw.gateway.errors import GatewayError
from pdgw.peers.simulation.config import ControlConfig

ControlPort = Annotated[
    int, typer.Option(min=0, max=65535, help="Loopback TCP port for `pdgw sim inject`, 0 for none.")
]
RestPort = Annotated[int, typer.Option(min=0, max=65535, help="Loopback TCP port of the REST interface, 0 for none.")]


def control_ports(control_port: int, rest_port: int) -> ControlConfig:
    """Both ports; GatewayError when they are the same one."""
    if control_port and control_port == rest_port:
        raise GatewayError(f"--control-port and --rest-port: both are {control_port}, each must be different")
    return ControlConfig(port=control_port, rest_port=rest_port)
