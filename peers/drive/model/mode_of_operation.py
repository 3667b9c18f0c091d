"""What every mode of operation of the simulated drive has."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from pdgw.dsp402.states import ControlBit, State, StatusBit

if TYPE_CHECKING:
    from pdgw.peers.drive.model.model import DriveModel


class ModeOfOperation:
    """One mode of one drive."""

    even: ClassVar[bool] = False
    """At constant speed nothing but the position changes."""
    makes_torque: ClassVar[bool] = False
    """It sets the torque itself."""
    synchronous: ClassVar[bool] = False
    """It needs a setpoint with each SYNC."""

    def __init__(self, drive: DriveModel) -> None:
        self.drive = drive

    def selected(self) -> None:
        """6061h is this mode from now on: nothing of earlier times is left."""
        self.enabled()

    def enabled(self) -> None:
        """Operation begins."""

    def disabled(self) -> None:
        """Operation was left."""

    def command(self, word: int, previous: int) -> None:
        """A Controlword in operation."""

    def received(self) -> None:
        """New setpoints may be in the image."""

    def move(self) -> None:
        """One tick in operation."""
        raise NotImplementedError

    def bits(self, halted: bool, units: int) -> int:
        """The Statusword's bits of the mode. ``halted``: Halt in operation; ``units``: actual velocity."""
        return StatusBit.TARGET_REACHED if halted and units == 0 else 0

    def condition(self) -> tuple[object, ...]:
        """What a tick can change of it."""
        return ()

    def _rises(self, word: int, previous: int) -> bool:
        return bool(word & ControlBit.NEW_SETPOINT and not previous & ControlBit.NEW_SETPOINT)

    def _allowed(self, word: int, previous: int) -> bool:
        """Resetting Halt and setting bit 4 in one Controlword is not allowed: the setpoint is not taken."""
        return not (word | previous) & ControlBit.HALT


def follows(drive: DriveModel, halted: bool) -> int:
    """Bit 12 of the cyclic synchronous modes: the drive follows the command value."""
    operating = drive.state is State.OPERATION_ENABLED
    return StatusBit.MODE_12 if operating and not halted and not drive.limited else 0
