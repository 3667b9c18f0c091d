"""A drive client and a simulated drive on one virtual bus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import can

from pdgw.base.durations import MS
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.node.node import NodeNotice
from pdgw.dsp402.drive.client import DriveClient, DriveStatus
from pdgw.dsp402.drive.images import DriveCommand
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.peers.drive import SimulatedDrive, SimulatedDriveNode
from pdgw.peers.drive.objects import EDS_PATH
from pdgw.peers.node.node import Value
from tests.support.gateways import site

NODE = 4


class Plant:
    """A client and a simulated drive on one bus."""

    def __init__(self, network: CanNetwork) -> None:
        self.network = network
        self.events: list[NodeNotice] = []
        self.drive: SimulatedDrive | None = None
        self.client: DriveClient | None = None

    def power_on(
        self,
        kind: type[SimulatedDriveNode] | None = None,
        values: Mapping[tuple[int, int], Value] | None = None,
        *,
        pdos: int = 5,
        misbehaves: str = "",
    ) -> SimulatedDrive:
        """Switch the drive on. ``kind``: of another node; ``values``: of its objects; ``misbehaves``: from the start."""
        self.drive = drive = site.drive(NODE, pdos=pdos)
        if kind is not None:
            drive.node = kind(NODE, drive._send)
        drive.node.values |= values or {}
        drive.node.pdos.map()
        if misbehaves:
            drive.node.start_fault(misbehaves)
        drive.start()
        return drive

    def connect(self, operation: Operation = Operation.VELOCITY, **settings: object) -> DriveClient:
        values: dict[str, object] = {"node_id": NODE, "sdo_timeout_ms": 200, "initial_mode": Mode.VELOCITY, **settings}
        chosen = DriveSettings(**values)  # type: ignore[arg-type]
        self.client = DriveClient(self.network, chosen, LAYOUTS[operation], self.events.append)
        self.client.start()
        return self.client

    def online(self, generation: int = 1) -> None:
        client = self.client
        assert client is not None
        site.wait_for(
            lambda: client.status is DriveStatus.ONLINE and client.generation == generation,
            f"online ({client.status_text})",
        )

    def connected(self, operation: Operation = Operation.VELOCITY, **settings: object) -> DriveClient:
        """A client that is online. It switches the drive on if no test did."""
        if self.drive is None:
            self.power_on()
        client = self.connect(operation, **settings)
        self.online()
        return client

    def refused(self) -> str:
        """Wait until the client refuses the drive. Return its status text."""
        client = self.client
        assert client is not None
        site.wait_for(lambda: client.status is DriveStatus.REFUSED, "refused")
        return client.status_text

    def hear(self, **values: int) -> None:
        """Send Shutdown and other values, and wait until the drive has the Controlword and shows its new state."""
        client, drive = self.client, self.drive
        assert client is not None
        assert drive is not None
        command = DriveCommand()
        command.controlword = 0x06
        for name, value in values.items():
            setattr(command, name, value)
        client.send(command, 1)
        site.wait_for(lambda: drive.model.controlword == 0x06, "the Controlword is heard")
        site.wait_for(lambda: client.refresh(0) is not None and client.feedback.statusword & 0x6F == 0x21, "ready")

    def run(self, words: Sequence[int], milliseconds: int, **values: int) -> None:
        """Send these Controlwords one after another, with other values; the last one for this time."""
        client = self.client
        assert client is not None
        command = DriveCommand()
        for name, value in values.items():
            setattr(command, name, value)
        for word in words:
            command.controlword = word
            end = site.now() + (milliseconds if word == words[-1] else 20) * MS
            while site.now() < end:
                client.send(command, site.now())
                client.refresh(site.now())
                site.pass_time(4 * MS)

    def close(self) -> None:
        if self.client is not None:
            self.client.stop()
        if self.drive is not None:
            self.drive.stop()


def eds_without(folder: Path, indices: tuple[str, ...]) -> Path:
    sections = []
    keep = True
    for line in EDS_PATH.read_text(encoding="ascii").splitlines():
        if line.startswith("["):
            keep = not line[1:].startswith(indices)
        if keep and not any(line.endswith(f"=0x{index}") for index in indices):
            sections.append(line)
    path = folder / "four.eds"
    path.write_text("\n".join(sections), encoding="ascii")
    return path


def observe(plant: Plant) -> list[tuple[int, int, bytes]]:
    """SDO downloads (index, subindex, data) and NMT commands (0, 0, data) in the order they appear on the bus."""
    seen: list[tuple[int, int, bytes]] = []

    def record(message: can.Message) -> None:
        data = bytes(message.data)
        if message.is_rx:
            return
        if message.arbitration_id == 0:
            seen.append((0, 0, data))
        elif message.arbitration_id == 0x600 + NODE and data[0] >> 5 == 1:
            size = 4 - (data[0] >> 2 & 3)
            seen.append((int.from_bytes(data[1:3], "little"), data[3], data[4 : 4 + size]))

    plant.network.listeners.append(record)
    return seen
