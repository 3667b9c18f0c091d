"""Inputs and outputs of the positioner, as values.

Positions are LU, speeds 1000 LU/min, accelerations and the override N2 fractions (4000h = 100 %). ``PositionerRequest`` has
the user's coordinates; ``PositionerFeedback`` and ``Motion`` have those of the drive, which differ by the offset of the
reference point.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Final, NamedTuple

from pdgw.gateway.motion.blocks import Block
from pdgw.gateway.motion.modulo import Direction
from pdgw.profidrive.datatypes import N2_100_PERCENT

FULL = N2_100_PERCENT
"""100 % of an N2 fraction."""


class Command(enum.IntEnum):
    """Commands of the PLC to a positioner, one bit each. They have the names of the bits in the control words."""

    DO_NOT_REJECT = 1 << 0
    NO_INTERMEDIATE_STOP = 1 << 1
    ACTIVATE_TASK = 1 << 2
    JOG_1_ON = 1 << 3
    JOG_2_ON = 1 << 4
    START_HOMING = 1 << 5
    EXTERNAL_BLOCK_CHANGE = 1 << 6
    TRACKING = 1 << 7
    SET_REFERENCE_POINT = 1 << 8
    JOG_INCREMENTAL = 1 << 9
    PASSIVE_HOMING = 1 << 10
    PROBE_2 = 1 << 11
    """Passive homing at probe 2 instead of 1,"""
    PROBE_FALLING_EDGE = 1 << 12
    """and at its falling edge."""
    SOFTWARE_LIMITS = 1 << 13
    HARDWARE_LIMITS = 1 << 14
    ABSOLUTE = 1 << 15
    POSITIVE_DIRECTION = 1 << 16
    NEGATIVE_DIRECTION = 1 << 17
    CONTINUOUS_UPDATE = 1 << 18
    SETTING_UP = 1 << 19
    MDI = 1 << 20


DIRECTIONS: Final = Command.POSITIVE_DIRECTION | Command.NEGATIVE_DIRECTION
_DIRECTION: Final[dict[int, Direction]] = {
    Command.POSITIVE_DIRECTION: Direction.POSITIVE,
    Command.NEGATIVE_DIRECTION: Direction.NEGATIVE,
}


@dataclass(slots=True, unsafe_hash=True)
class PositionerRequest:
    """What the PLC requests. Replaced, never changed."""

    commands: int = 0
    """Bits of ``Command``."""
    number: int = 0
    """Of the traversing block; in telegram 9, whose positions, speeds and ramps are fractions of references (4000 0000h =
    100 %), the homing method."""
    to_fixed_stop: bool = False
    override: int = FULL
    """0..7FFFh; what the PLC sends below 0 is 0."""
    target: int = 0
    velocity: int = 0
    acceleration: int = FULL
    deceleration: int = FULL
    reference_coordinate: int | None = None
    """Position of the reference point; None: the configured one."""

    @property
    def direction(self) -> Direction:
        """The requested direction; SHORTEST with none of its bits, and with both."""
        return _DIRECTION.get(self.commands & DIRECTIONS, Direction.SHORTEST)


NOTHING: Final = PositionerRequest()
"""No commands."""


class Lack(NamedTuple):
    """Why the edge of a bit started nothing."""

    text: str
    zeros: tuple[str, ...] = ()
    """Bits that were 0."""
    holding: str = ""
    """The bit that keeps another function active."""


class HomingResult(enum.Enum):
    """Progress of a homing. That of ``PositionerFeedback`` is of the homing in ``taken``, which has started."""

    RUNNING = "running"
    READY = "ready to start"
    ATTAINED = "attained"
    FAILED = "failed"


class Seen:
    """What an axis shows in a step, one bit each."""

    OPERATING: Final = 1 << 0
    """Operation is enabled, and a PLC in control requests it."""
    STANDSTILL: Final = 1 << 1
    """And the position is one of this standstill, also where it is read by SDO."""
    STOPPED: Final = 1 << 2
    """The axis is at standstill, the drive has ended its ramp, and no setpoint is on its way that may still start."""
    REACHED: Final = 1 << 3
    """The drive reports its target reached, for the motion it executes."""
    ANSWERED: Final = 1 << 4
    """It does so in answer to the setpoint: not since before it."""
    INTERNAL_LIMIT: Final = 1 << 5
    NEGATIVE_LIMIT: Final = 1 << 6
    POSITIVE_LIMIT: Final = 1 << 7
    TORQUE_AT_LIMIT: Final = 1 << 8
    ASKED: Final = 1 << 9
    """Out of operation: the request is that of a PLC in control."""
    TURNS: Final = 1 << 10
    """The axis is not at standstill; without it and ``STANDSTILL``, a speed by SDO does not show which."""


@dataclass(slots=True, eq=False)
class PositionerFeedback:
    """State of the axis. A motion is *given* when its setpoint was sent to the drive, *taken* when the drive acknowledged it, and
    *executing* when the drive works on it (later, if setpoints wait in the drive). Each is the newest serial number; the first
    motion has 2.
    """

    bits: int = 0
    """Bits of ``Seen``."""
    position: int = 0
    given: int = 1
    taken: int = 1
    executing: int = 1
    homing: HomingResult = HomingResult.RUNNING


class MotionKind(enum.Enum):
    """Tasks of an executor."""

    STAND = "stand"
    """Ramp to standstill and stay there; a setpoint that was not sent is cancelled."""
    POSITION = "position"
    SPEED = "speed"
    HOMING = "homing"


@dataclass(slots=True, unsafe_hash=True)
class Goal:
    """A motion task; it survives intermediate stops. Replaced, never changed.

    With continuous update there is one in each cycle: creating a frozen class would take three times as long.
    """

    kind: MotionKind
    target: int
    distance: int | None
    """Relative, as long as no setpoint of it was given to the drive."""
    velocity: int
    """Signed for SPEED."""
    acceleration: int
    deceleration: int
    scaled: bool = True
    """The override scales the speed."""
    torque: int | None = None
    direction: Direction = Direction.SHORTEST
    """For a drive that finds the way of a modulo axis itself."""
    relative: bool = False
    """The task is relative, also when no distance is left to give to the drive."""


_NO_GOAL: Final = Goal(MotionKind.STAND, 0, None, 0, 0, 0)


@dataclass(slots=True, eq=False)
class Motion:
    """The requested motion. A new ``serial`` is a new setpoint; each is sent once, and only the newest waits."""

    kind: MotionKind = MotionKind.STAND
    serial: int = 1
    first: int = 0
    """Serial of the first setpoint of the task; 0 until it is sent."""
    goal: Goal = _NO_GOAL
    """The task as it was when the setpoint was sent."""
    override: int = FULL
    torque: int | None = None
    """Torque limit in 1/1000 of the rated torque, None for the axis' own."""

    def forget(self) -> None:
        """Clear the data of a motion that is over. Its torque limit is cleared when the axis starts to brake."""
        self.first, self.goal = 0, _NO_GOAL
        self.override = FULL


@dataclass(frozen=True, slots=True)
class PositionerChoices:
    """The user's choices for a positioner (docs/motion.md): LU, 1000 LU/min, 1000 LU/s2."""

    lu_per_revolution: int
    max_velocity: int
    max_acceleration: int
    max_deceleration: int
    position_window: int
    jog_velocities: tuple[int, int] = (-300, 300)
    """Signed, of jog 1 and jog 2: which of the two is forward differs between vendors."""
    jog_distances: tuple[int, int] = (0, 0)
    software_limits: tuple[int, int] | None = None
    reference_coordinate: int = 0
    homing_method: int | None = None
    """6098h; None: no homing."""
    waiting_setpoints: bool = True
    """The drive keeps a setpoint for after the one that runs (set of setpoints)."""
    blocks: tuple[Block, ...] = ()
    clamping_torque: int | None = None
    """Torque of a task with STW2.8, in 1/1000 of the rated torque; None: only blocks move to a fixed stop."""
    modulo: int = 0
    """LU after which positions wrap; 0: not a modulo axis."""
    lu_per_unit: int = 0
    """LU in one unit of length of telegram 112; 0: the axis cannot have it."""
    units_per_second: bool = False
    """Velocities are per second, else per minute."""
