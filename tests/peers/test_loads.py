"""What a machine does to the shaft of the simulated drive beside its ramps."""

from __future__ import annotations

import pytest

from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State, StatusBit
from pdgw.peers.drive import SimulatedDriveNode, shape
from tests.support.drives.drive_bench import DriveBench

NODE = 1


class Bench(DriveBench):
    """A drive in rpm in operation."""

    def __init__(self, mode: int = Mode.VELOCITY, name: str = "rpm") -> None:
        super().__init__(lambda send: SimulatedDriveNode(NODE, send, shape=shape(name)))
        self.run(2)
        self.write(0x6060, 0, mode)
        self.write(0x6007, 0, 3)
        self.nmt(NmtCommand.START)

    def habit(self, name: str, **values: int) -> None:
        self.node.start_fault(name, **values)

    def command(self, word: int) -> None:
        self.write(0x6040, 0, word)
        self.run(1)

    def enable(self) -> None:
        for word in (0x06, 0x07, 0x0F):
            self.command(word)
        assert self.model.state is State.OPERATION_ENABLED


@pytest.mark.parametrize(
    ("mode", "name"), [(Mode.VELOCITY, "rpm"), (Mode.POSITION, "rpm"), (Mode.CYCLIC_POSITION, "csp")]
)
def test_shaft_runs_away_at_setpoint_0_as_fast_as_the_habit_says(mode: int, name: str) -> None:
    bench = Bench(mode, name)
    bench.habit("runs-away")
    bench.run(500)
    assert bench.model.speed == 0, "not without power"
    bench.enable()
    bench.run(500)
    assert bench.model.speed == pytest.approx(1500, abs=10)
    assert bench.model.velocity_actual * bench.model.unit == pytest.approx(bench.model.speed, abs=1)
    assert bench.model.position_actual == pytest.approx(750 / 60 / 2 * 4096, rel=0.02)
    bench.run(1000)
    assert bench.model.speed == 3000


@pytest.mark.parametrize("braking", [True, False])
def test_runaway_ends_by_a_quick_stop_or_only_without_power(braking: bool) -> None:
    bench = Bench()
    bench.habit("runs-away" if braking else "runs-away-without-brake")
    bench.enable()
    bench.run(500)
    bench.command(0x02)
    bench.run(1500)
    if braking:
        assert (bench.model.state, bench.model.speed) == (State.SWITCH_ON_DISABLED, 0)
        return
    assert (bench.model.state, bench.model.speed) == (State.QUICK_STOP_ACTIVE, 3000)
    bench.nmt(NmtCommand.STOP)
    bench.run(1000)
    assert bench.model.speed == 3000, "6007h = 3 is a quick stop too"
    bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    bench.command(0x00)
    bench.run(1000)
    assert bench.model.speed == pytest.approx(1500, abs=5), "coasts"


def test_quick_stop_too_slow_brakes_at_its_own_rate_also_after_a_lost_master() -> None:
    bench = Bench()
    bench.habit("quick-stop-too-slow", quick_stop_deceleration=10)
    bench.enable()
    bench.write(0x60FF, 0, 1000)
    bench.run(1000)
    bench.nmt(NmtCommand.STOP)
    bench.run(10_000)
    assert (bench.model.state, bench.model.speed) == (State.QUICK_STOP_ACTIVE, pytest.approx(900, abs=1))
    bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    bench.command(0x00)
    bench.run(1000)
    assert (bench.model.state, bench.model.speed) == (State.SWITCH_ON_DISABLED, 0)


def test_load_turns_a_motor_without_power_and_operation_begins_at_its_speed() -> None:
    bench = Bench()
    bench.habit("flying-start", free_rpm=1000)
    bench.run(2000)
    assert bench.model.velocity_actual == 1000
    bench.enable()
    bench.run(100)
    assert bench.model.speed == pytest.approx(700, abs=15), "brakes from there"
    bench.run(1000)
    assert bench.model.speed == 0


def test_load_sags_at_the_start_of_operation_alone() -> None:
    bench = Bench()
    bench.habit("load-sags", rpm=-60, sag_ms=300)
    bench.enable()
    bench.run(298)
    assert (bench.model.velocity_actual, bench.model.velocity_demand) == (-60, 0)
    bench.run(5)
    assert bench.model.velocity_actual == 0
    assert bench.model.position_actual == pytest.approx(-60 / 60 * 0.3 * 4096, abs=5)


