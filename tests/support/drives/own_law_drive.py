"""A drive whose speed does not depend on the units in its objects: for tests of drives that report wrong units.

It does not use the gateway's scaling. One unit of 60FFh is ``rpm_per_unit`` of the shaft, which has ``counts`` position units
a revolution; 606Ch is what ``shown`` makes of the true speed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pdgw.base.durations import MS
from pdgw.ds301.communication import NmtState, communication_objects, pdo_objects
from pdgw.ds301.objects import Access, CanType, Entry, ObjectSpec, array, var
from pdgw.ds301.pdo import Pdo, PdoDirection
from pdgw.dsp402.pdo.layouts import pdo
from pdgw.dsp402.states import STATUS_OF, ControlBit, State, StatusBit, next_state
from pdgw.peers.node.node import SendFunction, SimulatedNode, Value
from pdgw.peers.node.running import RunningNode
from pdgw.peers.world import World

_RAMP_RPM_S = 6000.0
_U32, _I32, _U16, _I8, _I16 = CanType.U32, CanType.I32, CanType.U16, CanType.I8, CanType.I16
_RO, _RW = Access.RO, Access.RW


@dataclass(frozen=True)
class Law:
    """What the drive really does, and what its objects say."""

    rpm_per_unit: float
    counts: float = 4096
    """Position units of a revolution."""
    objects: Mapping[tuple[int, int], int] = field(default_factory=dict)
    """What it says: values by index and sub-index (0 for a simple object, 1 and 2 for a ratio)."""
    identity: tuple[int, int] = (0x77, 1)
    """Vendor-ID and product code."""
    name: str = "Drive with a law of its own"
    """1008h."""
    shown: Callable[[float, float], float] = lambda rpm, target: rpm
    """The speed that 606Ch shows, in rpm, for the true one and the commanded one."""
    excess: Callable[[float], float] = lambda seconds: 1.0
    """Ratio of true to commanded speed, as a function of the seconds in operation."""
    vl: bool = False
    """Its speed is that of velocity mode (vl): 6042h, 6044h."""


class _Shaft(SimulatedNode):
    def __init__(self, node_id: int, law: Law, send: SendFunction) -> None:
        self.law = law
        self.rpm_per_unit = law.rpm_per_unit
        self.drive_state = State.SWITCH_ON_DISABLED
        self.rpm = self.turns = self.fastest = 0.0
        self.error_register = 0
        self.controlword = self.target_velocity = self.velocity_actual = self.position_actual = self.statusword = 0
        self.modes_of_operation = self.modes_of_operation_display = 2 if law.vl else 3
        self._word = 0
        self._at = self._enabled_at = 0
        self.stopped_at = 0
        """When operation ended."""
        self.states: set[State] = set()
        super().__init__(node_id, _objects(law), self, send)
        self._show()

    def on_rpdo(self, pdo: Pdo) -> None:
        self._command()

    def on_written(self, entry: Entry, value: Value) -> None:
        if entry.attribute:
            setattr(self, entry.attribute, value)
            self._command()

    def _command(self) -> None:
        before = self.drive_state
        self.drive_state = next_state(before, self.controlword, self._word)
        self._word = self.controlword
        self.states.add(self.drive_state)
        if self.drive_state is State.OPERATION_ENABLED and before is not State.OPERATION_ENABLED:
            self._enabled_at = self.now
        if before is State.OPERATION_ENABLED and self.drive_state is not before:
            self.stopped_at = self.now
        self._show()

    def on_reset(self) -> None:
        self.drive_state, self.rpm = State.SWITCH_ON_DISABLED, 0.0
        self.controlword = self.target_velocity = self._word = 0

    def on_nmt(self, state: NmtState) -> None:
        if state is not NmtState.OPERATIONAL:
            self.drive_state = State.SWITCH_ON_DISABLED
            self._show()

    def on_poll(self, now: int) -> None:
        while self._at + MS <= now:
            self._at += MS
            self._tick()
        self._show()

    def next_change(self, now: int) -> int | None:
        return self._at + MS

    def _tick(self) -> None:
        operating = self.drive_state is State.OPERATION_ENABLED and not self.controlword & ControlBit.HALT
        wanted = 0.0
        if operating:
            wanted = self.target_velocity * self.rpm_per_unit * self.law.excess((self._at - self._enabled_at) / 1e9)
        step = _RAMP_RPM_S / 1000 * max(1.0, abs(wanted) / 3000)
        self.rpm += max(-step, min(step, wanted - self.rpm))
        self.turns += self.rpm / 60_000
        self.fastest = max(self.fastest, abs(self.rpm))
        if self.drive_state is State.QUICK_STOP_ACTIVE and self.rpm == 0:
            self.drive_state = State.SWITCH_ON_DISABLED

    def _show(self) -> None:
        unit = self.rpm_per_unit
        shown = self.law.shown(self.rpm, self.target_velocity * unit)
        low, high = (-(1 << 15), (1 << 15) - 1) if self.law.vl else (-(1 << 31), (1 << 31) - 1)
        self.velocity_actual = max(low, min(round(shown / unit), high))
        self.position_actual = (round(self.turns * self.law.counts) + (1 << 31)) % (1 << 32) - (1 << 31)
        word = STATUS_OF[self.drive_state] | StatusBit.VOLTAGE_ENABLED | StatusBit.REMOTE
        self.statusword = word if self.drive_state is State.QUICK_STOP_ACTIVE else word | StatusBit.NO_QUICK_STOP


def _objects(law: Law) -> tuple[ObjectSpec, ...]:
    target, actual, kind = (0x6042, 0x6044, _I16) if law.vl else (0x60FF, 0x606C, _I32)
    own = (
        var(0x6007, "Abort connection option", _I16, _RW, default=3),
        var(0x6040, "Controlword", _U16, _RW, pdo=True, default=0, attribute="controlword"),
        var(0x6041, "Statusword", _U16, _RO, pdo=True, default=0, attribute="statusword"),
        var(0x6060, "Modes of operation", _I8, _RW, pdo=True, default=3, attribute="modes_of_operation"),
        var(0x6061, "Modes display", _I8, _RO, pdo=True, default=3, attribute="modes_of_operation_display"),
        var(0x6064, "Position actual value", _I32, _RO, pdo=True, default=0, attribute="position_actual"),
        var(actual, "Velocity actual value", kind, _RO, pdo=True, default=0, attribute="velocity_actual"),
        var(target, "Target velocity", kind, _RW, pdo=True, default=0, attribute="target_velocity"),
        var(0x6502, "Supported drive modes", _U32, _RO, default=1 << 1 if law.vl else 1 << 2),
    )
    mapped = (pdo(PdoDirection.RPDO, 1, "controlword"), pdo(PdoDirection.TPDO, 1, "statusword"))
    return (
        *communication_objects(0x0002_0192, law.name, (*law.identity, 1, 4711), ("1", "1")),
        *pdo_objects(4, 4, mapped),
        *own,
        *_specs(law.objects),
    )


def _specs(objects: Mapping[tuple[int, int], int]) -> list[ObjectSpec]:
    specs = []
    for index in sorted({index for index, _ in objects}):
        values = {subindex: value for (found, subindex), value in objects.items() if found == index}
        if 0 in values:
            kind = {0x608B: _I8, 0x608C: CanType.U8}.get(index, _U32)
            specs.append(var(index, f"{index:04X}h", kind, _RW, default=values[0]))
        else:
            parts = [
                Entry(index, sub, f"{index:04X}h/{sub}", _U32, _RW, default=value) for sub, value in values.items()
            ]
            specs.append(array(index, f"{index:04X}h", parts[0], *parts[1:]))
    return specs


class OwnLawDrive(RunningNode[_Shaft]):
    """Running on a bus of a world."""

    def __init__(self, world: World, channel: str, node_id: int, law: Law) -> None:
        port = world.bus(channel).join(f"node {node_id}")
        super().__init__(port, lambda send: _Shaft(node_id, law, send), world.loop)
        self.start()
