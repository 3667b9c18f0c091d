"""The simulated drive on a bus: the CANopen node around the model, and what commands it there."""

from __future__ import annotations

import can
from pdgw.ds301.loop import Loop
from pdgw.ds301.nmt import NmtState
from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import Pdo
from pdgw.ds301.port import CanPort
from pdgw.dsp402.device import drive_objects
from pdgw.peers.drive.misbehaviour import DRIVE_MISBEHAVIOURS
from pdgw.peers.drive.model import DriveModel, Machine
from pdgw.peers.drive.motion import INCREMENTS_PER_REVOLUTION
from pdgw.peers.node.node import SendFunction, SimulatedNode, Value
from pdgw.peers.node.running import RunningNode


class SimulatedDriveNode(SimulatedNode):
    """CANopen drive, sans-I/O: ``receive`` and ``poll`` with times, frames to ``send``."""

    catalogue = DRIVE_MISBEHAVIOURS

    def __init__(
        self, node_id: int, send: SendFunction, *, machine: Machine | None = None, pdos: int = 5, serial_number: int = 1
    ) -> None:
        self._ready = False
        self.model = DriveModel(self._object, machine)
        super().__init__(node_id, drive_objects(serial_number, pdos), self.model, send)
        self._ready = True

    def _object(self, index: int, subindex: int) -> int:
        if not self._ready:
            # The model looks at its objects once before the node has them.
            return {0x6094: subindex, 0x6080: 1}.get(index, 0)
        return int(self.values[index, subindex])

    def on_poll(self, now: int) -> None:
        self.model.advance(now)
        self.send_emergencies(self.model.emcy)

    def next_change(self, now: int) -> int | None:
        return self.model.next_change()

    def on_touched(self) -> None:
        self.model.wake()

    def on_rpdo(self, pdo: Pdo) -> None:
        self.model.wake()
        if "controlword" in pdo.attributes or "modes_of_operation" in pdo.attributes:
            self.model.command()
            self.send_emergencies(self.model.emcy)

    def on_written(self, entry: Entry, value: Value) -> None:
        if entry.attribute in {"controlword", "modes_of_operation"}:
            setattr(self.model, entry.attribute, value)
            self.model.command()
            self.send_emergencies(self.model.emcy)

    def on_nmt(self, state: NmtState) -> None:
        if state is not NmtState.OPERATIONAL:
            self.model.abort_connection()

    def on_consumer_expired(self, producer: int) -> None:
        self.send_emcy(0x8130, 0x11)
        self.model.abort_connection()
        self.send_emergencies(self.model.emcy)

    def on_reset(self) -> None:
        self.model.reset()


class SimulatedDrive(RunningNode[SimulatedDriveNode]):
    """A ``SimulatedDriveNode`` running on a bus; see ``RunningNode``."""

    def __init__(
        self,
        bus: can.BusABC | CanPort,
        node_id: int,
        *,
        machine: Machine | None = None,
        pdos: int = 5,
        serial_number: int = 1,
        loop: Loop | None = None,
    ) -> None:
        super().__init__(
            bus,
            lambda send: SimulatedDriveNode(node_id, send, machine=machine, pdos=pdos, serial_number=serial_number),
            loop,
        )

    @property
    def model(self) -> DriveModel:
        return self.node.model

    def shaft(self, _: int) -> float:
        """Revolutions of the shaft now since power-on, untouched by homing: what turns an encoder on it.

        For devices on the drive's loop. Between the ticks of the model the shaft turns on with its speed.
        """
        return self.model.turned(self.loop.now()) / INCREMENTS_PER_REVOLUTION

    def inject(self, fault: int) -> None:
        """Raise fault 1-12; see ``DriveModel.inject``."""
        self.do(lambda node: node.model.inject(fault))

    def clear(self) -> None:
        """Remove the causes of all faults."""
        self.do(lambda node: node.model.clear())

    def set_enable_input(self, on: bool) -> None:
        """Digital input DI1."""
        self.do(lambda node: node.model.set_enable_input(on))
