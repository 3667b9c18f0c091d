"""Cyclic synchronous modes of the simulated drive: interpolation between setpoints, and missing setpoints."""

from __future__ import annotations

import pytest

from pdgw.base.durations import MS
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import Command, State, StatusBit
from pdgw.peers.drive import DriveModel
from pdgw.peers.drive.model.shapes import SYNCHRONOUS

PERIOD_MS = 4
CYCLIC = (Mode.CYCLIC_POSITION, Mode.CYCLIC_VELOCITY, Mode.CYCLIC_TORQUE)


class Bench:
    """A drive in operation in one mode, and SYNC by hand."""

    def __init__(self, mode: Mode, *, watched: bool = True) -> None:
        values = {
            (entry.index, entry.subindex): entry.default for spec in SYNCHRONOUS.objects() for entry in spec.entries
        }
        values[0x1006, 0] = PERIOD_MS * 1000 if watched else 0
        values[0x607B, 1] = values[0x607B, 2] = 0

        def read(index: int, subindex: int) -> int:
            value = values.get((index, subindex), 0)
            assert isinstance(value, int)
            return value

        self.model = DriveModel(read, shape=SYNCHRONOUS)
        self.now = 0
        self.model.advance(0)
        self.model.modes_of_operation = mode
        for command in (Command.SHUTDOWN, Command.SWITCH_ON, Command.ENABLE_OPERATION):
            self.model.controlword = command.word
            self.model.command()
        assert self.model.state is State.OPERATION_ENABLED

    def sync(self, **values: int) -> None:
        """A SYNC. ``values``: setpoints before it; none: the RPDO was lost."""
        if values:
            for name, value in values.items():
                setattr(self.model, name, value)
            self.model.command()
        self.model.synchronised()
        self.run(PERIOD_MS)

    def run(self, milliseconds: int) -> list[float]:
        """Positions after each millisecond."""
        positions = []
        for _ in range(milliseconds):
            self.now += MS
            self.model.advance(self.now)
            positions.append(self.model.position)
        return positions


def test_a_position_is_reached_in_a_straight_line_over_60c2h() -> None:
    bench = Bench(Mode.CYCLIC_POSITION)
    bench.model.target_position = 40
    bench.model.command()
    bench.model.synchronised()
    assert bench.run(PERIOD_MS) == pytest.approx([10, 20, 30, 40])


def test_positions_continue_beyond_the_end_of_their_32_bits() -> None:
    bench = Bench(Mode.CYCLIC_POSITION)
    bench.model.zero = 100.0 - (1 << 31)
    bench.model.disguises.append(lambda model, now: None)  # updates the image
    for target in ((1 << 31) - 60, (1 << 31) - 20, 20 - (1 << 31), 60 - (1 << 31)):
        bench.sync(target_position=target)
    assert bench.model.machine_position == 160
    assert bench.model.position_actual == 60 - (1 << 31)


def test_without_new_positions_the_motion_continues_for_one_period() -> None:
    bench = Bench(Mode.CYCLIC_POSITION)
    for target in (40, 80):
        bench.sync(target_position=target)
    bench.sync()
    assert bench.model.position == pytest.approx(120)
    bench.sync()
    assert bench.model.position == pytest.approx(120)
    bench.sync(target_position=160)
    assert bench.model.position == pytest.approx(160)
    assert bench.model.state is State.OPERATION_ENABLED


def test_without_a_sync_period_the_motion_ends_at_the_last_target() -> None:
    bench = Bench(Mode.CYCLIC_POSITION, watched=False)
    for target in (40, 80):
        bench.sync(target_position=target)
    bench.run(100)
    assert bench.model.position == pytest.approx(80)
    assert bench.model.state is State.OPERATION_ENABLED


def test_without_new_speeds_the_speed_stays() -> None:
    bench = Bench(Mode.CYCLIC_VELOCITY)
    for _ in range(20):
        bench.sync(target_velocity=1000)
    for _ in range(20):
        bench.sync()
    assert bench.model.velocity_actual == 1000


def test_torque_accelerates_and_without_it_the_motor_coasts() -> None:
    bench = Bench(Mode.CYCLIC_TORQUE)
    for _ in range(25):
        bench.sync(target_torque=500)
    speed = bench.model.ramp.speed
    assert speed == pytest.approx(6000 * 0.5 * 0.1)
    assert bench.model.current_actual == 500
    bench.sync(target_torque=0)
    assert 0 < bench.model.ramp.speed < speed
    bench.sync(target_torque=-1000)
    assert bench.model.current_actual == -1000


@pytest.mark.parametrize("mode", CYCLIC)
def test_three_periods_without_sync_are_a_fault_and_the_drive_brakes(mode: Mode) -> None:
    bench = Bench(mode)
    for step in range(1, 30):
        bench.sync(target_position=100 * step, target_velocity=1000, target_torque=300)
    assert bench.model.ramp.speed > 0
    bench.run(3 * PERIOD_MS - PERIOD_MS)
    assert bench.model.state is State.OPERATION_ENABLED
    bench.run(2)
    assert bench.model.state in {State.FAULT_REACTION_ACTIVE, State.FAULT}
    assert (bench.model.emcy_code, bench.model.error_register) == (0x8700, 0x11)
    bench.run(2000)
    assert bench.model.state is State.FAULT
    assert bench.model.ramp.speed == 0


@pytest.mark.parametrize("mode", CYCLIC)
def test_loss_of_sync_is_detected_at_standstill_too(mode: Mode) -> None:
    bench = Bench(mode)
    bench.sync(target_position=0, target_velocity=0, target_torque=0)
    bench.run(4 * PERIOD_MS)
    assert bench.model.state is not State.OPERATION_ENABLED


def test_modes_with_a_profile_need_no_sync() -> None:
    bench = Bench(Mode.VELOCITY)
    bench.model.target_velocity = 1000
    bench.run(2000)
    assert bench.model.velocity_actual == 1000


@pytest.mark.parametrize("mode", CYCLIC)
def test_bit_12_says_that_the_drive_follows(mode: Mode) -> None:
    bench = Bench(mode)
    assert bench.model.statusword & StatusBit.MODE_12
    bench.model.controlword |= 1 << 8
    bench.sync(target_velocity=0)
    assert not bench.model.statusword & StatusBit.MODE_12
