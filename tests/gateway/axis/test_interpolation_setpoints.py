"""The setpoints of mode 8: commands of an executor for modes 1 and 3, and the position that each SYNC sends.

No simulated drive: it follows at once, so that every position is one of the profile. Each loop has an end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import pytest

from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback
from pdgw.dsp402.errors import Dsp402Error
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import STATUS_OF, ControlBit, State, StatusBit
from pdgw.gateway.axis.demand_report import Demand, Report
from pdgw.gateway.axis.executors.base import AxisRecords
from pdgw.gateway.axis.executors.positions.interpolation import Interpolation
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.power_states import Action
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.values import Inputs, Outputs
from pdgw.gateway.reasons import Reason
from tests.support.drives.drive_types import described

CYCLE_NS = 4_000_000
CYCLE = Fraction(CYCLE_NS, 10**9)
ON = 0x0F
SET_POINT = ON | ControlBit.NEW_SETPOINT | ControlBit.CHANGE_IMMEDIATELY
QUEUED = ON | ControlBit.NEW_SETPOINT
HALT = ON | ControlBit.HALT
OPERATES = STATUS_OF[State.OPERATION_ENABLED] | StatusBit.NO_QUICK_STOP
CSP = described("csp")
SPEED_RPM, FAST, SLOW = 1500, 8000, 2000
"""rpm, rpm/s."""


def counts(rpm: int, cycles: Fraction = CYCLE) -> Fraction:
    """Of a speed in one cycle."""
    assert CSP.scaling.counts_per_revolution is not None
    return CSP.scaling.counts_per_revolution * rpm / 60 * cycles


def ramp(rpm_s: int) -> Fraction:
    """Counts per cycle and cycle."""
    return counts(rpm_s, CYCLE * CYCLE)


def records_of(cycle_ns: int) -> AxisRecords:
    settings = AxisSettings(cycle_ns=cycle_ns)
    return AxisRecords(settings, Interlock(settings), Demand(), Inputs(DriveFeedback()), Report(), Outputs(0, None))


class Asks:
    """Asks for what the test has put into its command."""

    def __init__(self, command: DriveCommand) -> None:
        self.command = command

    def refuse(self) -> None:
        self.command.controlword = 0

    def step(self) -> Reason | None:
        return None


class Axis:
    """``wished`` is what an executor commands, ``seen`` what it sees; ``targets`` what the drive gets."""

    def __init__(self, position: int = 0, position_range: tuple[int, int] | None = None) -> None:
        self.records = records_of(CYCLE_NS)
        self.feedback, self.command = self.records.inputs.feedback, self.records.outputs.command
        self.interpolation = Interpolation(self.records)
        self.interpolation.set_drive(
            replace(CSP, scaling=replace(CSP.scaling, position_range=position_range)), modulo=False
        )
        self.wished, self.seen = self.interpolation.wished, self.interpolation.seen
        self.executor = Asks(self.wished)
        self.records.interlock.action = Action.ENABLE_OPERATION
        self.follows = True
        self.targets: list[int] = [position]
        self.feedback.position_actual = position
        self.feedback.modes_of_operation_display = Mode.CYCLIC_POSITION
        self.shows()
        self.ramps(FAST, SLOW)
        self.turns(0)
        self.wished.modes_of_operation = Mode.POSITION
        self.feedback.statusword = STATUS_OF[State.SWITCHED_ON]
        self.step()
        self.shows()

    def shows(self, bits: int = StatusBit.MODE_12) -> None:
        """Operation, with some bits."""
        self.feedback.statusword = OPERATES | bits

    def ramps(self, acceleration: int, deceleration: int) -> None:
        """In rpm/s."""
        unit = CSP.scaling.acceleration_per_rpm_s
        assert unit is not None
        self.wished.profile_acceleration = int(acceleration * unit)
        self.wished.profile_deceleration = int(deceleration * unit)

    def turns(self, rpm: int) -> None:
        """Profile velocity."""
        unit = CSP.scaling.velocity_per_rpm
        assert unit is not None
        self.wished.modes_of_operation = Mode.VELOCITY
        self.wished.target_velocity = int(rpm * unit)

    def travels(self, target: int, word: int = SET_POINT) -> None:
        """A setpoint of profile position with its handshake."""
        unit = CSP.scaling.velocity_per_rpm
        assert unit is not None
        self.wished.modes_of_operation = Mode.POSITION
        self.wished.target_position, self.wished.profile_velocity = target, int(SPEED_RPM * unit)
        self.step(2, word)
        assert self.seen.statusword & StatusBit.MODE_12, "acknowledged"
        self.step()

    def step(self, cycles: int = 1, word: int = ON) -> Reason | None:
        reason = None
        for _ in range(cycles):
            self.wished.controlword = word
            self.records.inputs.standstill = len(self.targets) > 1 and self.targets[-1] == self.targets[-2]
            reason = self.interpolation.step(self.executor)
            self.targets.append(self.command.target_position)
            if self.follows:
                self.feedback.position_actual = self.command.target_position
        return reason

    @property
    def ways(self) -> list[int]:
        return steps(self.targets)

    @property
    def is_reached(self) -> bool:
        return bool(self.seen.statusword & StatusBit.TARGET_REACHED)


def steps(values: Sequence[int]) -> list[int]:
    return [after - before for before, after in pairwise(values)]


def check_ramps(ways: Sequence[int], acceleration: int, deceleration: int) -> None:
    """Every change of the way of a cycle is one that was asked; rounding apart."""
    for before, after in pairwise(ways):
        asked = acceleration if abs(after) > abs(before) else deceleration
        assert abs(after - before) <= ramp(asked) + 2, (before, after)


def slowing_down(axis: Axis, word: int = ON) -> list[int]:
    """The ways from here to standstill."""
    began = len(axis.targets) - 2
    axis.step(2 + int(counts(SPEED_RPM) / ramp(1000)), word)
    ways = steps(axis.targets[began:])
    assert ways[-1] == 0, "standstill"
    return ways


def check_slows_down_with(ways: Sequence[int], deceleration: int) -> None:
    """A stop takes the ramp that was asked: not a harder one, and not a longer time."""
    check_ramps(ways, 0, deceleration)
    moving = sum(1 for way in ways[1:] if way)
    assert abs(moving - abs(ways[0]) / ramp(deceleration)) <= 2


def test_acceleration_and_deceleration_of_a_task_are_as_commanded() -> None:
    axis = Axis()
    axis.travels(90_000)
    axis.step(600)
    assert axis.targets[-1] == 90_000
    assert max(axis.targets) == 90_000, "not beyond"
    highest = max(axis.ways)
    assert abs(highest - counts(SPEED_RPM)) <= 1
    check_ramps(axis.ways, FAST, SLOW)
    top = axis.ways.index(highest)
    assert abs(sum(1 for way in axis.ways[:top] if way) - highest / ramp(FAST)) <= 2
    last = len(axis.ways) - 1 - axis.ways[::-1].index(highest)
    assert abs(sum(1 for way in axis.ways[last:] if way) - highest / ramp(SLOW)) <= 3


def test_halt_stops_a_task_on_its_ramp_without_an_automatic_resume() -> None:
    axis = Axis()
    axis.travels(90_000)
    axis.step(100)
    axis.ramps(SLOW, FAST)  # not those of a setpoint
    check_slows_down_with(slowing_down(axis, HALT), SLOW)
    stood = axis.targets[-1]
    axis.step(200)
    assert axis.targets[-1] == stood


def test_halt_stops_a_queued_task_on_that_tasks_ramp() -> None:
    axis = Axis()
    axis.ramps(FAST, FAST)
    axis.travels(5_000)
    axis.ramps(FAST, SLOW)
    axis.travels(90_000, QUEUED)
    axis.step(200)
    assert axis.targets[-1] > 6_000, "the queued one"
    check_slows_down_with(slowing_down(axis, HALT), SLOW)


def test_setpoint_with_the_falling_halt_is_not_accepted() -> None:
    axis = Axis()
    axis.wished.target_position = 50_000
    axis.step(5, HALT)
    axis.step(100, SET_POINT)
    assert set(axis.targets) == {0}
    assert not axis.seen.statusword & StatusBit.MODE_12


def test_halt_ramps_a_speed_down_and_its_end_resumes_it() -> None:
    axis = Axis()
    axis.turns(SPEED_RPM)
    axis.step(150)
    assert abs(axis.ways[-1] - counts(SPEED_RPM)) <= 1
    check_slows_down_with(slowing_down(axis, HALT), SLOW)
    axis.step(150)
    assert abs(axis.ways[-1] - counts(SPEED_RPM)) <= 1
    check_ramps(axis.ways, FAST, SLOW)


def test_speed_command_ends_a_task() -> None:
    axis = Axis()
    axis.travels(90_000)
    axis.step(60)
    axis.turns(0)
    slowing_down(axis)
    stood = axis.targets[-1]
    axis.wished.modes_of_operation = Mode.POSITION
    axis.step(100)
    assert axis.targets[-1] == stood


def test_a_speed_of_0_stops_on_the_ramp() -> None:
    axis = Axis()
    axis.turns(-SPEED_RPM)
    axis.step(150)
    axis.turns(0)
    check_slows_down_with(slowing_down(axis), SLOW)


@pytest.mark.parametrize("action", [Action.DISABLE_VOLTAGE, Action.QUICK_STOP])
@pytest.mark.parametrize("turning", [True, False])
def test_drive_in_operation_against_its_command_is_guided_to_standstill(action: Action, turning: bool) -> None:
    axis = Axis()
    if turning:
        axis.turns(SPEED_RPM)
    else:
        axis.travels(90_000)
    axis.step(100)
    axis.records.interlock.action = action
    check_slows_down_with(slowing_down(axis), SLOW)


@pytest.mark.parametrize(("rpm", "end"), [(SPEED_RPM, 59_999), (-SPEED_RPM, 0)])
def test_a_speed_ends_at_the_end_of_a_range_and_shows_the_limit(rpm: int, end: int) -> None:
    axis = Axis(30_000, (0, 59_999))
    axis.turns(rpm)
    axis.step(500)
    assert axis.targets[-1] == end
    assert min(axis.targets) >= 0
    assert max(axis.targets) <= 59_999
    assert axis.seen.statusword & StatusBit.INTERNAL_LIMIT
    check_ramps(axis.ways, FAST, SLOW)
    axis.turns(-rpm)
    axis.step(5)
    assert not axis.seen.statusword & StatusBit.INTERNAL_LIMIT
    assert axis.targets[-1] != end


def test_target_behind_the_braking_distance_is_passed_by_the_ramp_only() -> None:
    axis = Axis(30_000, (0, 59_999))
    axis.ramps(FAST, FAST)
    axis.turns(SPEED_RPM)
    for _ in range(200):
        axis.step()
        if axis.targets[-1] > 58_000:
            break
    began = len(axis.targets) - 1
    axis.ramps(FAST, SLOW)
    ways = slowing_down(axis)
    check_ramps(ways, 0, SLOW)
    assert axis.targets[-1] > 59_999, "from so near it has to pass"
    assert axis.targets[-1] - axis.targets[began] <= counts(SPEED_RPM) ** 2 / ramp(SLOW)


def test_a_task_beyond_the_range_ends_there_and_shows_the_limit_until_the_next() -> None:
    axis = Axis(30_000, (0, 59_999))
    axis.travels(70_000)
    axis.step(500)
    assert axis.targets[-1] == 59_999
    assert axis.seen.statusword & StatusBit.INTERNAL_LIMIT
    axis.travels(1_000)
    axis.step(500)
    assert axis.targets[-1] == 1_000
    assert not axis.seen.statusword & StatusBit.INTERNAL_LIMIT


def test_speed_towards_a_short_limit_signal_needs_a_new_speed() -> None:
    axis = Axis()
    axis.turns(SPEED_RPM)
    axis.step(60)
    axis.shows(StatusBit.INTERNAL_LIMIT)
    axis.step(3)
    axis.shows()
    axis.step(2)
    stood = axis.targets[-1]
    assert axis.step(200) is None
    assert axis.targets[-1] == stood
    assert axis.seen.statusword & StatusBit.INTERNAL_LIMIT
    axis.turns(-SPEED_RPM)
    axis.step(50)
    assert axis.targets[-1] < stood, "off the switch"
    axis.turns(0)
    axis.step(200)
    stood = axis.targets[-1]
    axis.turns(SPEED_RPM)
    axis.step(50)
    assert axis.targets[-1] > stood


def still_demanded(axis: Axis) -> None:
    axis.shows(0)  # the drive does not take it
    axis.travels(90_000)


def still_slowing_down(axis: Axis) -> None:
    axis.travels(90_000)
    axis.step(60)
    axis.step(5, HALT)
    assert axis.ways[-1]


def away_from_its_target(axis: Axis) -> None:
    assert CSP.position_window is not None
    axis.feedback.position_actual += CSP.position_window + 1


@pytest.mark.parametrize("reason", [still_demanded, still_slowing_down, away_from_its_target])
def test_target_is_not_reached_before_the_last_increment(reason: Callable[[Axis], None]) -> None:
    axis = Axis()
    axis.step(3)
    assert axis.is_reached
    reason(axis)
    axis.follows = False
    axis.targets[-1] = axis.targets[-2]  # the machine has seen standstill
    axis.step(1, HALT if reason is still_slowing_down else ON)
    assert not axis.is_reached


def test_a_target_is_not_reached_while_the_drive_still_turns() -> None:
    axis = Axis()
    axis.step(3)
    assert axis.is_reached
    axis.targets.append(1)  # no standstill
    axis.step()
    assert not axis.is_reached


@pytest.mark.parametrize(
    ("statusword", "mode"),
    [
        (STATUS_OF[State.SWITCHED_ON] | StatusBit.MODE_12, Mode.CYCLIC_POSITION),
        (STATUS_OF[State.QUICK_STOP_ACTIVE] | StatusBit.MODE_12, Mode.CYCLIC_POSITION),
        (OPERATES | StatusBit.MODE_12, Mode.HOMING),
        (OPERATES | StatusBit.MODE_12, 0),
    ],
)
def test_drive_outside_mode_8_gets_its_own_position(statusword: int, mode: int) -> None:
    axis = Axis()
    axis.travels(90_000)
    axis.step(40)
    axis.follows = False
    axis.feedback.statusword, axis.feedback.modes_of_operation_display = statusword, mode
    for position in (7_000, 6_000, -123_456):
        axis.feedback.position_actual = position
        axis.step(1, SET_POINT)
        assert axis.targets[-1] == position
    axis.shows()
    axis.feedback.modes_of_operation_display = Mode.CYCLIC_POSITION
    axis.step(50)
    assert axis.targets[-1] == -123_456


def test_drive_back_in_operation_gets_its_present_position() -> None:
    axis = Axis()
    axis.travels(90_000)
    axis.step(40)
    for _ in range(50):
        axis.interpolation.refuse(axis.executor)
    axis.follows = False
    axis.feedback.position_actual = 80_000
    axis.records.interlock.action = Action.QUICK_STOP
    axis.step()
    assert axis.targets[-1] == 80_000


def test_stop_without_a_commanded_ramp_uses_the_drives_ramp() -> None:
    axis = Axis()
    axis.turns(SPEED_RPM)
    axis.step(60)
    axis.wished.profile_deceleration = 0
    axis.turns(0)
    check_slows_down_with(slowing_down(axis), SLOW)


# -- the drive ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [Fraction(1), Fraction(10), Fraction(7, 3)], ids=str)
def test_ramps_are_in_the_drives_own_unit_of_acceleration(unit: Fraction) -> None:
    axis = Axis()
    scaling = replace(CSP.scaling, position_range=None, position_wraps=False, acceleration_per_rpm_s=unit)
    axis.interpolation.set_drive(replace(CSP, scaling=scaling), modulo=False)
    axis.step()
    axis.wished.profile_acceleration, axis.wished.profile_deceleration = int(FAST * unit), int(SLOW * unit)
    axis.travels(90_000)
    axis.step(600)
    assert axis.targets[-1] == 90_000
    check_ramps(axis.ways, FAST, SLOW)
    highest = max(axis.ways)
    top = axis.ways.index(highest)
    assert abs(sum(1 for way in axis.ways[:top] if way) - highest / ramp(FAST)) <= 2


@pytest.mark.parametrize(("modulo", "wraps"), [(True, True), (True, False), (False, True)])
def test_modulo_axis_needs_a_drive_with_a_continuous_position(modulo: bool, wraps: bool) -> None:
    drive = replace(CSP, scaling=replace(CSP.scaling, position_wraps=wraps))
    item = Axis().interpolation
    if not (modulo and wraps):
        assert item.set_drive(drive, modulo=modulo).modes
        return
    with pytest.raises(Dsp402Error, match="modulo_range"):
        item.set_drive(drive, modulo=modulo)


def test_mode_8_needs_a_cycle_time() -> None:
    with pytest.raises(Dsp402Error, match="cycle"):
        Interpolation(records_of(0)).set_drive(CSP, modulo=False)


def test_setpoint_of_a_rejected_axis_is_its_present_position() -> None:
    axis = Axis()
    axis.travels(90_000)
    axis.step(20)
    for position in (12_345, -777):
        axis.feedback.position_actual = position
        axis.interpolation.refuse(axis.executor)
        assert axis.command.target_position == position
        assert axis.command.controlword == 0


def test_executor_reads_the_position_of_the_drive() -> None:
    axis = Axis()
    axis.follows = False
    for position in (5, -4096):
        axis.feedback.position_actual = position
        axis.step()
        assert axis.seen.position_actual == position
