"""The simulated drive on a bus: the CANopen node of the model, and its commands."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import can

from pdgw.base.durations import MS
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.bus.port import CanPort
from pdgw.ds301.communication import ERROR_CONTROL, GUARD_TIME, GUARD_TOGGLE, LIFE_TIME_FACTOR, NmtState
from pdgw.ds301.configuration import EVENT_TIMER
from pdgw.ds301.emcy import COMMUNICATION_ERROR, HEARTBEAT_ERROR
from pdgw.ds301.loop.loop import Loop
from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive import touch_probe
from pdgw.peers.drive.drive_behaviours import DRIVE_HABITS
from pdgw.peers.drive.model.latency import NO_LATENCY, Latency
from pdgw.peers.drive.model.model import DriveModel
from pdgw.peers.drive.model.ramps import INCREMENTS_PER_REVOLUTION
from pdgw.peers.drive.model.shapes import ENGEL, Machine, Shape
from pdgw.peers.drive.option_codes import OPTION_CODES, is_simulated
from pdgw.peers.node.behaviour import NONE, HabitValues
from pdgw.peers.node.device import Value
from pdgw.peers.node.node import SendFunction, SimulatedNode
from pdgw.peers.node.running import RunningNode

_WITHOUT: Final = {
    **dict.fromkeys((0x607F, 0x60C5, 0x60C6), 0x7FFF_FFFF),
    0x6080: 6000,
    0x6073: 1000,
    0x6085: 10_000,
    0x60F2: 2,
    **{index: code.default for index, code in OPTION_CODES.items()},
}
"""Values used without an object: no limit, own rating, or the profile's default."""
_STEADY: Final = frozenset(
    {"statusword", "modes_of_operation_display", "velocity_actual", "velocity_demand", "current_actual"}
)
"""Values of the image that do not change while the axis turns at constant speed."""


