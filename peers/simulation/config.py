"""Simulated devices of ``pdgw sim bus``: from a file, with their faults, or from a gateway's configuration.

The file is TOML, validated by pydantic with the messages of the gateway's own configuration; ``example()`` is itself valid. The
faults and their parameters: docs/habits.md. In a gateway's configuration, ``simulate = true`` in [[axis]] and [[encoder]]
selects the devices. The gateway itself does not use them: the program that starts it also starts them, in a separate process or
in a world."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import can
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from pdgw.base.validation import misplaced, problems
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.port import CanPort
from pdgw.ds301.communication import NODE_IDS
from pdgw.dsp406.kinds import ROTARY
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.axis_config import AxisConfig, as_list
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.devices import EncoderConfig
from pdgw.gateway.configuration.environment import CanConfig, Integer, NodeId, Port
from pdgw.gateway.configuration.toml_file import parse_toml, read_text, toml_text
from pdgw.peers.drive import ENGEL, SHAPES
from pdgw.peers.drive.model.latency import LATENCY_MAX_MS
from pdgw.peers.drive.model.shapes import ENDLESS, SYNCHRONOUS, Shape
from pdgw.peers.encoder.motion import parse_motion, still
from pdgw.peers.node.behaviour import make, parse
from pdgw.peers.simulation.devices import DEVICE_TYPES, Simulation, encoder_device
from pdgw.profidrive.telegrams import ApplicationMode


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ControlConfig(_Section):
    """``port``: loopback TCP port of ``pdgw sim inject``, 0 for none."""

    port: Port = 0


class FaultConfig(BaseModel):
    """One fault from power-on. The further keys are its parameters."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str

    @property
    def values(self) -> dict[str, object]:
        """The given parameters."""
        return dict(self.model_extra or {})


def _as_texts(value: object) -> object:
    return [value] if isinstance(value, str) else value


_DRIVE_OPTIONS = ("axis", "like", "sync_tolerance", "command_latency_ms", "status_latency_ms")
_LatencyMs = Annotated[Integer, Field(ge=0, le=LATENCY_MAX_MS)]


class DeviceConfig(_Section):
    """One device."""

    type: str = "drive"
    node_id: NodeId
    serial_number: Annotated[Integer, Field(ge=0, le=0xFFFF_FFFF)] | None = None
    """1018h/4; default: the node-ID."""
    axis: Literal["rotary", "linear"] | None = None
    """Of a drive: an endless shaft, or a slide with limit switches."""
    like: str | None = None
    """Of a drive: the variant, see ``peers.drive.model.shapes``."""
    sync_tolerance: Annotated[Integer, Field(ge=1, le=1000)] | None = None
    """Of a drive in a cyclic synchronous mode: periods without SYNC that are a fault; default: that of the variant."""
    command_latency_ms: _LatencyMs | None = None
    """Of a drive: time from the reception of an RPDO until its values apply."""
    status_latency_ms: _LatencyMs | None = None
    """Of a drive: time from a change until the Statusword shows it."""
    model: str | None = None
    """Of an encoder: rotary, linear or multi-sensor."""
    channels: Integer | None = None
    """Of a multi-sensor encoder, 1..254."""
    motion: Annotated[tuple[str, ...], BeforeValidator(_as_texts)] = ()
    """Of an encoder, one for each channel: see ``peers.encoder.motion``."""
    fault: Annotated[tuple[FaultConfig, ...], BeforeValidator(as_list)] = ()

    @property
    def options(self) -> dict[str, Any]:
        """The given options that only some kinds of devices have."""
        names = (*_DRIVE_OPTIONS, "model", "channels", "motion")
        return {name: value for name in names if (value := getattr(self, name))}

    @model_validator(mode="after")
    def _options_fit(self) -> DeviceConfig:
        for name in self.options:
            owner = "drive" if name in _DRIVE_OPTIONS else "encoder"
            if self.type != owner:
                raise ValueError(f'{name}: allowed only with type = "{owner}", not with type = "{self.type}"')
        if self.type != "encoder":
            if self.like is not None and self.like not in SHAPES:
                raise ValueError(f'like = "{self.like}" is not a shape of a drive, allowed: {", ".join(SHAPES)}')
            return self
        try:
            device = encoder_device(self.model or ROTARY.name, self.channels)
            if len(self.motion) > device.channels:
                raise ValueError(
                    f"motion: {len(self.motion)} values, allowed at most {device.channels}, one for each channel"
                )
            for text in self.motion:
                parse_motion(text, shafts=dict.fromkeys(NODE_IDS, still()))
        except CanopenError as error:
            raise ValueError(str(error)) from error
        return self

    @model_validator(mode="after")
    def _faults_exist(self) -> DeviceConfig:
        kind = DEVICE_TYPES.get(self.type)
        if kind is None:
            raise ValueError(f'type = "{self.type}" cannot be simulated, allowed: {", ".join(DEVICE_TYPES)}')
        seen: set[str] = set()
        for fault in self.fault:
            try:
                make(kind.node.catalogue, fault.name, fault.values)
            except CanopenError as error:
                raise ValueError(str(error)) from error
            if fault.name in seen:
                raise ValueError(f"fault {fault.name} is given twice")
            seen.add(fault.name)
        return self


