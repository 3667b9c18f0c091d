"""The modes of operation of the simulated drive: one object for each mode, selected by 6061h.

Source: the manufacturer's guide chapters 6 and 7, CiA DSP 402 V2.0 (profile position, profile velocity, homing), CiA 402-2
(cyclic synchronous modes). The model has the state of the power section and the quick stop.
"""

from __future__ import annotations

from pdgw.dsp402.modes import Mode
from pdgw.peers.drive.model.homing import Homing
from pdgw.peers.drive.model.mode_of_operation import ModeOfOperation
from pdgw.peers.drive.model.position_modes import CyclicPosition, ProfilePosition, Turntable
from pdgw.peers.drive.model.speed_modes import (
    CurrentControl,
    CyclicTorque,
    CyclicVelocity,
    ProfileVelocity,
    SpeedControl,
    Torque,
    VelocityMode,
)
from pdgw.peers.drive.objects import CURRENT_CONTROL, SPEED_CONTROL, TURNTABLE

MODES: dict[int, type[ModeOfOperation]] = {
    TURNTABLE.mode: Turntable,
    CURRENT_CONTROL: CurrentControl,
    SPEED_CONTROL: SpeedControl,
    Mode.POSITION: ProfilePosition,
    Mode.VL_VELOCITY: VelocityMode,
    Mode.VELOCITY: ProfileVelocity,
    Mode.TORQUE: Torque,
    Mode.HOMING: Homing,
    Mode.CYCLIC_POSITION: CyclicPosition,
    Mode.CYCLIC_VELOCITY: CyclicVelocity,
    Mode.CYCLIC_TORQUE: CyclicTorque,
}
"""The class of each mode by its value of 6060h."""
