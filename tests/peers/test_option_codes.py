"""The option codes of the simulated drive: every value of 605Ah to 605Eh and 6007h, in every state."""

from __future__ import annotations

import pytest

from pdgw.ds301.aborts import Abort
from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import Command, State, next_state
from pdgw.peers.drive import SHAPES, SimulatedDriveNode, shape
from pdgw.peers.drive.model.ramps import COAST_DECELERATION
from pdgw.peers.drive.objects import VALUES
from pdgw.peers.drive.option_codes import OPTION_CODES, limits
from tests.support.drives.drive_bench import DriveBench, drive_in

NODE = 1
HALT = 0x100
RAMPS = {1: 3000.0, 2: 8000.0, 3: 12_000.0}
"""rpm/s of the profile, of the quick stop and of the torque limit."""
STATES = [state for state in State if state is not State.NOT_READY_TO_SWITCH_ON]


class Bench(DriveBench):
    """A drive in rpm whose ramps differ, at 3000 rpm."""

    def __init__(self, option: int = 0, code: int = 0, mode: int = Mode.VELOCITY) -> None:
        super().__init__(lambda send: SimulatedDriveNode(NODE, send, shape=shape("rpm")))
        self.run(2)
        for index, value in ((0x6085, 8000), (0x6072, 2000), (0x6060, mode), (0x6081, 3000), (0x60FF, 3000)):
            self.write(index, 0, value)
        if option:
            assert self.write(option, 0, code) == 0
        self.nmt(NmtCommand.START)
        for word in (0x06, 0x07, 0x0F):
            self.command(word)
        self.write(0x607A, 0, 450_000)
        if mode == Mode.POSITION:
            self.command(0x1F)
        self.run(1100)
        assert self.model.ramp.speed == pytest.approx(3000)

    def command(self, word: int) -> None:
        self.write(0x6040, 0, word)
        self.run(1)

    def rate(self) -> float:
        """Deceleration in rpm/s."""
        self.run(1)
        before = self.model.ramp.speed
        self.run(100)
        return (before - self.model.ramp.speed) * 10

    def ends_in(self, state: State) -> None:
        self.run(3000)
        assert (self.model.state, self.model.ramp.speed) == (state, 0.0)


@pytest.mark.parametrize("code", [1, 2, 3, 5, 6, 7])
def test_quick_stop_brakes_by_605ah_and_leaves_quick_stop_active_below_5(code: int) -> None:
    bench = Bench(0x605A, code)
    bench.command(0x02)
    assert bench.rate() == pytest.approx(RAMPS[(code - 1) % 4 + 1])
    assert bench.model.state is State.QUICK_STOP_ACTIVE
    bench.ends_in(State.QUICK_STOP_ACTIVE if code > 4 else State.SWITCH_ON_DISABLED)


@pytest.mark.parametrize(
    ("option", "word", "state"),
    [
        (0x605A, 0x02, State.SWITCH_ON_DISABLED),
        (0x605B, 0x06, State.READY_TO_SWITCH_ON),
        (0x605C, 0x07, State.SWITCHED_ON),
        (0x605D, 0x0F | HALT, State.SWITCH_ON_DISABLED),
    ],
)
@pytest.mark.parametrize("mode", [Mode.VELOCITY, Mode.POSITION])
def test_option_code_0_frees_the_motor(option: int, word: int, state: State, mode: int) -> None:
    bench = Bench(option, 0, mode)
    bench.command(word)
    assert bench.rate() == pytest.approx(COAST_DECELERATION)
    assert bench.model.state is state
    bench.ends_in(state)


@pytest.mark.parametrize(
    ("option", "word", "state"),
    [(0x605B, 0x06, State.READY_TO_SWITCH_ON), (0x605C, 0x07, State.SWITCHED_ON)],
)
@pytest.mark.parametrize("mode", [Mode.VELOCITY, Mode.POSITION])
def test_shutdown_and_disable_operation_by_code_1_brake_in_operation_enabled(
    option: int, word: int, state: State, mode: int
) -> None:
    bench = Bench(option, 1, mode)
    bench.command(word)
    assert bench.rate() == pytest.approx(RAMPS[1])
    assert bench.model.state is State.OPERATION_ENABLED
    bench.ends_in(state)


def test_enable_operation_ends_a_slow_down_before_its_end() -> None:
    bench = Bench(0x605B, 1)
    bench.command(0x06)
    bench.run(300)
    bench.command(0x0F)
    bench.run(2000)
    assert (bench.model.state, bench.model.ramp.speed) == (State.OPERATION_ENABLED, 3000)


