"""The simulated devices of a gateway's configuration: ``simulate = true`` in its [[axis]] and [[encoder]] tables.

The gateway itself does not use them. The program that starts it also starts them, in a separate process or in a world.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Literal

import can
from pydantic import ValidationError

from pdgw.ds301.bus.port import CanPort
from pdgw.explain import problems
from pdgw.gateway.configuration.config import AxisConfig, GatewayConfig
from pdgw.gateway.configuration.tables.encoder import EncoderConfig
from pdgw.gateway.configuration.tables.environment import CanConfig
from pdgw.gateway.errors import GatewayError
from pdgw.peers.drive import ENGEL
from pdgw.peers.drive.model.shapes import SYNCHRONOUS, Shape
from pdgw.peers.simulation.config import DeviceConfig
from pdgw.peers.simulation.devices import Simulation
from pdgw.profidrive.telegrams import ApplicationMode, telegram


def simulated_devices(config: GatewayConfig, bus: CanConfig) -> list[DeviceConfig]:
    """The devices of one bus, drives first, because they turn the encoders. GatewayError for an impossible motion."""
    devices = [
        DeviceConfig(
            type="drive",
            node_id=axis.node_id,
            serial_number=axis.do_id,
            axis=_axis_of(axis),
            like=_kind_of(axis).name,
            # Tolerate at least as many missing SYNCs as the watchdog of the gateway tolerates frames.
            sync_tolerance=None
            if axis.dsc is None
            else max(SYNCHRONOUS.sync_tolerance, config.transport.watchdog_factor),
        )
        for axis in config.axis
        if axis.simulate and config.bus_of(axis).name == bus.name
    ]
    return devices + [_encoder(items) for items in config.encoders_of(bus).values() if items[0].simulate]


def _kind_of(axis: AxisConfig) -> Shape:
    """The variant with cyclic synchronous modes and a touch probe if the configuration may use them."""
    wanted = axis.dsc is not None or axis.positioner is not None or "G1_STW" in telegram(axis.telegram).setpoints.names
    return SYNCHRONOUS if wanted else ENGEL


def _axis_of(axis: AxisConfig) -> Literal["rotary", "linear"]:
    """Endless shaft for speed telegrams; positioning needs limit switches for homing."""
    mode = telegram(axis.telegram).setpoints.mode
    return "linear" if mode is ApplicationMode.POSITIONING else "rotary"


def _encoder(items: Sequence[EncoderConfig]) -> DeviceConfig:
    """One device with all its channels; unused channels are at standstill."""
    last = max(items, key=lambda item: item.channel)
    motions = {item.channel: item.motion for item in items}
    try:
        return DeviceConfig(
            type="encoder",
            node_id=last.node_id,
            serial_number=items[0].do_id,
            model=last.device.name,
            channels=last.device.channels,
            motion=tuple(motions.get(number, "still") for number in range(1, last.channel + 1)),
        )
    except ValidationError as error:
        raise GatewayError(f"[[encoder]] do_id = {items[0].do_id}: {problems(error, DeviceConfig)[0].line}") from error


def add_device(simulation: Simulation, device: DeviceConfig, bus: can.BusABC | CanPort) -> None:
    """Add a device with its faults on its own bus; it is not started yet."""
    serial = device.node_id if device.serial_number is None else device.serial_number
    simulation.add(device.type, bus, device.node_id, serial, **device.options)
    for fault in device.fault:
        simulation.misbehave(device.node_id, fault.name, fault.values)


def bus_file(bus: CanConfig, devices: Sequence[DeviceConfig]) -> str:
    """The file for ``pdgw sim bus``: the devices without faults, on this bus."""
    tables = [("[can]", bus.model_dump(exclude_none=True, exclude={"name"}))]
    tables += [
        ("[[device]]", device.model_dump(mode="json", exclude_none=True, exclude={"fault"})) for device in devices
    ]
    # A number, a text or a list of texts has the same notation in JSON and TOML.
    return "\n".join(
        "\n".join([head, *(f"{key} = {json.dumps(value)}" for key, value in table.items()), ""])
        for head, table in tables
    )