class SimulatedDriveNode(SimulatedNode):
    """CANopen drive, sans-I/O: ``receive`` and ``poll`` with times, frames to ``send``."""

    catalogue = DRIVE_HABITS

    def __init__(
        self,
        node_id: int,
        send: SendFunction,
        *,
        machine: Machine | None = None,
        pdos: int | None = None,
        serial_number: int = 1,
        shape: Shape = ENGEL,
        latency: Latency = NO_LATENCY,
        habits: HabitValues = NONE,
    ) -> None:
        self._ready = False
        self.shape = shape
        self.frozen: Sequence[str] = ()
        """Objects accepted in the mapping of a TPDO but sent as zeros."""
        self._guard_toggle = 0
        self._guarded_until = 0
        self._commands: deque[tuple[int, Pdo, bytes]] = deque()
        """Received RPDOs with the time at which they apply."""
        self.model = DriveModel(self._object, machine, shape)
        self.model.latency = replace(latency)
        super().__init__(node_id, shape.objects(serial_number, pdos), self.model, send, {**shape.habits, **habits})
        self._ready = True

    def _object(self, index: int, subindex: int) -> int:
        if not self._ready:
            # The model reads its objects once before the node has them.
            return {0x6094: subindex, 0x6080: 1}.get(index, 0)
        value = self.values.get((index, subindex))
        if value is None:
            return _WITHOUT.get(index, 0)
        return value if isinstance(value, int) else int(value)

    def on_poll(self, now: int) -> None:
        self.model.advance(now)
        while self._commands and self._commands[0][0] <= now:
            _, pdo, data = self._commands.popleft()
            self._take(pdo, data)
        if self.model.emcy:
            self.send_emergencies(self.model.emcy)

    def next_change(self, now: int) -> int | None:
        return self.model.next_change()

    def steady(self, pdo: Pdo, ticks: int) -> bool:
        return self.model.cruises(ticks) and _STEADY.issuperset(pdo.attributes)

    def apply(self, pdo: Pdo, data: bytes) -> None:
        if time_out := int(self.values.get((pdo.communication_index, EVENT_TIMER), 0)):
            self._guarded_until = self.now + time_out * MS
        due = self.now + self.model.latency.command_ms * MS
        if due > self.now or self._commands:
            # Keep the order of commands when the latency changes.
            self._commands.append((max(due, self._commands[-1][0]) if self._commands else due, pdo, data))
        else:
            self._take(pdo, data)

    def _take(self, pdo: Pdo, data: bytes) -> None:
        """Apply an RPDO. Values that are already in the image have no effect on the model."""
        if pdo.pack(self.model) != data[: pdo.size]:
            self.model.wake()
        super().apply(pdo, data)

    def on_touched(self) -> None:
        self.model.wake()

    def on_rpdo(self, pdo: Pdo) -> None:
        if "controlword" in pdo.attributes or "modes_of_operation" in pdo.attributes:
            self.model.command()
            self.send_emergencies(self.model.emcy)

    def packed(self, pdo: Pdo) -> bytes:
        data = pdo.pack(self.model)
        if not set(self.frozen).isdisjoint(pdo.attributes):
            end = 0
            for entry in pdo.entries:
                begin, end = end, end + entry.type.bits // 8
                if entry.attribute in self.frozen:
                    data = data[:begin] + bytes(end - begin) + data[end:]
        return data

    def on_sync(self) -> None:
        self.model.synchronised()

    def on_written(self, entry: Entry, value: Value) -> None:
        if entry.attribute in {"controlword", "modes_of_operation"}:
            setattr(self.model, entry.attribute, value)
            self.model.command()
            self.send_emergencies(self.model.emcy)
        elif not is_simulated(entry.index, value):
            raise SdoAbortedError(Abort.VALUE_RANGE)
        elif entry.index == touch_probe.FUNCTION:
            self.model.touch_probe_function = int(value)
            self.model.probe.command()

    def on_nmt(self, state: NmtState) -> None:
        self._commands.clear()
        operates = state is NmtState.PRE_OPERATIONAL and not self.model.stops_in_pre_operational
        if state is not NmtState.OPERATIONAL and not operates:
            self.model.abort_connection()

    def on_consumer_expired(self, producer: int) -> None:
        self._commands.clear()
        self.send_emcy(HEARTBEAT_ERROR, COMMUNICATION_ERROR)
        self.model.abort_connection()
        self.send_emergencies(self.model.emcy)

    def on_reset(self) -> None:
        self.model.reset()

    # -- node guarding (CiA 301, 7.2.8.3.2) and timeout of RPDOs, for drives without heartbeats -----------------------------

    @property
    def _life_time(self) -> int:
        return int(self.values[GUARD_TIME, 0]) * int(self.values[LIFE_TIME_FACTOR, 0]) * MS

    def receive_remote(self, can_id: int, now: int) -> None:
        if not self.shape.node_guarding or can_id != ERROR_CONTROL + self.node_id:
            super().receive_remote(can_id, now)
        elif self.running:
            self.now = now
            self._guarded_until = now + self._life_time if self._life_time else 0
            self.transmit(can_id, bytes([self._guard_toggle | self.state]))
            self._guard_toggle ^= GUARD_TOGGLE

    def poll(self, now: int) -> None:
        if self._guarded_until and now > self._guarded_until:
            self._guarded_until = 0
            self.now = now
            self.on_consumer_expired(0)
        super().poll(now)

    def next_event(self, now: int) -> int | None:
        event = super().next_event(now)
        if self._guarded_until and (event is None or self._guarded_until < event):
            event = self._guarded_until + 1
        if self._commands and self.running and (event is None or self._commands[0][0] < event):
            event = self._commands[0][0]
        return event


class SimulatedDrive(RunningNode[SimulatedDriveNode]):
    """A ``SimulatedDriveNode``, which has the ``options``, running on a bus; see ``RunningNode``."""

    def __init__(self, bus: can.BusABC | CanPort, node_id: int, *, loop: Loop | None = None, **options: Any) -> None:
        super().__init__(bus, lambda send: SimulatedDriveNode(node_id, send, **options), loop)

    @property
    def model(self) -> DriveModel:
        return self.node.model

    def shaft(self, _: int) -> float:
        """Present revolutions of the shaft since power-on, unaffected by homing; drives an encoder on this shaft.

        For devices on the drive's loop. Between the model's ticks the shaft continues with its speed.
        """
        return self.model.turned(self.loop.now()) / INCREMENTS_PER_REVOLUTION

    def inject(self, fault: int | str) -> None:
        """Raise a fault by number or name, see ``DriveModel.inject``, or start a habit."""
        self.raise_fault(fault, lambda node: node.model.inject(fault))

    def clear(self) -> None:
        """Remove the causes of all faults, and end the habits."""
        self.do(lambda node: node.end_fault())
        self.do(lambda node: node.model.clear())

    def set_probe(self, probe: int, on: bool) -> None:
        """Deflect or release touch probe 1 or 2."""
        self.do(lambda node: node.model.probe.set_input(probe, on))

    def set_enable_input(self, on: bool) -> None:
        """Set digital input DI1."""
        self.do(lambda node: node.model.set_enable_input(on))