def test_enable_input_that_falls_is_disable_operation_by_605ch() -> None:
    bench = Bench(0x605C, 1)
    bench.model.set_enable_input(False)
    assert bench.rate() == pytest.approx(RAMPS[1])
    bench.command(0x1F)
    bench.ends_in(State.SWITCHED_ON)


@pytest.mark.parametrize("word", [0x00, 0x02])
def test_other_stops_replace_a_slow_down_of_shutdown(word: int) -> None:
    bench = Bench(0x605B, 1)
    bench.command(0x06)
    bench.command(word)
    assert bench.rate() == pytest.approx(RAMPS[2] if word else COAST_DECELERATION)
    bench.ends_in(State.SWITCH_ON_DISABLED)


@pytest.mark.parametrize("code", [1, 2, 3])
@pytest.mark.parametrize("mode", [Mode.VELOCITY, Mode.POSITION])
def test_halt_brakes_by_605dh_and_stays_in_operation_enabled(code: int, mode: int) -> None:
    bench = Bench(0x605D, code, mode)
    bench.command(0x0F | HALT)
    assert bench.rate() == pytest.approx(RAMPS[code])
    bench.ends_in(State.OPERATION_ENABLED)


@pytest.mark.parametrize("code", [0, 1, 2, 3])
def test_fault_reaction_brakes_by_605eh_and_ends_in_fault(code: int) -> None:
    bench = Bench(0x605E, code)
    bench.model.inject(10)
    bench.run(1)
    assert bench.rate() == pytest.approx(RAMPS.get(code, COAST_DECELERATION))
    assert bench.model.state is (State.FAULT_REACTION_ACTIVE if code else State.FAULT)
    bench.ends_in(State.FAULT)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("code", [0, 1, 2, 3])
def test_lost_master_is_the_event_of_6007h_in_every_state(state: State, code: int) -> None:
    bench = drive_in(state)
    assert bench.write(0x6007, 0, code) == 0
    bench.node.receive(0, bytes((NmtCommand.STOP, NODE)), bench.now)
    command = {2: Command.DISABLE_VOLTAGE, 3: Command.QUICK_STOP}.get(code)
    expected = next_state(state, command.word, 0) if command else state
    if code == 1 and state is not State.FAULT:
        expected = State.FAULT_REACTION_ACTIVE
    assert bench.model.state is expected


@pytest.mark.parametrize("index", OPTION_CODES)
def test_values_that_are_not_simulated_are_refused_and_change_nothing(index: int) -> None:
    bench = Bench()
    low, high = limits(index)
    before = bench.node.read(index)
    assert bench.write(index, 0, low - 1) == Abort.VALUE_TOO_LOW
    assert bench.write(index, 0, high + 1) == Abort.VALUE_TOO_HIGH
    for code in set(range(low, high + 1)) - OPTION_CODES[index].actions.keys():
        assert bench.write(index, 0, code) == Abort.VALUE_RANGE
    assert bench.node.read(index) == before


@pytest.mark.parametrize("name", SHAPES)
def test_every_variant_takes_no_other_option_code_than_it_simulates(name: str) -> None:
    node = SimulatedDriveNode(NODE, lambda *_: None, shape=shape(name))
    for index in OPTION_CODES.keys() & node.indices:
        low, high = node.entries[index, 0].limits
        assert limits(index)[0] <= low <= VALUES[index, 0].default <= high <= limits(index)[1]


def test_fault_reset_that_needs_time_is_reported_once() -> None:
    bench = Bench()
    bench.node.start_fault("fault-reset-late", delay_ms=100)
    bench.model.inject(10)
    bench.run(3000)
    bench.model.clear()
    bench.frames.clear()
    for word in (0x80, 0x00, 0x06):
        bench.node.set_data(0x6040, 0, word.to_bytes(2, "little"), check_writable=True)
        bench.run(20)
    assert bench.model.state is State.FAULT
    bench.run(100)
    assert bench.model.state is State.SWITCH_ON_DISABLED
    assert bench.sent(0x80 + NODE) == [bytes(8)]


def test_fault_reset_edge_is_lost_while_the_cause_is_present() -> None:
    bench = Bench()
    bench.model.inject(10)
    bench.run(3000)
    bench.command(0x80)
    bench.model.clear()
    bench.run(100)
    assert bench.model.state is State.FAULT
    bench.command(0x00)
    bench.run(100)
    assert bench.model.state is State.FAULT
    bench.command(0x80)
    assert bench.model.state is State.SWITCH_ON_DISABLED
