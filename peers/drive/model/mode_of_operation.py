"""Base class of the modes of operation of the simulated drive."""

from __future__ import annotations

from typing import ClassVar

from pdgw.dsp402.states import ControlBit, State, StatusBit
from pdgw.peers.drive.model.image import DriveImage


class ModeOfOperation:
    """A mode of one drive."""

    even: ClassVar[bool] = False
    """Whether only the position changes at constant speed."""
    makes_torque: ClassVar[bool] = False
    """Whether the mode sets the torque itself."""
    synchronous: ClassVar[bool] = False
    """Whether the mode needs a setpoint with each SYNC."""
    halts: ClassVar[bool] = True
    """Whether Halt acts in the mode."""

    def __init__(self, drive: DriveImage) -> None:
        self.drive = drive

    @property
    def slow_down_rate(self) -> float:
        """Deceleration of the slow down ramp in rpm/s."""
        return self.drive.slow_down_rate

    def selected(self) -> None:
        """The mode is selected (6061h): discard all earlier data."""
        self.enabled()

    def enabled(self) -> None:
        """Operation starts."""

    def disabled(self) -> None:
        """Operation has ended."""

    def command(self, word: int, previous: int) -> None:
        """Process a Controlword in operation."""

    def received(self) -> None:
        """Process setpoints in the image, which may be new."""

    def move(self) -> None:
        """Simulate one tick in operation."""
        raise NotImplementedError

    def bits(self, halted: bool, units: int) -> int:
        """The mode's bits of the Statusword. ``halted``: Halt in operation. ``units``: actual velocity, 0 when Halt has ended."""
        return StatusBit.TARGET_REACHED if halted and units == 0 else 0

    def condition(self) -> tuple[object, ...]:
        """Everything that a tick can change in the mode."""
        return ()

    def _rises(self, word: int, previous: int) -> bool:
        return bool(word & ControlBit.NEW_SETPOINT and not previous & ControlBit.NEW_SETPOINT)

    def _allowed(self, word: int, previous: int) -> bool:
        """Whether the setpoint is accepted: not if one Controlword resets Halt and sets bit 4."""
        return not (word | previous) & ControlBit.HALT


def follows(drive: DriveImage, halted: bool) -> int:
    """Bit 12 of the cyclic synchronous modes: the drive follows the setpoint."""
    operating = drive.state is State.OPERATION_ENABLED
    return StatusBit.MODE_12 if operating and not halted and not drive.limited else 0
