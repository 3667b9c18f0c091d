"""The basic positioner of telegrams 7, 110 and 111: which motion is wished, from what is asked and what the axis does.

Source: basic positioners of public drive manuals (docs/motion.md). Sans-I/O: one ``step`` per cycle, values and monotonic
nanoseconds in, one reused ``Outcome`` out. The states and what leads to the next are ``states.TRANSITIONS``. Left out: modulo
axes, cams, homing direction, the handshake with the drive and changes of its mode, which executors own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from pdgw.gateway.motion.blocks import BlockTable
from pdgw.gateway.motion.chain import BlockChain
from pdgw.gateway.motion.course import MS, Course
from pdgw.gateway.motion.states import TASK_STATES, TRANSITIONS, Action, Event, State, Transition
from pdgw.gateway.motion.wishes import FULL, Asked, HomingResult, MotionKind, Outcome, PositionerSettings, Seen
from pdgw.gateway.reasons import Reason

SHOWN_NS = 100 * MS
"""POS_ZSW1.11 shows homing and a set reference point at least so long, because masters poll it."""
_BOTH = (True, True)
_KEPT = frozenset({State.MDI, State.SETTING_UP, State.BLOCK})
"""Functions an intermediate stop keeps, and an edge during it replaces."""
_DISTURBANCES = frozenset(
    {Event.NOT_OPERATING, Event.REJECTED, Event.TASK_REFUSED, Event.MDI, Event.SETTING_UP, Event.BLOCK}
)
"""What cannot be there in a calm step: in operation, not rejected, without the edge of a task."""
_Row = tuple[Callable[[], bool], Callable[[], None], State]
_FUNCTION = {Event.MDI: State.MDI, Event.SETTING_UP: State.SETTING_UP, Event.BLOCK: State.BLOCK}


@dataclass(slots=True, unsafe_hash=True)
class _Task:
    """The data of the frame that brought an edge of STW1.6, or a change under continuous update. Never changed."""

    event: Event
    refusal: Reason | None
    block: int
    absolute: bool
    values: tuple[int, int, int, int, bool, bool]
    """Target, velocity, acceleration, deceleration, positive and negative direction."""


def _values(asked: Asked) -> tuple[int, int, int, int, bool, bool]:
    return asked.target, asked.velocity, asked.acceleration, asked.deceleration, asked.positive, asked.negative


class Positioner:
    """One axis' positioner."""

    def __init__(self, settings: PositionerSettings, blocks: BlockTable | None = None) -> None:
        self.settings = settings
        self.home_set = False
        self.outcome = Outcome()
        self._state = State.OFF
        self._course = Course(settings, self.outcome)
        self._chain = BlockChain(blocks or BlockTable(), self._course)
        self._asked = Asked()
        self._seen = Seen()
        self._now = 0
        self._pending: _Task | None = None
        self._task: _Task | None = None
        self._owed = False
        """STW1.6 has stood since the edge of the task: it is to be acknowledged."""
        self._armed = (False, False)
        self._jog = 0
        self._homing_until = 0
        self._probing = self._probe_wanted = False
        self._limits = False
        self._levels = (False, False, False, False)
        self._activated = self._external_edge = self._reference_edge = self._homing_edge = False
        events: dict[Event, Callable[[], bool]] = {
            Event.NOT_OPERATING: lambda: not self._asked.operating,
            Event.OPERATING: lambda: self._asked.operating,
            Event.REJECTED: lambda: not self._asked.do_not_reject,
            Event.TASK_REFUSED: lambda: self._pending is not None and self._pending.refusal is not None,
            Event.MDI: lambda: self._pending is not None and self._pending.event is Event.MDI,
            Event.SETTING_UP: lambda: self._pending is not None and self._pending.event is Event.SETTING_UP,
            Event.BLOCK: lambda: self._pending is not None and self._pending.event is Event.BLOCK,
            Event.CHANGED: self._changed,
            Event.REACHED: self._finished,
            Event.BLOCK_DONE: lambda: self._chain.done(self._seen, self._now) and self._chain.follower() is not None,
            Event.CHAIN_DONE: lambda: self._chain.done(self._seen, self._now) and self._chain.follower() is None,
            Event.JOG: lambda: not self._asked.jog_incremental and self._jog_asked(),
            Event.JOG_INCREMENTAL: lambda: self._asked.jog_incremental and self._jog_asked(),
            Event.JOG_RELEASED: lambda: self._jog_bit() != self._jog,
            Event.HOMING: lambda: self._homing_edge and not self._asked.passive_homing,
            Event.HOMING_WITHDRAWN: lambda: not self._asked.homing,
            Event.HOMING_ATTAINED: lambda: self._homing_is(HomingResult.ATTAINED),
            Event.HOMING_FAILED: lambda: self._homing_is(HomingResult.FAILED),
            Event.TRACKING: lambda: self._asked.tracking,
            Event.TRACKING_OFF: lambda: not self._asked.tracking,
            Event.STANDING: lambda: self._seen.standstill,
        }
        actions: dict[Action, Callable[[], None]] = {
            Action.NOTHING: lambda: None,
            Action.DROP: self._drop,
            Action.CLEAR: lambda: self._warn(None),
            Action.BRAKE: self._brake,
            Action.REFUSE: self._refuse,
            Action.REFUSE_AND_BRAKE: self._refuse_and_brake,
            Action.START: self._start,
            Action.REPLACE: self._start,
            Action.UPDATE: self._update,
            Action.FOLLOW: lambda: self._chain.follow(self._now),
            Action.FINISH: self._forget,
            Action.JOG: self._start_jog,
            Action.JOG_DISTANCE: self._start_jog,
            Action.HOME: self._start_homing,
            Action.HOMED: self._homed,
            Action.HOMING_ERROR: self._homing_error,
        }

        def compiled(rows: Iterable[Transition]) -> tuple[_Row, ...]:
            return tuple((events[row.event], actions[row.action], row.target) for row in rows)

        self._table = {
            state: (compiled(rows), compiled(row for row in rows if row.event not in _DISTURBANCES))
            for state, rows in TRANSITIONS.items()
        }
        """``TRANSITIONS`` with what finds an event and what does an action: all rows of a state, and those of a calm step."""
        self._rows, self._calm_rows = self._table[self._state]

    def set_position_range(self, low: int, high: int) -> None:
        """Where the drive can be sent, in its own coordinates."""
        self.settings = self._course.settings = replace(self.settings, position_range=(low, high))

    def choose(self, settings: PositionerSettings, blocks: BlockTable) -> None:
        """Other values of the user, out of operation."""
        self.settings = self._course.settings = replace(settings, position_range=self.settings.position_range)
        self._chain.blocks = blocks

    def drive_restarted(self) -> None:
        """The drive's coordinates are new: the home position is lost."""
        self.home_set = False
        self._course.offset = 0

    def step(self, asked: Asked, seen: Seen, now: int) -> Outcome:
        """One cycle. Nothing of ``asked`` and ``seen`` is kept."""
        self._asked, self._seen, self._now = asked, seen, now
        self._look()
        calm = asked.operating and asked.do_not_reject and self._pending is None
        for happened, act, target in self._calm_rows if calm else self._rows:
            if happened():
                act()
                if target is not self._state:
                    self._state = target
                    self._rows, self._calm_rows = self._table[target]
                break
        self._chain.look_ahead()
        if self._state is not State.HOMING:
            self._course.follow(asked, now)
        self._show()
        return self.outcome

    # -- what came in ---------------------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Edges, limits and probes, before the table is asked."""
        asked = self._asked
        self._edges()
        self._show_acknowledge()
        if asked.jog_1 or asked.jog_2:
            allowed = asked.operating and asked.do_not_reject and not (asked.jog_1 and asked.jog_2)
            first, second = self._armed
            self._armed = (not asked.jog_1 or (first and allowed), not asked.jog_2 or (second and allowed))
        else:
            self._armed = _BOTH
        if not asked.do_not_reject:
            self._pending = None
        self._limits = asked.software_limits and self.home_set and self.settings.software_limits is not None
        self._course.look(self._seen, self._limits)
        if self._state is State.OFF:
            return
        if self._activated and asked.do_not_reject:
            if self._state not in TASK_STATES:
                self._warn(Reason.FUNCTION_RUNS)
            elif asked.no_intermediate_stop or self._state in _KEPT:
                self._pending = self._captured()
        if self._external_edge:
            self._chain.external = True
        if self._reference_edge:
            self._set_reference_point()
        if asked.homing or self._probe_wanted:
            self._home_on_the_fly()

    def _edges(self) -> None:
        """Rising edges of this step; bits that stood before operation are none."""
        asked = self._asked
        before = self._levels
        levels = (asked.activate, asked.external_block_change, asked.set_reference_point, asked.homing)
        if levels == before:
            if self._activated or self._external_edge or self._reference_edge or self._homing_edge:
                self._activated = self._external_edge = self._reference_edge = self._homing_edge = False
            return
        self._levels = levels
        self._activated, self._external_edge, self._reference_edge, self._homing_edge = (
            is_set and not was_set for is_set, was_set in zip(levels, before, strict=True)
        )

    def _captured(self) -> _Task:
        asked = self._asked
        refusal: Reason | None = None
        if not asked.mdi:
            event = Event.BLOCK
            refusal = self._chain.refusal(asked.block)
        elif asked.setting_up:
            event = Event.SETTING_UP
            refusal = Reason.TASK_DIRECTION if asked.positive == asked.negative else None
        else:
            event = Event.MDI
            reachable = self._course.in_range(asked.target, asked.absolute)
            refusal = None if reachable else Reason.TASK_TARGET_RANGE
        if asked.mdi and not asked.velocity:
            refusal = Reason.TASK_SPEED_ZERO
        return _Task(event, refusal, asked.block, asked.absolute, _values(asked))

    def _changed(self) -> bool:
        """Continuous update: other values than those in force, while STW1.6 stands."""
        asked, task = self._asked, self._task
        if not (asked.continuous_update and asked.activate and asked.mdi and task is not None):
            return False
        if asked.setting_up is not (self._state is State.SETTING_UP) or _values(asked) == task.values:
            return False
        if self._state is State.MDI and not (asked.absolute and task.absolute):
            self._warn(Reason.UPDATE_RELATIVE)
            return False
        return True

    def _jog_bit(self) -> int:
        """1 or 2 for the jog bit that stands alone, 0 for none or both."""
        asked = self._asked
        return 0 if asked.jog_1 is asked.jog_2 else 1 if asked.jog_1 else 2

    def _jog_asked(self) -> bool:
        bit = self._jog_bit()
        return bit > 0 and self._armed[bit - 1]

    def _homing_is(self, result: HomingResult) -> bool:
        return self._seen.taken >= self.outcome.motion.serial and self._seen.homing is result

    def _finished(self) -> bool:
        if self._state is State.MDI and self._asked.continuous_update and self._asked.activate:
            return False
        return self._course.arrived() or (self._course.goal is None and self._seen.standstill)

    # -- functions ------------------------------------------------------------------------------------------------------

    def _warn(self, reason: Reason | None) -> None:
        self.outcome.warning = reason

    def _forget(self) -> None:
        self._pending = self._task = None
        self._jog = 0
        self._course.drop()
        self._chain.drop()

    def _begin(self) -> None:
        """A function other than a task begins."""
        self._forget()
        self._warn(None)
        self.outcome.shown = State.IDLE

    def _drop(self) -> None:
        self._forget()
        self._probing = False
        self.outcome.acknowledged = False
        self.outcome.shown = State.OFF
        self.outcome.outputs = 0

    def _brake(self) -> None:
        self._forget()
        if not self._asked.do_not_reject:
            self._warn(None)
        self.outcome.shown = State.IDLE

    def _refuse(self) -> None:
        pending, self._pending = self._pending, None
        self._warn((pending and pending.refusal) or Reason.FUNCTION_RUNS)

    def _refuse_and_brake(self) -> None:
        self._refuse()
        self._brake()

    def _start(self) -> None:
        task = self._pending
        assert task is not None, "the rows with a start follow an edge"
        self._forget()
        self._warn(None)
        self._task = task
        self._owed = True
        self.outcome.shown = _FUNCTION[task.event]
        if task.event is Event.BLOCK:
            self._chain.run(task.block, self._now)
        else:
            self._pursue(task)

    def _update(self) -> None:
        task = self._task = self._captured()
        self._warn(task.refusal)
        if task.refusal is None:
            self._pursue(task)
        else:
            self._course.stand()

    def _pursue(self, task: _Task) -> None:
        target, velocity, acceleration, deceleration, positive, _negative = task.values
        if task.event is Event.SETTING_UP:
            self._course.go(velocity if positive else -velocity, acceleration, deceleration)
        else:
            torque = self.settings.clamping_torque if self._asked.to_fixed_stop else None
            self._course.go_to(target, task.absolute, velocity, acceleration, deceleration, torque)

    def _start_jog(self) -> None:
        self._begin()
        self._jog = self._jog_bit()
        place = self._jog - 1
        velocity = self.settings.jog_velocities[place]
        if self._asked.jog_incremental:
            self._armed = (self._armed[0] and place != 0, self._armed[1] and place != 1)
            distance = self.settings.jog_distances[place]
            self._course.go_to(distance if velocity > 0 else -distance, False, abs(velocity), FULL, FULL)
        else:
            self._course.go(velocity, FULL, FULL, scaled=False)

    # -- homing and the reference point ---------------------------------------------------------------------------------

    def _start_homing(self) -> None:
        self._begin()
        self.home_set = False
        self._homing_until = self._now + SHOWN_NS
        motion = self.outcome.motion
        motion.kind = MotionKind.HOMING
        motion.torque = None
        motion.serial += 1

    def _homed(self) -> None:
        """The drive's position counts from the home position, which is the reference coordinate."""
        self._course.offset = self.settings.reference_coordinate
        self.home_set = True

    def _homing_error(self) -> None:
        self._warn(Reason.HOMING_ERROR)

    def _set_reference_point(self) -> None:
        if self._state in {State.IDLE, State.TRACKING} and self._seen.standstill:
            self._refer(self._seen.position)
        else:
            self._warn(Reason.REFERENCE_POINT_MOVING)

    def _refer(self, position: int) -> None:
        self._course.offset = self.settings.reference_coordinate - position
        self.home_set = True
        self._homing_until = self._now + SHOWN_NS

    def _home_on_the_fly(self) -> None:
        """STW1.11 with POS_STW2.8: the probe gives the offset while anything runs; a task keeps its target in the drive."""
        asked, seen = self._asked, self._seen
        wanted = asked.homing and asked.passive_homing
        before, self._probe_wanted = self._probe_wanted, wanted
        if not wanted:
            self._probing = False
        elif not before:
            self._probing = self.settings.probe
            if not self.settings.probe:
                self._warn(Reason.PASSIVE_HOMING_NOT_SUPPORTED)
        elif self._probing and seen.probe_refused:
            self._probing = False
            self._warn(Reason.PASSIVE_HOMING_NOT_SUPPORTED)
        elif self._probing and seen.probe is not None:
            self._probing = False
            self._refer(seen.probe)

    # -- what goes out --------------------------------------------------------------------------------------------------

    def _show(self) -> None:
        outcome, asked, seen, state = self.outcome, self._asked, self._seen, self._state
        outcome.state = state
        position = outcome.position = seen.position + self._course.offset
        outcome.home_set = self.home_set
        outcome.standing = seen.standstill
        if state is State.IDLE or state is State.TRACKING:
            if not asked.activate or outcome.shown is State.OFF:
                outcome.shown = State.IDLE
            outcome.reached = seen.standstill
        else:
            outcome.reached = state is State.MDI and self._course.arrived()
        block = self._chain.block
        outcome.block = block.number if block is not None else 0
        outcome.homing = state is State.HOMING or self._now < self._homing_until
        outcome.passive_homing = outcome.probe = self._probing
        outcome.negative_limit = asked.hardware_limits and seen.negative_limit
        outcome.positive_limit = asked.hardware_limits and seen.positive_limit
        outcome.at_minus = outcome.at_plus = False
        limits = self.settings.software_limits
        if self._limits and limits is not None and seen.standstill:
            outcome.at_minus = position <= limits[0] + self.settings.position_window
            outcome.at_plus = position >= limits[1] - self.settings.position_window
        outcome.reason = self._course.held or (None if asked.do_not_reject else Reason.REJECTED) or outcome.warning

    def _show_acknowledge(self) -> None:
        outcome, task, first = self.outcome, self._task, self._course.first_serial
        if not self._asked.activate:
            outcome.acknowledged = self._owed = False
        elif self._owed and task is not None:
            # A position task is the drive's to acknowledge, anything else the gateway's.
            block = self._chain.block
            still = task.event is Event.BLOCK and block is not None and not block.task.moves
            speed = self._course.speed is not None
            outcome.acknowledged = outcome.acknowledged or still or speed or 0 < first <= self._seen.taken