class BusConfig(_Section):
    """The whole file."""

    can: CanConfig | None = None
    control: ControlConfig = ControlConfig()
    device: Annotated[tuple[DeviceConfig, ...], BeforeValidator(as_list), Field(min_length=1)]

    @model_validator(mode="after")
    def _nodes_differ(self) -> BusConfig:
        nodes = [device.node_id for device in self.device]
        for number, node in enumerate(nodes):
            if node in nodes[:number]:
                raise misplaced(f"node_id: {node} is used twice; each must be different", "device", number, "node_id")
        return self


def parse_bus(text: str, name: str = "bus file") -> BusConfig:
    """Validate the text of a file; GatewayError has one line for each error."""
    return parse_toml(BusConfig, text, name)


def load_bus(path: Path) -> BusConfig:
    """Read and validate a file; see ``parse_bus``."""
    return parse_bus(read_text(path), str(path))


def example() -> str:
    """A commented, valid example."""
    return """\

[can]
interface = "virtual"        # any python-can interface
channel = "pdgw"

[control]
port = 0                     # loopback TCP port for `pdgw sim inject --port ...`, 0 for none

[[device]]
type = "drive"
node_id = 1
axis = "rotary"              # a shaft; "linear": a slide with limit switches, where homing by switches ends
like = "engel"               # the shape, see `pdgw sim drive --help`
sync_tolerance = 3           # periods without SYNC that are a fault in a cyclic synchronous mode
command_latency_ms = 0       # from the reception of an RPDO until its values apply, at most 100
status_latency_ms = 0        # from a change of the drive until the Statusword shows it, at most 100

[[device]]
type = "drive"              # "drive" or "encoder"
node_id = 2
serial_number = 4711

[[device.fault]]             # in force from power-on
name = "slow-sdo"
delay_ms = 40

[[device.fault]]
name = "reboot-in-motion"
speed = 500

[[device]]
type = "encoder"
node_id = 10
model = "multi-sensor"       # rotary, linear, multi-sensor
channels = 2
motion = ["speed=1.5", "sine=2,10"]  # one a channel, in revolutions (linear: mm) and seconds; still without
                             # also: still=P, csv=FILE, follow=COB_ID,BYTE,INCREMENTS (the position in another node's PDO),
                             # shaft=NODE_ID (of a drive above)

[[device.fault]]
name = "battery"
"""


def simulated_devices(config: GatewayConfig, bus: CanConfig) -> list[DeviceConfig]:
    """The devices of one bus, drives first, because they turn the encoders. GatewayError for an impossible motion or habit."""
    devices = [
        _device(
            "drive",
            axis,
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


def _device(kind: str, item: AxisConfig | EncoderConfig, **options: object) -> DeviceConfig:
    """The simulated device of a drive object, with the habits in its key ``simulate``."""
    table = f"[[{'axis' if kind == 'drive' else kind}]] do_id = {item.do_id}"
    habits = item.simulate if isinstance(item.simulate, tuple) else ()
    try:
        faults = [{"name": name, **values} for name, values in map(parse, habits)]
        for name, values in map(parse, habits):
            make(DEVICE_TYPES[kind].node.catalogue, name, values)
        keys = {"type": kind, "node_id": item.node_id, "serial_number": item.do_id, "fault": faults, **options}
        return DeviceConfig.model_validate(keys)
    except CanopenError as error:
        raise GatewayError(f"{table}: {error}") from error
    except ValidationError as error:
        raise GatewayError(f"{table}: {problems(error, DeviceConfig)[0].line}") from error


def _kind_of(axis: AxisConfig) -> Shape:
    """The variant with cyclic synchronous modes and a touch probe if the configuration may use them; for a rotary axis without a
    range of positions."""
    if axis.positioner is not None and axis.positioner.modulo_range:
        return ENDLESS
    synchronous = axis.dsc is not None or axis.positioner is not None or "G1_STW" in axis.chosen.setpoints.names
    return SYNCHRONOUS if synchronous else ENGEL


def _axis_of(axis: AxisConfig) -> Literal["rotary", "linear"]:
    """Endless shaft for speed telegrams and rotary axes; positioning needs limit switches for homing."""
    mode = axis.chosen.setpoints.mode
    return "linear" if mode is ApplicationMode.POSITIONING and _kind_of(axis) is not ENDLESS else "rotary"


def _encoder(items: Sequence[EncoderConfig]) -> DeviceConfig:
    """One device with all its channels; unused channels are at standstill."""
    last = max(items, key=lambda item: item.channel)
    motions = {item.channel: item.motion for item in items}
    channels = last.device.channels
    motion = tuple(motions.get(number, "still") for number in range(1, last.channel + 1))
    return _device("encoder", items[0], model=last.device.name, channels=channels, motion=motion)


def add_device(simulation: Simulation, device: DeviceConfig, bus: can.BusABC | CanPort) -> None:
    """Add a device with its faults on its own bus; it is not started yet."""
    serial = device.node_id if device.serial_number is None else device.serial_number
    simulation.add(device.type, bus, device.node_id, serial, **device.options)
    for fault in device.fault:
        simulation.start_fault(device.node_id, fault.name, fault.values)


def bus_file(bus: CanConfig, devices: Sequence[DeviceConfig]) -> str:
    """The file for ``pdgw sim bus``: the devices on this bus."""
    tables = [device.model_dump(mode="json", exclude_none=True) for device in devices]
    return toml_text({"can": bus.model_dump(exclude_none=True, exclude={"name", "node_id"}), "device": tables})
