"""Every legal habit of a device: no fault, no warning, no stop, and no untrue reason while the PLC starts, moves and stops.

The checks are those of calm days (``tests/long/soak/calm.py``), which draw the habits at random. ``make conformance`` runs each
habit alone, with both ends of its range.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import pytest

from pdgw.base.durations import SECOND
from pdgw.dsp402.states import State
from pdgw.peers.drive import shape
from pdgw.peers.habits import HABITS, Habit
from pdgw.profidrive.signals import signal
from tests.conformance.rig import COMPLETE, DriveRig, drive
from tests.long.soak.calm import UNFIT, CalmRun, calm_plan
from tests.long.soak.calm_tasks import AxisProgram, EncoderProgram, SpeedProgram, TaskProgram
from tests.long.soak.plan import Part
from tests.support.gateways.daemon import axis, configuration, running

_TELEGRAMS = {"drive": (1, 111), "encoder": (81,)}
_TOGETHER = 6
"""Number of habits that a device has at a time; with more, their delays add up to a slow bring-up."""
_SHAPE = "rpm"
_CYCLE_MS = 16
_LONGEST = 90 * SECOND
_LOWEST = ("heartbeat-period", "heartbeat-with-emcy")
"""Habits of which the lowest value demands most."""


def _legal(device: str) -> list[Habit]:
    return [habit for habit in HABITS.values() if device in habit.legal_for]


def _groups(device: str, numbers: tuple[int, ...]) -> Iterator[object]:
    """Each legal habit once beside others, at the end of its range that demands most."""
    habits = _legal(device)
    count = -(-len(habits) // _TOGETHER)
    for n in range(count):
        number = numbers[n % len(numbers)]
        fit = [habit for habit in habits[n::count] if habit.name not in UNFIT.get(number, ())]
        ends = {habit.name: int(habit.name not in _LOWEST) for habit in fit}
        yield pytest.param(number, ends, id=f"telegram {number}: {', '.join(ends)}")


def _alone(device: str, numbers: tuple[int, ...]) -> Iterator[object]:
    """Each legal habit alone, with both ends of its range."""
    for habit, number in product(_legal(device), numbers):
        if habit.name in UNFIT.get(number, ()):
            continue
        for end in (0, 1) if habit.legal else (0,):
            yield pytest.param(
                number, {habit.name: end}, id=f"telegram {number}: {habit.name} {'highest' if end else 'lowest'}"
            )


_SELECTIONS = (_groups, _alone) if COMPLETE else (_groups,)
_CASES = [case for select in _SELECTIONS for item in _TELEGRAMS.items() for case in select(*item)]


def _run(number: int, ends: dict[str, int]) -> CalmRun:
    """A part of a calm day with habits, each with one end of its range."""
    habits = {name: {key: limits[end] for key, limits in HABITS[name].legal.items()} for name, end in ends.items()}
    return CalmRun(Part(1, 0, 0, calm_plan(number, _CYCLE_MS, _SHAPE, habits)))


def _start_and_stop(axis: AxisProgram) -> None:
    """Move, OFF1 and OFF3 in motion."""
    if isinstance(axis, TaskProgram):
        axis.homing()
        for target in (2.0, -2.0):
            axis.start(target, 0.5)
            axis.arrives(target, 0.5)
    if isinstance(axis, SpeedProgram):
        axis.follow(0.5)
        axis.follow(0.0)
        axis.follow(-0.5)
    axis.of.working = False
    axis.power_on(0)
    axis.of.working = True
    axis.quick_stop()


def _live(run: CalmRun, cycles: int) -> None:
    """Run the program of the test until it has ended this number of times."""
    program = run.program

    def cycle() -> None:
        if isinstance(program, AxisProgram):
            _start_and_stop(program)
        elif isinstance(program, EncoderProgram):
            program.preset()
            program.turn()

    program.tasks = {"cycle": cycle}
    while run.tasks < cycles:
        assert run.loop.now() < _LONGEST
        run.run_to(run.loop.now() + SECOND)
    run.close()


@pytest.mark.parametrize(("number", "ends"), _CASES)
def test_gateway_reports_nothing_of_a_device_with_legal_habits(number: int, ends: dict[str, int]) -> None:
    _live(_run(number, ends), 1)


@pytest.mark.parametrize(("turns_at_0", "at_0"), [(1, 300), (0, 0)])
def test_inverter_with_a_minimum_speed_turns_with_it_and_ends_at_rest(turns_at_0: int, at_0: int) -> None:
    """The target is the larger of setpoint and minimum; OFF1, STW1.4 = 0 and STW1.6 = 0 end below it."""
    habits = {"minimum-speed": {"value": 300, "turns_at_0": turns_at_0}}
    with running(configuration(axis(1, more=""))) as daemon:
        rig = DriveRig(daemon, drive(daemon, shape=shape("vl"), habits=habits))
        rig.device.start()
        rig.enable()
        for setpoint, rpm in ((0, at_0), (0x0800, 375), (0x0100, 300), (0x2000, 1500), (0, at_0), (-0x0100, -300)):
            rig.plc.set(0, {"NSOLL_A": setpoint})
            rig.until(lambda rpm=rpm: rig.model.speed == rpm, f"{rpm} rpm")
            rig.plc.exchange(15)
            assert rig.model.speed == rpm
            assert rig.state is State.OPERATION_ENABLED
        for zero in ("ENABLE_RAMP_GENERATOR", "ENABLE_SETPOINT"):
            rig.command(0x047F & ~signal("STW1").bit(zero).mask)
            rig.until(rig.standing, f"{zero} followed")
            rig.on()
            rig.until(lambda: rig.model.speed == -300, "minimum again")
        rig.off()
        rig.until(lambda: rig.standing() and rig.state is State.READY_TO_SWITCH_ON, "OFF followed")
        assert not rig.numbers
