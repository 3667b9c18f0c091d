"""A positioner with an ideal executor and a simple axis: what is given, taken and executed, with ramps, in LU and cycles."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.basic_positioner import BasicPositioner
from pdgw.gateway.motion.blocks import OUTPUTS_MASK, Block, BlockMode, BlockNext
from pdgw.gateway.motion.requests import (
    FULL,
    Command,
    HomingResult,
    Motion,
    MotionKind,
    PositionerChoices,
    PositionerFeedback,
    PositionerRequest,
    Seen,
)
from pdgw.profidrive.signals import signal

CYCLE = 4_000_000
ABSOLUTE = {"mdi": True, "absolute": True, "velocity": 3000}
RELATIVE = {"mdi": True, "absolute": False, "velocity": 3000}
"""Tasks."""
RAMP = 20
"""LU per cycle and cycle, speeding up and slowing down."""
SETTINGS = PositionerChoices(
    lu_per_revolution=10_000,
    max_velocity=30_000,
    max_acceleration=2000,
    max_deceleration=2000,
    position_window=5,
    jog_velocities=(-3000, 3000),
    jog_distances=(500, 2000),
    software_limits=(-50_000, 50_000),
    reference_coordinate=0,
    clamping_torque=300,
)


CHOICES = PositionerChoices(
    lu_per_revolution=10_000,
    lu_per_unit=1000,
    max_velocity=30_000,
    max_acceleration=2000,
    max_deceleration=2000,
    position_window=20,
    jog_distances=(2500, 5000),
    software_limits=(-1_000_000, 1_000_000),
    homing_method=35,
    blocks=(
        Block(1, 10_000, 6000, next=BlockNext.FLYING),
        Block(2, 5000, 3000, mode=BlockMode.RELATIVE),
        Block(5, 50_000, 12_000),
    ),
)
"""Of the worked examples: 10000 LU a revolution."""


class Result:
    """What a positioner shows after a step."""

    def __init__(self, positioner: BasicPositioner, reason: Reason | None) -> None:
        self.reason = reason
        self.state, self.warning, self.motion = positioner.state, positioner.course.warning, positioner.course.motion
        self.position, self.home_set, self.shown = positioner.position, positioner.home_set, positioner._shown
        self.reached, self.acknowledged = positioner.reached, positioner.acknowledged
        first, second = positioner.words(0, reached=self.reached)
        names = {bit.name for bit in signal("POS_ZSW1").bits if first & bit.mask}
        names |= {bit.name for bit in signal("POS_ZSW2").bits if second & bit.mask}
        self.block = signal("POS_ZSW1").bit("BLOCK").of(first)
        self.outputs = second >> signal("POS_ZSW2").bit("OUTPUT_1").position & OUTPUTS_MASK
        self.homing, self.probe = "HOMING" in names, "PASSIVE_HOMING" in names
        self.at_minus, self.at_plus = "SOFTWARE_LIMIT_MINUS" in names, "SOFTWARE_LIMIT_PLUS" in names
        self.negative_limit, self.positive_limit = (
            "NEGATIVE_HARDWARE_LIMIT" in names,
            "POSITIVE_HARDWARE_LIMIT" in names,
        )
        self.to_fixed_stop, self.fixed_stop = "TO_FIXED_STOP" in names, "FIXED_STOP_REACHED" in names


@dataclass
class PositionerRig:
    """``request`` is changed by the test, ``step`` runs cycles. ``delay``: cycles from a setpoint to the drive's acknowledge."""

    settings: PositionerChoices = SETTINGS
    blocks: tuple[Block, ...] = ()
    delay: int = 1
    request: PositionerRequest = field(
        default_factory=lambda: PositionerRequest(Command.DO_NOT_REJECT | Command.NO_INTERMEDIATE_STOP)
    )
    stop_at: int | None = None
    """A mechanical stop."""

    def __post_init__(self) -> None:
        self.positioner = BasicPositioner(replace(self.settings, blocks=self.blocks))
        self.show(Seen.OPERATING | Seen.STANDSTILL | Seen.STOPPED, True)
        self.positioner.travel.positions = (-(1 << 30), 1 << 30)
        self.now = 0
        self.speed = 0
        self.running = Motion()
        self.waiting: Motion | None = None
        self._arriving: tuple[int, Motion] | None = None
        self.starts: list[Motion] = []
        """Every setpoint accepted by the drive."""
        self.queued: set[int] = set()
        """Serials of those that wait in the drive for the end of the one that runs."""
        self.step()

    @property
    def seen(self) -> PositionerFeedback:
        return self.positioner.seen

    def show(self, bit: int, shows: object) -> None:
        """What the axis shows from now on."""
        self.seen.bits = self.seen.bits | bit if shows else self.seen.bits & ~bit

    @property
    def position(self) -> int:
        return self.result.position

    def step(self, cycles: int = 1, **changes: object) -> Result:
        """Change what is asked, then run cycles."""
        self.show(Seen.OPERATING, changes.pop("operating", self.seen.bits & Seen.OPERATING))
        self.request = changed(self.request, **changes)
        for _ in range(cycles):
            self.now += CYCLE
            self.result = Result(self.positioner, self.positioner.step(self.request, self.now))
            self._execute(self.result.motion)
            self._move(self.result.motion)
        return self.result

    def run_out(self, cycles: int = 4000) -> Result:
        """Run until the axis was at standstill for some cycles."""
        still = 0
        for _ in range(cycles):
            self.step()
            still = still + 1 if not self.speed else 0
            if still > 8 + self.delay:
                return self.result
        raise AssertionError(f"does not come to rest: {self.result}")

    def home(self) -> None:
        """Set the reference point at the present position; from now on the software limits are active."""
        self.step(set_reference_point=True)
        self.step(30, set_reference_point=False, software_limits=True)
        assert self.result.home_set

    def _execute(self, wish: Motion) -> None:
        seen = self.seen
        if wish.kind is MotionKind.STAND:
            if self._arriving is not None and seen.given < self._arriving[1].serial:
                self._arriving = None
            self.waiting = None
            return
        if wish.serial > seen.given and (self._arriving is None or seen.given < self._arriving[1].serial):
            self._arriving = (self.delay, replace(wish))
            if wish.serial == self.positioner.travel.queued:
                self.queued.add(wish.serial)
        if self._arriving is None:
            return
        cycles, motion = self._arriving
        seen.given = motion.serial
        if cycles:
            self._arriving = (cycles - 1, motion)
            return
        self._arriving = None
        seen.taken = motion.serial
        self.starts.append(motion)
        if motion.serial in self.queued and not self._at_target():
            self.waiting = motion
            return
        self._begin(motion)

    def _begin(self, motion: Motion) -> None:
        goal = motion.goal
        if goal.distance is not None:
            motion.goal = replace(goal, target=self.seen.position + goal.distance)
        self.running, self.waiting = motion, None
        self.seen.executing = motion.serial
        self.show(Seen.REACHED, False)
        self.seen.homing = HomingResult.RUNNING

    def _at_target(self) -> bool:
        return self.running.kind is MotionKind.POSITION and self.seen.position == self.running.goal.target

    def _limit(self) -> int:
        """Speed of the running motion in LU per cycle."""
        motion = self.running
        override = motion.override if motion.serial == self.seen.taken else FULL
        return abs(motion.goal.velocity) * 1000 * override * (CYCLE // 1_000_000) // (FULL * 60_000)

    def _move(self, wish: Motion) -> None:
        seen, motion = self.seen, self.running
        wanted = 0
        if wish.kind is MotionKind.STAND or wish.kind is MotionKind.HOMING:
            wanted = 0
        elif motion.kind is MotionKind.SPEED:
            wanted = self._limit() * (1 if motion.goal.velocity > 0 else -1)
        elif motion.kind is MotionKind.POSITION:
            wanted = self._toward(motion.goal.target - seen.position)
        self.speed += max(-RAMP, min(wanted - self.speed, RAMP))
        if motion.kind is MotionKind.POSITION and wish.kind is MotionKind.POSITION:
            rest = motion.goal.target - seen.position
            if abs(rest) <= RAMP and abs(self.speed) <= 2 * RAMP:
                self.speed = rest
        if self.stop_at is not None and (seen.position + self.speed) > self.stop_at:
            self.speed = self.stop_at - seen.position
            self.show(Seen.TORQUE_AT_LIMIT, True)
        else:
            self.show(Seen.TORQUE_AT_LIMIT, False)
        seen.position += self.speed
        if self._at_target() and wish.kind is MotionKind.POSITION:
            self.speed = 0
            if self.waiting is not None:
                self._begin(self.waiting)
        self.show(Seen.STANDSTILL, not self.speed)
        self.show(Seen.TURNS, self.speed != 0)
        reached = not self.speed and (wish.kind is MotionKind.STAND or self._at_target())
        self.show(Seen.REACHED, reached)
        self.show(Seen.ANSWERED, reached)
        if wish.kind is MotionKind.HOMING and seen.taken == wish.serial and not self.speed:
            seen.homing = HomingResult.ATTAINED

    def _toward(self, distance: int) -> int:
        """The speed from which the ramp still ends at the target."""
        speed = 0
        while speed < self._limit() and (speed + RAMP) * (speed + 2 * RAMP) // (2 * RAMP) <= abs(distance):
            speed += RAMP
        speed = min(speed, self._limit(), abs(distance)) or min(abs(distance), self._limit(), RAMP)
        return speed if distance > 0 else -speed


def command(name: str) -> Command:
    """The first command with this in its name."""
    return next(item for item in Command if name.upper() in item.name)


def changed(request: PositionerRequest, **values: object) -> PositionerRequest:
    """The request with other values; a name that is no field of it is that of a command."""
    commands = request.commands
    names = {item.name for item in fields(request)}
    for name in values.keys() - names:
        bit = command(name)
        commands = commands | bit if values[name] else commands & ~bit
    found = {name: value for name, value in values.items() if name in names}
    return replace(request, commands=commands, **found)  # type: ignore[arg-type]


def move(rig: PositionerRig, **values: object) -> None:
    """The edge of STW1.6 with these values."""
    rig.step(activate=False)
    rig.step(activate=True, **values)
