"""What a machine does to the shaft of the simulated drive beside its ramps."""

from __future__ import annotations

import pytest

from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State
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
