"""Speed setpoints as orders: 0 stops a turning shaft as OFF1 does, or the gateway does; no legal motion is stopped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.drive.images import DEMAND_UNKNOWN
from pdgw.dsp402.drive_type import VL_RAMP, VL_REFERENCE, DriveType
from pdgw.dsp402.objects import VL_MIN_MAX, VL_MIN_MAX_BY_DIRECTION
from pdgw.dsp402.states import State, StatusBit
from pdgw.gateway.axis.demand_report import Flag
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import DSC_TELEGRAM_NUMBERS, SPEED_TELEGRAM_NUMBERS
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits
from tests.gateway.axis.test_velocity import OFF, ON, Bench
from tests.support.axis.stepper import DSC
from tests.support.drives.drive_types import described

CYCLE = 4 * MS
REACTION = AxisSettings().reaction_ns // CYCLE
SPEED = 0x2000
"""1500 rpm, 3000 units of the drive."""


class Unmoved(Bench):
    """Its shaft turns as ``shaft`` says after the order, whatever the drive is sent, and "target reached" is stuck."""

    demand: int | None = None
    """606Bh; None: as the speed."""

    def at_speed(self) -> Unmoved:
        self.operate(SPEED)
        self.step(ON, SPEED, cycles=100)
        assert self.drive.feedback.velocity_actual == 3000
        self.order(ON, SPEED, 100)
        assert self.zsw1 & Flag.REACHED
        assert self.zsw1 & Flag.WITHIN_TOLERANCE
        return self

    def order(self, word: int, speed: int, cycles: int, shaft: Callable[[int], int] = lambda cycle: 3000) -> int:
        """Cycles until the gateway stops the drive; ``cycles`` if it does not."""
        feedback = self.drive.feedback
        feedback.statusword |= StatusBit.TARGET_REACHED
        for cycle in range(cycles):
            self.now += CYCLE
            feedback.velocity_actual = shaft(cycle)
            feedback.velocity_demand = shaft(cycle) if self.demand is None else self.demand
            self.stepper.step((word, speed), feedback, True, self.now)
            if self.controlword & 0xF != 0xF:
                return cycle
        return cycles

    @property
    def zsw1(self) -> int:
        return self.stepper.machine.outputs.actuals[0]

    @property
    def numbers(self) -> list[int]:
        return self.stepper.numbers


@pytest.mark.parametrize(
    ("word", "speed"),
    [(ON, 0), (ON, 40), (ON, -40), (ON & ~0x10, SPEED), (ON & ~0x40, SPEED), (ON & ~0x70, SPEED)],
    ids=["0", "inside the window", "inside, other sign", "STW1.4 = 0", "STW1.6 = 0", "end of a jog"],
)
def test_drive_that_keeps_its_speed_at_setpoint_0_gets_quick_stop(word: int, speed: int) -> None:
    bench = Unmoved().at_speed()
    assert REACTION <= bench.order(word, speed, 1000) <= REACTION + 3
    assert bench.numbers == [FaultNumber.STOP_IGNORED]
    assert not bench.zsw1 & (Flag.REACHED | Flag.WITHIN_TOLERANCE)


def test_setpoints_inside_the_window_do_not_begin_the_time_again() -> None:
    bench = Unmoved().at_speed()
    reached = 0
    for cycle in range(REACTION + 5):
        reached += bench.order(ON, (0, 40, -40)[cycle % 3], 1)
    assert reached <= REACTION + 3


def test_motion_after_standstill_begins_no_order() -> None:
    """A load that swings through 0 has arrived: only the speed setpoint itself is watched."""
    bench = Unmoved().at_speed()
    shaft = [max(3000 - cycle * 12, 0) for cycle in range(260)]
    swing = [100 if cycle % 100 < 50 else -100 for cycle in range(1000)]
    assert bench.order(ON, 0, 1260, lambda cycle: [*shaft, *swing][cycle]) == 1260
    assert bench.numbers == []


def test_ramp_of_the_stop_time_is_followed_and_shown() -> None:
    bench = Unmoved().at_speed()
    ramp = [max(3000 - cycle * 12 // 5, 0) for cycle in range(1300)]
    assert bench.order(ON, 0, 700, ramp.__getitem__) == 700
    assert not bench.zsw1 & Flag.REACHED, "speed and setpoint differ"
    assert bench.zsw1 & Flag.WITHIN_TOLERANCE, "a legal ramp"
    assert bench.order(ON, 0, 500, lambda cycle: ramp[700 + cycle]) == 500
    assert bench.numbers == []


def test_shaft_that_turns_when_operation_begins_is_watched() -> None:
    bench = Unmoved()
    bench.step(OFF, cycles=3)
    bench.step(ON, 0, cycles=10)
    assert bench.drive.state is State.OPERATION_ENABLED
    bench = Unmoved()
    bench.step(OFF, cycles=3)
    assert bench.order(ON, 0, 10, lambda cycle: 3000) < 10, "below operation"
    for _ in range(10):
        bench.step(ON, 0)
        bench.drive.feedback.velocity_actual = 3000
    assert bench.order(ON, 0, 1000) <= REACTION + 3


@pytest.mark.parametrize("number", [*SPEED_TELEGRAM_NUMBERS, *DSC_TELEGRAM_NUMBERS])
def test_setpoint_0_is_an_order_of_each_speed_telegram(number: int) -> None:
    bench = Bench(number, cycle_ns=CYCLE, dsc=DSC)
    bench.operate(SPEED << (0 if number in (1, 20) else 16))
    feedback, half = bench.drive.feedback, bench.stepper.telegram.setpoints
    bench.step(ON, SPEED << (0 if number in (1, 20) else 16), cycles=100)
    for _ in range(REACTION + 5):
        bench.now += CYCLE
        feedback.velocity_actual = 3000
        bench.stepper.step(half.from_dict({"STW1": ON}), feedback, True, bench.now)
    assert bench.stepper.numbers == [FaultNumber.STOP_IGNORED]


MINIMUM = 300
_INVERTER = replace(described("vl"), acting={(VL_MIN_MAX, 1): MINIMUM})
"""Its unit is 1 rpm; it turns with 300 of 3000 rpm at setpoint 0, too."""


def inverter(drive: DriveType = _INVERTER) -> Unmoved:
    bench = Unmoved()
    bench.stepper.set_drive(drive)
    bench.step(OFF, cycles=3)
    bench.step(ON, 0, cycles=10)
    return bench


@pytest.mark.parametrize("speed", [0, 40, 0x200, -0x200])
def test_minimum_speed_of_an_inverter_is_followed_and_does_not_grow_further(speed: int) -> None:
    bench = inverter()
    turning = MINIMUM if speed >= 0 else -MINIMUM
    assert bench.order(ON, speed, 1000, lambda cycle: turning) == 1000
    assert bench.numbers == []
    assert not bench.zsw1 & Flag.REACHED
    assert bench.stepper.machine.lags_since == 0
    assert bench.order(ON, speed, 1000, lambda cycle: 2 * turning) < 150
    assert bench.numbers[0] == FaultNumber.VELOCITY


@pytest.mark.parametrize(("speed", "shaft"), [(0, 1500), (0x200, 1500), (-0x200, 1500), (0, -1500)])
def test_inverter_that_keeps_its_speed_gets_quick_stop_as_any_drive(speed: int, shaft: int) -> None:
    bench = inverter()
    bench.order(ON, 0x2000 if shaft > 0 else -0x2000, 100, lambda cycle: shaft)
    assert REACTION <= bench.order(ON, speed, 1000, lambda cycle: shaft) <= REACTION + 5
    assert bench.numbers == [FaultNumber.STOP_IGNORED]


def test_inverter_at_a_torque_limit_whose_demand_value_is_the_minimum_speed_has_the_setpoint() -> None:
    bench = inverter()
    bench.order(ON, 0x2000, 100, lambda cycle: 1500)
    bench.demand = MINIMUM
    bench.drive.feedback.statusword |= StatusBit.INTERNAL_LIMIT
    assert bench.order(ON, 0, 1000, lambda cycle: 1500) == 1000


def test_an_axis_that_lags_does_so_no_longer_without_operation() -> None:
    bench = Unmoved().at_speed()
    bench.order(ON, SPEED, 400, lambda cycle: 2000)
    assert bench.stepper.machine.lags_since
    bench.order(OFF, SPEED, 1, lambda cycle: 2000)
    assert bench.stepper.machine.lags_since == 0


def test_minimum_speed_counts_with_a_setpoint_alone() -> None:
    """STW1.4 = 0 and OFF1 leave out the bit of the reference, and the ramp ends at 0."""
    for word in (ON & ~0x10, OFF):
        bench = inverter()
        bench.order(ON, 0, 100, lambda cycle: MINIMUM)
        assert bench.controlword & VL_RAMP == VL_RAMP
        bench.order(word, 0, REACTION + 15, lambda cycle: MINIMUM)
        assert bench.numbers == [FaultNumber.STOP_IGNORED]
    bench = inverter()
    bench.step(ON & ~0x10)
    assert bench.controlword & VL_RAMP == VL_RAMP & ~VL_REFERENCE


def test_minimum_speed_is_that_of_the_present_drive() -> None:
    """The parameter of the inverter was set to 0 while it was lost: it may not turn any more at setpoint 0."""
    bench = inverter()
    bench.stepper.set_drive(described("vl"))
    bench.step(OFF, cycles=3)
    bench.step(ON, 0, cycles=10)
    assert bench.order(ON, 0, 1000, lambda cycle: MINIMUM) < REACTION + 600
    assert bench.numbers


def test_minimum_speed_counts_in_velocity_mode_alone() -> None:
    acting = {(VL_MIN_MAX, 1): MINIMUM}
    assert _INVERTER.minimum_speed == MINIMUM
    assert replace(_INVERTER, acting={(VL_MIN_MAX_BY_DIRECTION, 3): MINIMUM}).minimum_speed == MINIMUM
    assert replace(_INVERTER, acting={(VL_MIN_MAX, 1): 0xFFFF_FFFF}).minimum_speed == 3000, "no more than 100 %"
    assert replace(described("rpm"), acting=acting).minimum_speed == 0
    bench = inverter(described("vl"))
    bench.step(ON & ~0x10)
    assert bench.controlword & VL_RAMP == VL_RAMP, "without a minimum"
    assert bench.order(ON, 0, 1000, lambda cycle: MINIMUM) < REACTION + 600


LIMIT = warning_bits(FaultNumber.INTERNAL_LIMIT)


@pytest.mark.parametrize(
    ("status", "demand", "seconds"),
    [
        (StatusBit.INTERNAL_LIMIT, 0, None),
        (StatusBit.INTERNAL_LIMIT, 3000, 0.8),
        (StatusBit.INTERNAL_LIMIT, DEMAND_UNKNOWN, 0.8),
        (0, 0, 0.4),
    ],
    ids=["shown, demand value 0", "shown, demand value as before", "shown, no demand value", "not shown"],
)
def test_torque_limit_excuses_a_drive_only_if_it_has_the_setpoint(
    status: int, demand: int, seconds: float | None
) -> None:
    bench = Unmoved().at_speed()
    bench.demand = demand
    bench.drive.feedback.statusword |= status
    cycles = bench.order(ON, 0, 3000)
    if seconds is None:
        assert cycles == 3000
        assert bench.stepper.machine.outputs.warning & LIMIT
    else:
        assert seconds * SECOND // CYCLE <= cycles + 2 <= seconds * SECOND // CYCLE + 15


def test_growing_speed_is_found_whatever_limit_the_drive_shows() -> None:
    bench = Unmoved().at_speed()
    bench.demand = 0
    bench.drive.feedback.statusword |= StatusBit.INTERNAL_LIMIT
    assert bench.order(ON, 0, 1000, lambda cycle: 3000 + 2 * cycle) <= 175, "0.6 to 0.7 s"
    assert FaultNumber.VELOCITY in bench.numbers
