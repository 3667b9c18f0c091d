"""Axes of telegrams 9 and 111 with a drive that answers when the test says so: what a task and a homing are in each."""

from __future__ import annotations

from collections.abc import Callable

from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, State, StatusBit
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.peers.drive.objects import TURNTABLE
from pdgw.profidrive.datatypes import n4
from pdgw.profidrive.signals import signal
from tests.support.axis.hand import ON, OPERATING, Hand
from tests.support.axis.positioner import CHOICES
from tests.support.drives.drive_types import References, engel

OFF2, OFF3 = ON & ~2, ON & ~4
REJECT, INTERMEDIATE, ACTIVATE, JOG, HOMING = 0x10, 0x20, 0x40, 0x100, 0x800
HALT, NEW_SETPOINT, RELATIVE = ControlBit.HALT, ControlBit.NEW_SETPOINT, ControlBit.RELATIVE
OF_THE_MODE = HALT | NEW_SETPOINT | RELATIVE | ControlBit.CHANGE_IMMEDIATELY
TAKEN = StatusBit.MODE_12
ZSW1 = signal("ZSW1")
HOME_SET = ZSW1.bit("HOME_POSITION_SET", positioning=True).mask
REACHED = ZSW1.bit("TARGET_REACHED", positioning=True).mask
ACKNOWLEDGED = ZSW1.bit("TASK_ACKNOWLEDGE", positioning=True).mask
WARNING = ZSW1.bit("WARNING").mask
MDI_ABSOLUTE, MDI_RELATIVE, SETTING_UP = 0x8100, 0x8000, 0xC200
POSITION = n4(500_000, (-(1 << 31), (1 << 31) - 1))
DRIVE = engel(References(position_min=-2_000_000, position_max=2_000_000, max_acceleration=2000, max_deceleration=2000))
FAST = 3000
"""Actual speed of an axis that turns."""


class TaskHand(Hand):
    """The words of a task and of a homing are those of the telegram. Targets are in units of the drive."""

    @property
    def _is_9(self) -> bool:
        return self.stepper.telegram.number == 9

    def task(self, target: int, status: State | int = OPERATING, *, relative: bool = False, **values: int) -> int:
        """A cycle with STW1.6 and a target; the Controlword. The task stays relative until ``values`` say otherwise."""
        if relative:
            self.values |= {"MDI_MOD": 0} if self._is_9 else {"POS_STW1": MDI_RELATIVE}
        length = CHOICES.lu_per_revolution * target // 4096
        return self(ON | ACTIVATE, status, MDI_TARPOS=POSITION.to_wire(target) if self._is_9 else length, **values)

    def begin_homing(self) -> None:
        """The drive has taken the parameters of the homing and shows its mode."""
        self(ON | HOMING)
        self.stepper.sdo_done(None)
        self(ON | HOMING)
        self.mode = Mode.HOMING


def positioning(**settings: object) -> TaskHand:
    """Telegram 9, before the first frame; the task is absolute and leaves the window, homing is method 35."""
    mode = TURNTABLE.mode if settings.get("modulo_axis") else Mode.POSITION
    values = {"SATZANW": 0x8000 | 35, "MDI_TARPOS": 1 << 28, "MDI_MOD": 1}
    values |= {"MDI_VELOCITY": 1 << 29, "MDI_ACC": 1 << 14, "MDI_DEC": 1 << 14}
    return TaskHand(9, engel(), mode, values, **settings)


def positioner(choices: PositionerChoices = CHOICES, drive: DriveType = DRIVE, **settings: object) -> TaskHand:
    """Telegram 111, likewise."""
    values = {"POS_STW1": MDI_ABSOLUTE, "MDI_TARPOS": 10_000, "OVERRIDE": 0x4000}
    values |= {"MDI_VELOCITY": 3000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
    return TaskHand(111, drive, Mode.POSITION, values, positioner=choices, **settings)


Make = Callable[..., TaskHand]
MAKES: dict[str, Make] = {"9": positioning, "111": positioner}
