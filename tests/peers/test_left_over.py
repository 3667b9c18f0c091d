"""Objects that another master has left in the simulated drive: each acts in its mode of operation as CiA 402-2 says."""

from __future__ import annotations

import pytest

from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State
from pdgw.peers.drive import SimulatedDriveNode, shape
from tests.support.drives.drive_bench import DriveBench

NODE = 1
TURN = 400_000
"""Increments from one end of 607Bh to the other."""


class Bench(DriveBench):
    """A drive of a variant in operation."""

    def __init__(self, name: str, mode: int) -> None:
        super().__init__(lambda send: SimulatedDriveNode(NODE, send, shape=shape(name)))
        self.run(2)
        self.write(0x6060, 0, mode)
        self.nmt(NmtCommand.START)

    def habit(self, name: str, **values: int) -> None:
        self.node.start_fault(name, **values)

    def enable(self, word: int = 0x0F) -> None:
        for step in (0x06, 0x07, word):
            self.write(0x6040, 0, step)
            self.run(1)
        assert self.model.state is State.OPERATION_ENABLED


@pytest.mark.parametrize(
    ("name", "mode", "moved"), [("csv", Mode.CYCLIC_VELOCITY, True), ("counts", Mode.VELOCITY, False)]
)
def test_velocity_offset_is_added_to_the_setpoint_in_mode_9_alone(name: str, mode: int, moved: bool) -> None:
    bench = Bench(name, mode)
    bench.habit("velocity-offset-left-over", value=13_653)  # 200 rpm
    bench.enable()
    bench.run(1000)
    assert bench.model.speed == pytest.approx(200 if moved else 0, abs=0.01)
    bench.write(0x60FF, 0, 13_653)
    bench.run(1000)
    assert bench.model.speed == pytest.approx(400 if moved else 200, abs=0.01)
    bench.write(0x60B1, 0, 0)
    bench.run(1000)
    assert bench.model.speed == pytest.approx(200, abs=0.01)


def test_position_offset_is_added_to_the_target_of_mode_8_until_it_is_written() -> None:
    bench = Bench("csp", Mode.CYCLIC_POSITION)
    bench.habit("position-offset-left-over", value=5000)
    bench.enable()
    bench.run(200)
    assert bench.model.position_actual == 5000
    assert bench.write(0x60B0, 0, 0) == 0
    bench.write(0x6040, 0, 0x0F)
    bench.run(200)
    assert bench.model.position_actual == 0


@pytest.mark.parametrize(
    ("option", "target", "way"),
    [
        (0x00, 300_000, 300_000 - TURN),
        (0x00, 150_000, 150_000),
        (0x40, 300_000, 300_000 - TURN),
        (0x40, 0, 0),
        (0x80, 300_000, 300_000),
        (0x80, -1000, TURN - 1000),
        (0xC0, 300_000, 300_000 - TURN),
        (0xC0, 150_000, 150_000),
    ],
)
def test_direction_of_60f2h_acts_on_absolute_targets_of_a_rotary_axis(option: int, target: int, way: int) -> None:
    bench = Bench("rpm", Mode.POSITION)
    bench.write(0x607B, 1, -TURN // 2)
    bench.write(0x607B, 2, TURN // 2)
    if option:
        bench.habit("rotary-direction-left-over", value=option)
    bench.write(0x6081, 0, 3000)
    bench.write(0x607A, 0, target)
    bench.enable()
    bench.write(0x6040, 0, 0x1F)
    bench.run(10_000)
    assert bench.model.machine_position == way


@pytest.mark.parametrize(("option", "end"), [(0x40, 3000), (0x41, 3500), (0x42, 3500)])
def test_relative_option_of_60f2h_begins_at_the_previous_target_or_the_present_position(option: int, end: int) -> None:
    bench = Bench("rpm", Mode.POSITION)
    bench.habit("rotary-direction-left-over", value=0x40)
    bench.write(0x60F2, 0, option & 0x3F)
    bench.enable()
    bench.write(0x607A, 0, 2000)
    bench.write(0x6040, 0, 0x1F)
    bench.run(2000)
    bench.model.machine_position = 2500
    bench.write(0x607A, 0, 1000)
    bench.write(0x6040, 0, 0x0F)
    bench.write(0x6040, 0, 0x5F)
    bench.run(2000)
    assert bench.model.machine_position == end


@pytest.mark.parametrize(("turns_at_0", "at_0"), [(1, 300), (0, 0)])
def test_inverter_turns_no_slower_than_its_minimum_and_with_the_sign_of_the_setpoint(
    turns_at_0: int, at_0: int
) -> None:
    bench = Bench("vl", Mode.VL_VELOCITY)
    bench.habit("minimum-speed", value=300, turns_at_0=turns_at_0)
    bench.enable(0x7F)
    for setpoint, speed in ((0, at_0), (1, 300), (-1, -300), (-299, -300), (301, 301), (-1000, -1000), (0, at_0)):
        bench.write(0x6042, 0, setpoint)
        bench.run(1000)
        assert bench.model.speed == speed
    bench.write(0x6040, 0, 0x3F)  # reference of the ramp is 0
    bench.run(1000)
    assert bench.model.speed == 0


def test_left_over_value_returns_after_a_restart_and_not_after_restoring_the_defaults() -> None:
    bench = Bench("csv", Mode.CYCLIC_VELOCITY)
    bench.habit("velocity-offset-left-over", value=77)
    bench.write(0x60B1, 0, 0)
    bench.frame(0, bytes((NmtCommand.RESET_NODE, NODE)))
    assert bench.node.read(0x60B1) == 77
    bench.download(0x1011, 1, b"load")
    bench.frame(0, bytes((NmtCommand.RESET_NODE, NODE)))
    assert bench.node.read(0x60B1) == 0


def test_object_that_a_habit_adds_exists_until_its_end() -> None:
    bench = Bench("rpm", Mode.POSITION)
    absent = bench.read(0x60F2)
    bench.habit("rotary-direction-left-over")
    assert bench.read(0x60F2) == b"\x4b\xf2\x60\0\x40\0\0\0"
    bench.node.end_fault()
    assert bench.read(0x60F2) == absent
