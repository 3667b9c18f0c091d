"""Tasks on a drive with only cyclic synchronous position (variant ``csp``): the gateway generates the setpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from types import MappingProxyType

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import DriveType, Quantity
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import STATUS_OF, State, StatusBit, next_state
from pdgw.gateway.axis.settings import AxisSettings, PlcLossReaction
from pdgw.gateway.commissioning.telegram_check import lacks, planned
from pdgw.gateway.reasons import FaultNumber, Reason
from pdgw.peers.drive import DriveModel, Machine, shape
from pdgw.profidrive.datatypes import n4
from pdgw.profidrive.signals import signal
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import CYCLE_MS, Rig
from tests.support.axis.stepper import Stepper
from tests.support.drives.drive_types import described

CSP = shape("csp")
ZSW1 = signal("ZSW1")
REACHED = ZSW1.bit("TARGET_REACHED", positioning=True).mask
HOME_SET = ZSW1.bit("HOME_POSITION_SET", positioning=True).mask
ON, ACTIVATE, REJECT, INTERMEDIATE, HOMING = 0x043F, 0x40, 0x10, 0x20, 0x800
RANGE = 500_000
POSITION = n4(RANGE, (-(1 << 31), (1 << 31) - 1))
COUNTS_PER_CYCLE = Fraction(4096 * 3000, 60) * CYCLE_MS / 1000
"""At 100 % speed (3000 rpm)."""
RAMP_PER_CYCLE = Fraction(4096 * 10_000, 60) * (Fraction(CYCLE_MS, 1000) ** 2)
"""Of 100 % acceleration (10000 rpm/s)."""
FULL, HALF = 1 << 30, 1 << 29
SMALL = Machine(negative_limit=-20_000, positive_limit=20_000, negative_stop=-30_000, positive_stop=30_000)


class CspRig(Rig):
    """Stores every setpoint sent to the drive."""

    def __init__(self, machine: Machine | None = None, **settings: object) -> None:
        self.targets: list[int] = []
        super().__init__(9, machine, CSP, **settings)
        self.values |= {"SATZANW": 0x8000, "MDI_VELOCITY": FULL, "MDI_ACC": 1 << 14, "MDI_DEC": 1 << 14, "MDI_MOD": 1}
        self.enable()

    def _send(self) -> None:
        super()._send()
        self.targets.append(self.stepper.command.target_position)

    @property
    def position(self) -> int:
        return self.node.model.position_actual

    @property
    def stands(self) -> bool:
        return self.node.model.ramp.speed == 0 and len(set(self.targets[-3:])) == 1

    def task(self, target: int, *, relative: bool = False, hold: int = 3) -> None:
        """An edge of STW1.6 with its data, held for some cycles."""
        wire = POSITION.to_wire(target)
        self.values |= {"MDI_TARPOS": wire, "MDI_MOD": 0 if relative else 1, "STW1": ON | ACTIVATE}
        self.step(hold)
        self.values["STW1"] = ON
        self.step(1)

    def reached(self) -> None:
        self.until(lambda actuals: bool(actuals["ZSW1"] & REACHED))


def steps(targets: Sequence[int]) -> list[int]:
    return [after - before for before, after in pairwise(targets)]


def check_profile(targets: Sequence[int], speed: Fraction, ramp: Fraction) -> None:
    """Check that every step and its change are within the commanded limits, apart from rounding."""
    ways = steps(targets)
    assert max(map(abs, ways), default=0) <= speed + 1
    assert max(map(abs, steps(ways)), default=0) <= ramp + 2


def test_task_in_mode_8_is_a_trapezoid_with_the_usual_zsw1() -> None:
    rig = CspRig()
    rig.task(100_000)
    assert not rig.actuals["ZSW1"] & REACHED
    rig.reached()
    assert rig.position == 100_000
    assert rig.node.model.mode == Mode.CYCLIC_POSITION
    assert rig.stepper.command.modes_of_operation == Mode.CYCLIC_POSITION
    assert max(steps(rig.targets)) in {int(COUNTS_PER_CYCLE), int(COUNTS_PER_CYCLE) + 1}, "100 % speed"
    check_profile(rig.targets, COUNTS_PER_CYCLE, RAMP_PER_CYCLE)
    assert all(word & 0xF in {0x0, 0x6, 0x7, 0xF} and not word & 0x170 for word in rig.controlwords), "bits of mode 1"
    rig.task(-10_000, relative=True)
    rig.reached()
    assert rig.position == 90_000


def test_an_intermediate_stop_is_resumed_to_the_target() -> None:
    rig = CspRig()
    rig.task(80_000)
    rig.step(40)
    rig.values["STW1"] = ON & ~INTERMEDIATE
    rig.until(lambda _: rig.stands)
    assert 0 < rig.position < 80_000
    rig.values["STW1"] = ON
    rig.step(3)
    rig.reached()
    assert rig.position == 80_000
    check_profile(rig.targets, COUNTS_PER_CYCLE, RAMP_PER_CYCLE)


@pytest.mark.parametrize(("plc", "word"), [(True, 0x043B), (False, ON)])
def test_off3_and_plc_loss_use_the_drives_quick_stop_without_a_later_jump(plc: bool, word: int) -> None:
    rig = CspRig()
    rig.task(100_000)
    rig.step(60)
    rig.values["STW1"] = word
    rig.step(3, plc=plc)
    assert rig.state is State.QUICK_STOP_ACTIVE
    rig.until(lambda _: rig.state is State.SWITCH_ON_DISABLED)
    stood = rig.position
    rig.values["STW1"] = 0x043E
    rig.step(5)
    rig.enable()
    rig.step(50)
    assert rig.position == stood
    assert rig.stands


def test_a_shaft_that_was_turned_by_hand_stays_where_it_is_when_it_is_enabled() -> None:
    rig = CspRig()
    rig.values["STW1"] = 0x043E
    rig.until(lambda _: rig.state is State.READY_TO_SWITCH_ON)
    rig.node.model.machine_position += 12_345
    rig.node.model.wake()
    rig.step(5)
    rig.enable()
    rig.step(20)
    assert rig.position == 12_345
    assert rig.stands


def test_a_target_outside_the_position_range_is_its_end() -> None:
    rig = CspRig()
    rig.task(450_000)
    rig.reached()
    rig.task(200_000, relative=True)
    rig.reached()
    assert rig.position == RANGE


def test_an_axis_held_by_a_limit_switch_does_not_move_on_when_that_is_released() -> None:
    rig = CspRig(SMALL)
    rig.task(60_000)
    rig.until(lambda _: rig.stepper.reason is Reason.TASK_AT_LIMIT)
    assert rig.stands
    stood = rig.position
    assert stood >= 20_000
    rig.node.model.machine = replace(SMALL, positive_limit=100_000, positive_stop=110_000)
    rig.node.model.wake()
    rig.step(200)
    assert rig.position == stood
    rig.task(0)
    rig.reached()
    assert rig.position == 0


def test_drive_that_ignores_targets_gets_no_distant_target() -> None:
    rig = CspRig()

    def ignores(model: DriveModel, now: int) -> None:
        model.statusword &= ~StatusBit.MODE_12

    rig.node.model.disguises.append(ignores)
    rig.node.model.wake()
    rig.step(3)
    rig.task(50_000)
    rig.step(200)
    assert rig.stepper.reason is Reason.NOT_FOLLOWING
    assert set(rig.targets[-100:]) == {0}
    rig.node.model.disguises.remove(ignores)
    rig.node.model.wake()
    rig.reached()
    assert rig.position == 50_000
    check_profile(rig.targets, COUNTS_PER_CYCLE, RAMP_PER_CYCLE)


def test_homing_uses_mode_6_and_tasks_continue_in_mode_8() -> None:
    rig = CspRig()
    rig.task(5_000)
    rig.reached()
    rig.values |= {"SATZANW": 35, "MDI_VELOCITY": 1 << 27, "STW1": ON | HOMING}
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET))
    assert rig.node.model.mode == Mode.HOMING
    assert rig.position == 0
    rig.values |= {"SATZANW": 0x8000, "MDI_VELOCITY": FULL, "STW1": ON}
    rig.until(lambda _: rig.node.model.mode == Mode.CYCLIC_POSITION)
    rig.step(5)
    assert rig.stands
    rig.task(7_000)
    rig.reached()
    assert rig.position == 7_000


def without(drive: DriveType, mode: Mode) -> DriveType:
    return replace(drive, modes=MappingProxyType({key: text for key, text in drive.modes.items() if key != mode}))


def test_homing_of_a_drive_without_mode_6_is_refused_with_the_reason() -> None:
    rig = CspRig()
    rig.stepper.set_drive(without(described("csp"), Mode.HOMING))
    rig.step(2)
    rig.values |= {"SATZANW": 0x8000 | 35, "STW1": ON | HOMING}
    rig.step(5)
    assert rig.stepper.reason is Reason.HOMING_METHOD
    fault = rig.stepper.events[-1]
    assert fault.number == FaultNumber.HOMING_METHOD
    assert "none: the drive has no homing (6502h, 60E3h)" in fault.text
    assert rig.node.model.mode == Mode.CYCLIC_POSITION


@pytest.mark.parametrize("number", [9, 7, 110, 111])
def test_rpdo_has_a_position_and_the_controlword(number: int) -> None:
    plan = planned(described("csp"), number)
    assert [item.pdo.attributes for item in plan.rpdos] == [("target_position", "modes_of_operation", "controlword")]
    assert plan.needs_sync
    assert lacks(described("csp"), number) == ""


@pytest.mark.parametrize(
    ("unknown", "what", "key", "line"),
    [
        (
            "counts_per_revolution",
            "position units per revolution",
            "counts_per_revolution",
            "counts_per_revolution = 0",
        ),
        ("velocity_per_rpm", "velocity units per rpm", "velocity_unit", 'velocity_unit = "?"'),
        ("acceleration_per_rpm_s", "acceleration units per rpm/s", "acceleration_unit", 'acceleration_unit = "?"'),
    ],
)
def test_unknown_unit_blocks_the_axis_and_names_its_key(unknown: str, what: str, key: str, line: str) -> None:
    drive = described("csp")
    scaling = replace(drive.scaling, **{unknown: None})  # type: ignore[arg-type]
    refusal = lacks(replace(drive, scaling=scaling), 9)
    assert refusal == f"{what}: unknown, set {key}; paste into its [[axis]] and fill in: {line}"


def test_unknown_reference_blocks_the_axis() -> None:
    drive = described("csp")
    references = {key: value for key, value in drive.scaling.references.items() if key is not Quantity.DECELERATION}
    scaling = replace(drive.scaling, references=references, unknown={Quantity.DECELERATION: "set rated_..."})
    assert lacks(replace(drive, scaling=scaling), 9) == "set rated_..."


def test_task_beyond_an_overflowing_range_ends_there_without_a_jump() -> None:
    rig = CspRig()
    drive = described("csp")
    assert drive.scaling.position_wraps
    rig.stepper.set_drive(replace(drive, scaling=replace(drive.scaling, position_range=(0, 99_999))))
    rig.task(90_000)
    rig.reached()
    rig.task(20_000, relative=True)
    rig.reached()
    assert rig.position == 99_999
    check_profile(rig.targets, COUNTS_PER_CYCLE, RAMP_PER_CYCLE)


def test_axis_without_a_range_turns_across_the_32_bit_overflow() -> None:
    drive = described("csp")
    stepper = Stepper(9, AxisSettings(cycle_ns=CYCLE_MS * 1_000_000))
    stepper.set_drive(replace(drive, scaling=replace(drive.scaling, position_range=None)))
    feedback = DriveFeedback()
    feedback.position_actual = (1 << 31) - 1000
    values = {"SATZANW": 0x8000, "MDI_TARPOS": POSITION.to_wire(3_000), "MDI_VELOCITY": FULL, "MDI_ACC": 1 << 14}
    values |= {"MDI_DEC": 1 << 14, "MDI_MOD": 0}
    targets: list[int] = []
    state = State.SWITCH_ON_DISABLED
    feedback.modes_of_operation_display = Mode.CYCLIC_POSITION
    for cycle in range(100):
        feedback.statusword = STATUS_OF[state] | StatusBit.NO_QUICK_STOP | StatusBit.MODE_12
        values["STW1"] = 0x043E if cycle < 8 else ON if cycle < 20 else ON | ACTIVATE
        stepper.step(stepper.telegram.setpoints.from_dict(values), feedback, True, cycle * CYCLE_MS * 1_000_000)
        state = next_state(state, stepper.command.controlword, 0)
        feedback.position_actual = stepper.command.target_position
        targets.append(feedback.position_actual)
    assert targets[-1] == 2_000 - (1 << 31)
    ways = [way + (1 << 32) if way < -(1 << 31) else way for way in steps(targets)]
    assert min(ways) >= 0, "forward all the way"
    assert max(ways) <= COUNTS_PER_CYCLE + 1


def test_short_limit_signal_holds_the_axis_until_a_new_task() -> None:
    rig = CspRig()
    rig.task(100_000)
    rig.step(30)

    def held(model: DriveModel, now: int) -> None:
        model.statusword = model.statusword & ~StatusBit.MODE_12 | StatusBit.INTERNAL_LIMIT

    rig.node.model.disguises.append(held)
    rig.step(3)
    rig.node.model.disguises.remove(held)
    rig.step(2)
    stood = rig.targets[-1]
    rig.step(200)
    assert rig.targets[-1] == stood
    assert rig.stepper.reason is Reason.TASK_AT_LIMIT
    rig.task(90_000)
    rig.reached()
    assert rig.position == 90_000


def test_drive_that_delays_a_quick_stop_is_guided_to_standstill() -> None:
    rig = CspRig()
    rig.task(400_000)
    rig.step(100)

    def deaf(model: DriveModel, now: int) -> None:
        model.statusword = STATUS_OF[State.OPERATION_ENABLED] | StatusBit.NO_QUICK_STOP | StatusBit.MODE_12

    rig.node.model.disguises.append(deaf)
    rig.values["STW1"] = 0x043B
    rig.step(90)
    assert len(set(rig.targets[-5:])) == 1
    check_profile(rig.targets, COUNTS_PER_CYCLE, RAMP_PER_CYCLE)


@settings(max_examples=25)
@given(
    targets=st.lists(st.integers(-50_000, 50_000), min_size=1, max_size=3),
    speed=st.integers(1 << 28, FULL),
    acceleration=st.integers(1 << 10, 1 << 14),
    deceleration=st.integers(1 << 10, 1 << 14),
    cycles=st.integers(0, 60),
)
def test_tasks_replaced_at_any_time_keep_limits_and_reach_the_last_target(
    targets: list[int], speed: int, acceleration: int, deceleration: int, cycles: int
) -> None:
    rig = CspRig()
    rig.values |= {"MDI_VELOCITY": speed, "MDI_ACC": acceleration, "MDI_DEC": deceleration}
    for target in targets:
        rig.task(target)
        rig.step(cycles)
    rig.reached()
    assert abs(rig.position - POSITION.to_value(POSITION.to_wire(targets[-1]))) <= 1
    ramp = max(acceleration, deceleration)
    check_profile(rig.targets, COUNTS_PER_CYCLE * speed / FULL, RAMP_PER_CYCLE * ramp / (1 << 14))


STOPS = {
    "OFF1": {"STW1": 0x043E},
    "reject": {"STW1": ON & ~REJECT},
    "intermediate stop": {"STW1": ON & ~INTERMEDIATE},
    "MDI off": {"SATZANW": 0},
    "PLC lost": {},
}


@pytest.mark.parametrize("stop", STOPS)
@settings(max_examples=12)
@given(cycles=st.integers(0, 150), deceleration=st.integers(1 << 11, 1 << 14))
def test_a_stop_at_any_moment_ends_within_the_ramp(stop: str, cycles: int, deceleration: int) -> None:
    rig = CspRig(on_plc_loss=PlcLossReaction.RAMP)
    rig.values["MDI_DEC"] = deceleration
    rig.task(100_000)
    rig.step(cycles)
    speed = abs(steps(rig.targets)[-1])
    rig.values |= STOPS[stop]
    plc = stop != "PLC lost"
    began = len(rig.targets)
    ramp = RAMP_PER_CYCLE * deceleration / (1 << 14)
    for _ in range(int(speed / ramp) + 2):
        rig.step(plc=plc)
        if rig.state is not State.OPERATION_ENABLED:  # switched off inside the standstill window
            del rig.targets[-1]
            break
    ways = steps(rig.targets[began - 1 :])
    assert rig.state is not State.OPERATION_ENABLED or abs(ways[-1]) <= 1, "standstill"
    assert all(abs(after) <= abs(before) + 2 for before, after in pairwise([speed, *ways])), "never faster again"
    check_profile(rig.targets, COUNTS_PER_CYCLE, RAMP_PER_CYCLE)
    rig.step(30, plc=plc)
    stood = rig.targets[-1]
    rig.step(50, plc=plc)
    assert rig.stands
    assert rig.targets[-1] == stood
    if stop in {"OFF1", "PLC lost"}:
        assert rig.state is not State.OPERATION_ENABLED


def test_a_modulo_axis_whose_drive_wraps_its_positions_is_refused_in_mode_8() -> None:
    settings = AxisSettings(cycle_ns=CYCLE_MS * 1_000_000, positioner=replace(CHOICES, modulo=10_000))
    assert "modulo_range" in lacks(described("csp"), 111, settings)
