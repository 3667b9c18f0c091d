"""The types of simulated devices, and a set of them running on one bus with their faults.

A new type is an entry of ``DEVICE_TYPES``. File and console then support it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Protocol

import can

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.port import CanPort
from pdgw.ds301.loop.loop import Loop
from pdgw.dsp402.states import state_of
from pdgw.dsp406.kinds import DEVICES, ROTARY, Alarm, EncoderDevice, Warnings
from pdgw.peers.bus import LoopbackBus
from pdgw.peers.drive import ENGEL, MACHINES, Latency, SimulatedDrive, SimulatedDriveNode, shape
from pdgw.peers.encoder import SimulatedEncoder, SimulatedEncoderNode
from pdgw.peers.encoder.motion import Motion, parse_motion
from pdgw.peers.encoder.outputs import names
from pdgw.peers.node.behaviour import Behaviour
from pdgw.peers.node.node import SimulatedNode


class SimulatedDevice(Protocol):
    """A node that runs in the background."""

    @property
    def node(self) -> SimulatedNode: ...

    @property
    def lost(self) -> str:
        """Why its bus is lost; empty while it is available."""

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def do(self, action: Callable[[SimulatedNode], object], /) -> None:
        """Run an action between two steps of the node."""


DeviceMaker = Callable[..., SimulatedDevice]
"""Called with the device's own bus, node-ID, ``serial_number``, ``loop`` and the options of its type."""


@dataclass(frozen=True, slots=True)
class DeviceType:
    """A type of device: its constructor, the class of its node (with the catalogue of faults), and its status."""

    make: DeviceMaker
    node: type[SimulatedNode]
    status: Callable[[Any], dict[str, object]] = lambda node: {}


def encoder_device(model: str = ROTARY.name, channels: int | None = None) -> EncoderDevice:
    """The encoder model with this name. CanopenError for an unknown name or an impossible number of channels."""
    if model not in DEVICES:
        raise CanopenError("model of encoder", model, f"one of {', '.join(DEVICES)}")
    return DEVICES[model] if channels is None else replace(DEVICES[model], channels=channels)


def _drive(
    bus: can.BusABC | CanPort,
    node_id: int,
    /,
    *,
    serial_number: int,
    axis: str = "rotary",
    like: str = ENGEL.name,
    sync_tolerance: int | None = None,
    command_latency_ms: int = 0,
    status_latency_ms: int = 0,
    loop: Loop | None = None,
) -> SimulatedDrive:
    """``axis``: a name of ``MACHINES``. ``like``: a name of ``SHAPES``. ``sync_tolerance``: replaces that of the variant."""
    if axis not in MACHINES:
        raise CanopenError("axis of drive", axis, ", ".join(MACHINES))
    chosen = shape(like)
    if sync_tolerance is not None:
        chosen = replace(chosen, sync_tolerance=sync_tolerance)
    return SimulatedDrive(
        bus,
        node_id,
        machine=MACHINES[axis],
        shape=chosen,
        serial_number=serial_number,
        latency=Latency(command_latency_ms, status_latency_ms),
        loop=loop,
    )


def _encoder(
    bus: can.BusABC | CanPort,
    node_id: int,
    /,
    *,
    serial_number: int,
    loop: Loop | None,
    model: str = ROTARY.name,
    channels: int | None = None,
    motion: Sequence[Motion] = (),
) -> SimulatedEncoder:
    """``motion``: one for each channel."""
    device = encoder_device(model, channels)
    return SimulatedEncoder(bus, node_id, device=device, motions=motion, serial_number=serial_number, loop=loop)


def _encoder_status(node: SimulatedEncoderNode) -> dict[str, object]:
    model = node.model
    return {
        "model": model.device.name,
        "position": [getattr(model, f"position_{number}") for number in model.channels],
        "speed": [getattr(model, f"speed_{number}") for number in model.channels],
        "alarms": names(Alarm(model.alarms)),
        "warnings": names(Warnings(model.warnings)),
    }


def _drive_status(node: SimulatedDriveNode) -> dict[str, object]:
    model = node.model
    state = state_of(model.statusword)
    return {
        "state": state.value if state else "unknown",
        "mode": int(model.mode),
        "position": model.position_actual,
        "velocity": model.velocity_actual,
        "fault": model.error_code,
    }


DEVICE_TYPES: Mapping[str, DeviceType] = MappingProxyType(
    {
        "drive": DeviceType(_drive, SimulatedDriveNode, _drive_status),
        "encoder": DeviceType(_encoder, SimulatedEncoderNode, _encoder_status),
    }
)
"""Types for the key ``type`` of a [[device]] table."""