def test_load_swings_back_after_a_stop_and_comes_to_rest() -> None:
    bench = Bench()
    bench.habit("load-swings-back", rpm=60, period_ms=400)
    bench.enable()
    bench.write(0x60FF, 0, 1000)
    bench.run(1000)
    assert bench.model.speed == 1000
    bench.write(0x60FF, 0, 0)
    speeds = []
    for _ in range(2500):
        bench.run(1)
        speeds.append(bench.model.velocity_actual)
    stop = speeds.index(60)
    assert -50 < min(speeds[stop:]) < -30
    assert 10 < max(speeds[stop + 200 :]) < 30
    assert speeds[-1] == 0
    assert bench.model.machine_position == pytest.approx(1000 / 60 * 4096, abs=4), "where the ramp ended"


def test_shaft_dithers_under_power_alone() -> None:
    bench = Bench()
    bench.habit("dithers", rpm=10, period_ms=40)
    bench.run(100)
    assert bench.model.velocity_actual == 0
    bench.enable()
    speeds = []
    for _ in range(80):
        bench.run(1)
        speeds.append(bench.model.velocity_actual)
    assert min(speeds) == -max(speeds) == pytest.approx(-10, abs=1)
    bench.command(0x02)
    bench.run(10)
    assert bench.model.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("mode", [Mode.VELOCITY, Mode.POSITION])
def test_fixed_stop_holds_the_shaft_while_the_demand_continues(mode: int) -> None:
    bench = Bench(mode)
    bench.write(0x607A, 0, 300_000)
    bench.habit("held-at-fixed-stop")
    bench.enable()
    assert not bench.model.statusword & StatusBit.INTERNAL_LIMIT
    bench.write(0x60FF, 0, 500)
    bench.command(0x1F)
    bench.run(1000)
    assert (bench.model.velocity_actual, bench.model.position_actual) == (0, 0)
    assert bench.model.velocity_demand == (500 if mode == Mode.VELOCITY else 1000)
    assert bench.model.statusword & StatusBit.INTERNAL_LIMIT
    assert bench.model.current_actual == bench.model.max_torque
    bench.node.end_fault()
    bench.run(50)
    assert 0 < bench.model.speed < 200, "it accelerates from standstill"
    bench.command(0x02)
    bench.run(1000)
    assert (bench.model.state, bench.model.speed) == (State.SWITCH_ON_DISABLED, 0)


def test_heavy_load_accelerates_slowly_and_brakes_from_its_own_speed() -> None:
    bench = Bench()
    bench.habit("accelerates-slowly", rpm_s=300, torque=0)
    bench.enable()
    bench.write(0x60FF, 0, 1500)
    bench.run(1000)
    assert bench.model.speed == pytest.approx(300, abs=2)
    assert bench.model.statusword & StatusBit.INTERNAL_LIMIT
    assert bench.model.current_actual == 0
    bench.command(0x02)
    bench.run(20)
    assert bench.model.speed < 250
    bench.run(500)
    assert (bench.model.state, bench.model.speed) == (State.SWITCH_ON_DISABLED, 0)


def test_slow_ramps_limit_profile_and_quick_stop() -> None:
    bench = Bench()
    bench.habit("slow-ramps", ramp_ms=6000)
    bench.enable()
    bench.write(0x60FF, 0, 1500)
    bench.run(1000)
    assert bench.model.speed == pytest.approx(500, abs=1)
    bench.command(0x02)
    bench.run(500)
    assert bench.model.speed == pytest.approx(250, abs=2)


def test_shaft_that_still_turns_rubs_at_the_brake_until_it_opens() -> None:
    bench = Bench()
    bench.enable()
    bench.write(0x60FF, 0, 300)
    bench.run(1000)
    bench.command(0x06)
    bench.habit("motion-starts-late")
    bench.enable()
    assert 0 < bench.model.speed < 300
    bench.run(250)
    assert bench.model.speed == 0
    bench.run(1000)
    assert bench.model.speed == 300
