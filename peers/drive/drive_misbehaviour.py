"""Faults of a simulated drive in addition to those of any CANopen node, each declared once.

Source: CiA DSP 402 V2.0 and the manufacturer's guide, whose rules they violate; see ``peers.node.misbehaviour``.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import StatusBit
from pdgw.durations import MS
from pdgw.peers.drive.objects import DRIVE_FAULTS
from pdgw.peers.node.faults import NODE_MISBEHAVIOURS, Reboot
from pdgw.peers.node.misbehaviour import HEX, Misbehaviour, catalogue, parameter

if TYPE_CHECKING:
    from pdgw.peers.drive.model.model import DriveModel
    from pdgw.peers.drive.model.shapes import Machine


_STATE_BITS = 0x7F
_UNDER_VOLTAGE = 6


@dataclass(kw_only=True, eq=False)
class DriveMisbehaviour(Misbehaviour):
    """A fault of a drive, with access to its model."""

    @property
    def model(self) -> DriveModel:
        """The model of the node's drive."""
        return cast("DriveModel", self.node.image)


@dataclass(kw_only=True, eq=False)
class _Disguise(DriveMisbehaviour):
    """The drive shows another state than its own: ``disguise`` changes its image after each update."""

    def begin(self) -> None:
        self.model.disguises.append(self.disguise)

    def end(self) -> None:
        self.model.disguises.remove(self.disguise)

    def disguise(self, model: DriveModel, now: int) -> None:
        """Change the shown values (``now``: the model's time in ns)."""
        raise NotImplementedError


# -- Statusword and mode --------------------------------------------------------------------------------------------------


@dataclass(kw_only=True, eq=False)
class NoHomingAttained(_Disguise):
    """Homing ends without "homing attained" (Statusword.12), although the axis is at its home position."""

    name = "no-homing-attained"

    def disguise(self, model: DriveModel, now: int) -> None:
        if model.mode == Mode.HOMING:
            model.statusword &= ~StatusBit.MODE_12


@dataclass(kw_only=True, eq=False)
class LateStatus(_Disguise):
    """Bits of the Statusword are late; positions and speeds are up to date."""

    name = "late-status"
    delay_ms: int = parameter(60, 1, 10_000, "age of the bits", "ms")
    bits: int = parameter(0xFFFF, 1, 0xFFFF, "which bits", HEX)
    _history: deque[tuple[int, int]] = field(init=False, repr=False, default_factory=deque)

    def disguise(self, model: DriveModel, now: int) -> None:
        history = self._history
        if not history or history[-1][1] != model.statusword:
            history.append((now, model.statusword))
        while len(history) > 1 and history[1][0] <= now - self.delay_ms * MS:
            history.popleft()
        model.statusword = model.statusword & ~self.bits | history[0][1] & self.bits


@dataclass(kw_only=True, eq=False)
class BouncingStatus(_Disguise):
    """Bits of the Statusword bounce: they are inverted in every second period."""

    name = "bouncing-status"
    bits: int = parameter(StatusBit.OPERATION_ENABLED, 1, 0xFFFF, "which bits", HEX)
    period_ms: int = parameter(20, 1, 10_000, "half of a period", "ms")

    def disguise(self, model: DriveModel, now: int) -> None:
        if now // (self.period_ms * MS) & 1:
            model.statusword ^= self.bits


@dataclass(kw_only=True, eq=False)
class UnknownState(_Disguise):
    """The Statusword matches no state of CiA 402."""

    name = "unknown-state"
    bits: int = parameter(0x2C, 0, _STATE_BITS, "Statusword bits 0-6", HEX)

    def disguise(self, model: DriveModel, now: int) -> None:
        model.statusword = model.statusword & ~_STATE_BITS | self.bits


@dataclass(kw_only=True, eq=False)
class ModeDisplayStuck(_Disguise):
    """Modes of Operation Display 6061h never changes."""

    name = "mode-display-stuck"
    _shown: int = field(init=False, repr=False, default=0)

    def begin(self) -> None:
        self._shown = self.model.modes_of_operation_display
        super().begin()

    def disguise(self, model: DriveModel, now: int) -> None:
        model.modes_of_operation_display = self._shown


# -- machine and power ----------------------------------------------------------------------------------------------------


