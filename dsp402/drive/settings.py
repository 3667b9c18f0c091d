"""Settings of one drive beside those of every node, and their consequences for a known drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pdgw.ds301.node.node import NodeSettings
from pdgw.dsp402.acting import TURNS_ROUND, Acting, Treatment, acting_in
from pdgw.dsp402.drive.guarding import GuardTimes
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.identification.overlay import NO_CHOICE, Families
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.units.mechanics import UnitKeys

_CYCLIC_MODES: Final = (Mode.CYCLIC_POSITION, Mode.CYCLIC_VELOCITY)


@dataclass(frozen=True, slots=True)
class DriveSettings(NodeSettings):
    """Choices for one drive; times in milliseconds."""

    rpdo_refresh_ms: int = 100
    abort_option: int = 3
    """6007h, when the gateway's heartbeat stops: 0 nothing, 1 malfunction, 2 disable voltage, 3 quick stop."""
    allow_unguarded: bool = False
    """Operate a drive that nothing stops when the gateway dies."""
    units: UnitKeys | None = None
    """Units of the drive in the configuration."""
    families: Families = NO_CHOICE
    """The families that it may be of."""
    tasks: bool = False
    """The drive is given traversing tasks."""
    modulo: bool = False
    """The gateway chooses the direction to a target."""
    initial_mode: Mode | None = None
    """6060h to set and confirm (6061h) during configuration, for layouts without 6060h.

    Profile velocity means the speed mode that the drive offers. With ``sync_period_us`` setpoints take effect with SYNC, and
    60C2h is that time.
    """

    def modes(self, drive: DriveType) -> frozenset[int]:
        """The modes of operation in use; every mode if the PLC chooses."""
        if self.tasks:
            return frozenset((Mode.POSITION, Mode.VELOCITY, Mode.HOMING))
        mode = drive.mode_for(self.initial_mode)
        return frozenset(Mode if mode is None else (mode,))

    def corrected(self, drive: DriveType) -> tuple[Acting, ...]:
        """What the gateway sets before ON of the objects that act in these modes; nothing if the PLC chooses the mode."""
        if self.initial_mode is None and not self.tasks:
            return ()
        return tuple(
            row
            for row in acting_in(self.modes(drive))
            if row.why and (row.treatment is not Treatment.COMPARED or (self.modulo and row is TURNS_ROUND))
        )

    def guarding_of(self, drive: DriveType, gateway_node_id: int, control_index: int) -> GuardTimes:
        """How this drive must monitor the gateway. ``control_index``: index of the RPDO with the Controlword."""
        cyclic = drive.mode_for(self.initial_mode) in _CYCLIC_MODES
        return GuardTimes(
            gateway_node_id,
            self.heartbeat_ms,
            self.heartbeat_factor,
            self.rpdo_refresh_ms,
            self.abort_option,
            control_index,
            drive.quirks.sync_loss_periods,
            self.sync_period_us if cyclic else 0,
        )