class Simulation:
    """Devices running on one bus. CanopenError names a device that does not exist.

    ``loop``: where they run. Without it they run on the thread of all simulated devices, and methods are callable from any
    thread.
    """

    def __init__(self, loop: Loop | None = None) -> None:
        self._loop = loop
        self._devices: dict[int, tuple[str, SimulatedDevice]] = {}
        self._members: list[LoopbackBus] = []

    def add(self, kind: str, bus: can.BusABC | CanPort, node_id: int, serial_number: int, **options: Any) -> None:
        """Add a device of ``DEVICE_TYPES`` without starting it. It owns the bus. ``options`` are those of its type.

        ``motion`` is a list of texts, see ``parse_motion``. A shaft belongs to a drive added before.
        """
        try:
            if "motion" in options:
                options["motion"] = [parse_motion(text, shafts=self._shafts) for text in options["motion"]]
            device = DEVICE_TYPES[kind].make(bus, node_id, serial_number=serial_number, loop=self._loop, **options)
        except CanopenError:
            if isinstance(bus, can.BusABC):
                bus.shutdown()
            else:
                bus.close()
            raise
        self._devices[node_id] = (kind, device)
        if isinstance(bus, LoopbackBus):
            self._members.append(bus)

    @property
    def nodes(self) -> list[int]:
        return list(self._devices)

    def check_bus(self) -> str:
        """Why the bus of a device is lost, if known; empty while all are available."""
        for bus in self._members:
            bus.probe_hub()
        return next((device.lost for _, device in self._devices.values() if device.lost), "")

    @property
    def _shafts(self) -> dict[int, Motion]:
        return {node: device.shaft for node, (_, device) in self._devices.items() if isinstance(device, SimulatedDrive)}

    def device(self, node_id: int) -> SimulatedDevice:
        return self._entry(node_id)[1]

    def _entry(self, node_id: int) -> tuple[str, SimulatedDevice]:
        try:
            return self._devices[node_id]
        except KeyError:
            raise CanopenError("node", node_id, f"a simulated one: {self.nodes}") from None

    def start(self) -> None:
        """Power on."""
        for _, device in self._devices.values():
            device.start()

    def stop(self) -> None:
        """Power off permanently and release the buses."""
        for _, device in self._devices.values():
            device.stop()

    def move(self, node_id: int, motion: str, channel: int = 1) -> None:
        """Set another motion for a channel of an encoder, from its present position; see ``parse_motion``."""
        device = self.device(node_id)
        if not isinstance(device, SimulatedEncoder):
            raise CanopenError("node", node_id, "an encoder, to be moved")
        shafts = self._shafts

        def move(node: SimulatedEncoderNode) -> None:
            channels = node.model.channels
            start = channels[channel].mechanical if channel in channels else 0.0
            node.model.set_motion(parse_motion(motion, start, shafts), channel)

        device.do(move)

    def deflect(self, node_id: int, probe: int, on: bool) -> None:
        """Deflect or release touch probe 1 or 2 of a drive."""
        device = self.device(node_id)
        if not isinstance(device, SimulatedDrive):
            raise CanopenError("node", node_id, "a drive, with probes")
        device.set_probe(probe, on)

    def start_fault(self, node_id: int, name: str, values: Mapping[str, object]) -> Behaviour:
        """Activate a fault of the device's catalogue."""
        made: list[Behaviour] = []
        self.device(node_id).do(lambda node: made.append(node.start_fault(name, **values)))
        return made[0]

    def end_fault(self, node_id: int, name: str | None = None) -> None:
        """End a fault (all of them without a name). An inactive fault is ignored, an unknown one is an error."""
        device = self.device(node_id)
        known = device.node.catalogue
        if name is not None and name not in known:
            raise CanopenError("fault", name, f"one of {', '.join(known)}")
        device.do(lambda node: node.end_fault(name))

    def status(self, node_id: int) -> dict[str, object]:
        """One device as plain data."""
        kind, device = self._entry(node_id)
        status: dict[str, object] = {"node_id": node_id, "type": kind}

        def ask(node: SimulatedNode) -> None:
            status["nmt"] = node.state.name
            status.update(DEVICE_TYPES[kind].status(node))
            status["faults"] = {name: node.behaviours[name].values for name in node.faults}

        device.do(ask)
        return status