@dataclass(kw_only=True, eq=False)
class LimitSwitch(DriveMisbehaviour):
    """A limit switch is active at the present position: the drive stops motion in that direction."""

    name = "limit-switch"
    positive: int = parameter(1, 0, 1, "1 positive, 0 negative limit switch")
    _machine: Machine = field(init=False, repr=False)

    def begin(self) -> None:
        model = self.model
        self._machine = model.machine
        position = model.machine_position
        if self.positive:
            model.machine = replace(model.machine, positive_limit=position)
        else:
            model.machine = replace(model.machine, negative_limit=position)

    def end(self) -> None:
        self.model.machine = self._machine


@dataclass(kw_only=True, eq=False)
class EnableInputDropped(DriveMisbehaviour):
    """The enable input DI1 becomes 0: the drive leaves operation by itself."""

    name = "enable-input-dropped"

    def begin(self) -> None:
        self.model.set_enable_input(False)

    def end(self) -> None:
        self.model.set_enable_input(True)


@dataclass(kw_only=True, eq=False)
class DriveFault(DriveMisbehaviour):
    """A fault of the manufacturer's table (200Ch). Its cause is present until you clear this fault."""

    name = "drive-fault"
    number: int = parameter(10, min(DRIVE_FAULTS), max(DRIVE_FAULTS), "number in 200Ch")

    def begin(self) -> None:
        self.model.inject(self.number)

    def end(self) -> None:
        self.model.causes.discard(self.number)


@dataclass(kw_only=True, eq=False)
class UnderVoltage(_Disguise):
    """The DC-link voltage drops: fault 6, and 6079h shows the remaining voltage."""

    name = "under-voltage"
    voltage: int = parameter(9000, 0, 48_000, "remaining voltage, as 6079h reports it", "mV")
    _before: int = field(init=False, repr=False, default=0)

    def begin(self) -> None:
        super().begin()
        self._before = self.model.dc_link_voltage
        self.model.inject(_UNDER_VOLTAGE)

    def end(self) -> None:
        super().end()
        self.model.dc_link_voltage = self._before
        self.model.causes.discard(_UNDER_VOLTAGE)

    def disguise(self, model: DriveModel, now: int) -> None:
        model.dc_link_voltage = self.voltage


@dataclass(kw_only=True, eq=False)
class RebootInMotion(Reboot, DriveMisbehaviour):
    """The drive restarts while it turns: it is silent, then sends its boot-up message."""

    name = "reboot-in-motion"
    speed: int = parameter(100, 1, 100_000, "turns faster than this", "rpm")
    _done: bool = field(init=False, repr=False, default=False)

    def begin(self) -> None:
        """Wait for the motion."""

    def poll(self, now: int) -> None:
        if not self._done and abs(self.model.ramp.speed) > self.speed:
            self._done = True
            self._go()
        super().poll(now)

    def next_event(self, now: int) -> int | None:
        return now + MS if not self._done and self.model.next_change() is not None else super().next_event(now)


# -- commands -----------------------------------------------------------------------------------------------------------


@dataclass(kw_only=True, eq=False)
class IgnoresRpdos(DriveMisbehaviour):
    """The drive ignores every RPDO: it continues with its last command and shows that state."""

    name = "deaf"

    def incoming(self, can_id: int, data: bytes) -> bool:
        return not self.node.is_pdo(can_id)


@dataclass(kw_only=True, eq=False)
class StopRampMissing(DriveMisbehaviour):
    """The quick stop does not brake: the drive shows Quick Stop Active and continues to turn."""

    name = "stop-ramp-missing"

    def begin(self) -> None:
        self.model.stop_ramp = False

    def end(self) -> None:
        self.model.stop_ramp = True


@dataclass(kw_only=True, eq=False)
class TurnsInPreOperational(DriveMisbehaviour):
    """NMT pre-operational does not stop the drive (CiA 402 does not list it for 6007h), and the drive accepts no RPDO there."""

    name = "turns-in-pre-operational"

    def begin(self) -> None:
        self.model.stops_in_pre_operational = False

    def end(self) -> None:
        self.model.stops_in_pre_operational = True


DRIVE_MISBEHAVIOURS = catalogue(
    NODE_MISBEHAVIOURS.values(),
    (
        NoHomingAttained,
        LateStatus,
        BouncingStatus,
        UnknownState,
        ModeDisplayStuck,
        LimitSwitch,
        EnableInputDropped,
        DriveFault,
        UnderVoltage,
        RebootInMotion,
        IgnoresRpdos,
        StopRampMissing,
        TurnsInPreOperational,
    ),
)
"""All faults of a simulated drive."""
