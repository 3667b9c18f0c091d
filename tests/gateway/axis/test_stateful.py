"""Random commands on the simulated drive against rules in an engineer's words: power, and tasks of telegram 9."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, State
from pdgw.gateway.axis.demand_report import SHOWN_STATE
from pdgw.gateway.axis.power_states import Phase
from pdgw.peers.drive import Latency
from pdgw.profidrive.telegrams import TELEGRAMS, telegram
from tests.support.axis.hand import ON
from tests.support.axis.rig import Rig
from tests.support.axis.strategies import latencies
from tests.support.axis.tasks import ACTIVATE, HOMING, INTERMEDIATE, POSITION, REJECT

# -- power, with random PLC words, drive events and losses --------------------------------------------------------


POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
STATE_BITS = 0x4F

WORDS = st.one_of(
    st.sampled_from([0x047E, 0x047F, 0x043E, 0x043F, 0x0477, 0x047A, 0x047C, 0x04FE, 0x04FF, 0x007F, 0x0000]),
    st.integers(0, 0xFFFF),
)


class GatewayMachine(RuleBasedStateMachine):
    """One axis; the PLC is written from the telegram's own signals."""

    def __init__(self) -> None:
        super().__init__()
        self.rig: Rig | None = None
        self.plc = True
        self.off_seen = False
        """An OFF was seen in the present connection since the last reason not to start."""
        self.on_edge = False
        self.was_powered = False

    @initialize(number=st.sampled_from([1, 2, 9]), modulo=st.booleans())
    def power_up(self, number: int, modulo: bool) -> None:
        self.rig = Rig(number, modulo_axis=modulo)

    def cycle(self, count: int = 1) -> None:
        assert self.rig is not None
        for _ in range(count):
            self.rig.step(plc=self.plc)
            word = self.rig.values["STW1"]
            if not self.plc:
                self.off_seen = self.on_edge = False
            elif word & 0x400:
                if word & 0x07 == 0x06:
                    self.off_seen = True
                    self.on_edge = False
                elif word & 0x07 == 0x07 and self.off_seen:
                    self.on_edge = True
            self.watch_the_power_stage()

    def watch_the_power_stage(self) -> None:
        assert self.rig is not None
        powered = self.rig.state is State.OPERATION_ENABLED
        if powered and not self.was_powered:
            assert self.plc, "the power stage went on without a PLC"
            assert self.on_edge, "the power stage went on without OFF -> ON in the present connection"
        self.was_powered = powered

    @rule(word=WORDS, data=st.data(), cycles=st.integers(1, 8))
    def plc_writes(self, word: int, data: st.DataObject, cycles: int) -> None:
        assert self.rig is not None
        half = self.rig.stepper.telegram.setpoints
        values = {s.name: data.draw(st.integers(*s.type.integer_range)) for s in half.signals[1:]}
        self.rig.values |= {**values, "STW1": word}
        self.cycle(cycles)

    @rule(speed=st.integers(-0x4000, 0x4000))
    def plc_enables_and_moves(self, speed: int) -> None:
        assert self.rig is not None
        off = 0x043E if self.rig.stepper.telegram.number == 9 else 0x047E
        self.rig.values["STW1"] = off
        self.cycle(4)
        self.rig.values["STW1"] = off | 1
        name = {1: "NSOLL_A", 2: "NSOLL_B", 9: "MDI_TARPOS"}[self.rig.stepper.telegram.number]
        self.rig.values[name] = speed if name == "NSOLL_A" else speed << 16
        self.cycle(4)
        if name == "MDI_TARPOS":
            self.rig.values |= {"SATZANW": 0x8000, "MDI_VELOCITY": 1 << 30, "MDI_ACC": 9000, "MDI_DEC": 9000}
            self.rig.values["STW1"] |= 0x40
            self.cycle(3)
            self.rig.values["STW1"] &= ~0x40
        self.cycle(30)

    @rule(method=st.sampled_from([35, 17, 3]))
    def plc_homes(self, method: int) -> None:
        assert self.rig is not None
        if self.rig.stepper.telegram.number == 9:
            self.rig.values |= {"SATZANW": 0x8000 | method, "MDI_VELOCITY": 1 << 30}
            self.rig.values["STW1"] |= 0x800
            self.cycle(20)
            self.rig.values["STW1"] &= ~0x800
            self.cycle(2)

    @rule()
    def plc_is_lost(self) -> None:
        """After loss of the PLC the drive comes to standstill, and stays there."""
        assert self.rig is not None
        self.plc = False
        for _ in range(400):
            self.cycle()
            if self.at_standstill():
                break
        self.cycle(20)
        assert self.at_standstill()

    def at_standstill(self) -> bool:
        assert self.rig is not None
        return abs(self.rig.node.model.velocity_actual) <= 60 and self.rig.state not in POWERED

    @rule()
    def plc_returns(self) -> None:
        self.plc = True

    @rule(number=st.integers(1, 12))
    def drive_faults(self, number: int) -> None:
        assert self.rig is not None
        self.rig.node.model.inject(number)
        self.off_seen = self.on_edge = False
        self.cycle(2)
        self.off_seen = self.on_edge = False

    @rule()
    def fault_cause_ends(self) -> None:
        assert self.rig is not None
        self.rig.node.model.clear()

    @rule(on=st.booleans())
    def enable_input(self, on: bool) -> None:
        assert self.rig is not None
        was_on = self.rig.state is State.OPERATION_ENABLED
        self.rig.node.model.set_enable_input(on)
        self.watch_the_power_stage()
        if was_on and not on:
            self.off_seen = self.on_edge = False
            self.cycle(1)
            self.off_seen = self.on_edge = False

    @precondition(lambda self: self.rig is not None and self.rig.state is State.OPERATION_ENABLED)
    @rule()
    def enable_input_bounces(self) -> None:
        """A contact that opens for a moment stops the axis for good, whatever STW1 says."""
        self.enable_input(False)
        self.enable_input(True)
        self.cycle(5)

    @precondition(lambda self: self.rig is not None and self.rig.state is State.OPERATION_ENABLED)
    @rule()
    def fault_with_a_standing_on(self) -> None:
        """Acknowledging a fault under a standing ON starts nothing."""
        assert self.rig is not None
        self.drive_faults(7)
        self.fault_cause_ends()
        self.cycle(50)
        self.rig.values["STW1"] |= 0x80
        self.cycle(4)
        self.rig.values["STW1"] &= ~0x80
        self.cycle(4)

    @rule()
    def drive_restarts(self) -> None:
        assert self.rig is not None
        self.rig.restart_drive()
        self.off_seen = self.on_edge = False

    @rule(cycles=st.integers(1, 5))
    def drive_is_silent(self, cycles: int) -> None:
        assert self.rig is not None
        self.rig.connected_drive = False
        self.cycle(cycles)
        assert self.rig.actuals["ZSW1"] & STATE_BITS == 0x08, "a lost drive is a fault"
        self.rig.connected_drive = True
        self.off_seen = self.on_edge = False

    @precondition(lambda self: self.rig is not None and bool(self.rig.actuals))
    @invariant()
    def zsw1_matches_the_drive(self) -> None:
        assert self.rig is not None
        if not self.rig.connected_drive:
            return
        self.cycle()
        expected = SHOWN_STATE[self.rig.seen_statusword & 0x7F]
        if self.rig.stepper.power.phase in {Phase.RAMP_STOP, Phase.SHUTDOWN}:
            expected = 0x03
        assert self.rig.actuals["ZSW1"] & STATE_BITS == expected

    @precondition(lambda self: self.rig is not None and bool(self.rig.actuals))
    @invariant()
    def actual_values_fit_their_types(self) -> None:
        assert self.rig is not None
        half = self.rig.stepper.telegram.actuals
        half.encode(tuple(self.rig.actuals.values()))

    @precondition(lambda self: self.rig is not None)
    @invariant()
    def commands_respect_the_drives_rules(self) -> None:
        assert self.rig is not None
        for before, after in pairwise(self.rig.controlwords):
            halt_falls = before & ControlBit.HALT and not after & ControlBit.HALT
            rises = not before & ControlBit.NEW_SETPOINT and after & ControlBit.NEW_SETPOINT
            assert not (halt_falls and rises), f"{before:04X} -> {after:04X}"
        del self.rig.controlwords[:-1]


TestGateway = GatewayMachine.TestCase
TestGateway.settings = settings(max_examples=50, stateful_step_count=25)


def test_every_drive_telegram_has_the_layout_its_machine_needs() -> None:
    for number in (1, 2, 3, 9, 20, 100):
        rig = Rig(number)
        assert len(rig.step()) == len(telegram(number).actuals.signals)
        assert number in TELEGRAMS


@pytest.mark.parametrize("number", [1, 9])
def test_an_enable_input_that_bounces_does_not_restart_the_axis(number: int) -> None:
    rig = Rig(number)
    rig.enable(0x043E if number == 9 else 0x047E)
    rig.node.model.set_enable_input(False)
    rig.step(1)
    rig.node.model.set_enable_input(True)
    rig.step(50)
    assert rig.state is State.SWITCH_ON_DISABLED


# -- tasks, with the frames to the drive compared with the rules of its guide -------------------------------------


CONTROL_BY_PLC = 0x400
CYCLES = st.integers(1, 40)


class TaskMachine(RuleBasedStateMachine):
    """An axis in operation; every cycle's Controlword and mode are judged against those of the cycle before."""

    def __init__(self) -> None:
        super().__init__()
        self.plc = True
        self.last_word: int | None = None
        self.last_controlword = 0
        self.allowed = 0
        """Edges of STW1.6, and of STW1.5 (each may resume one task), that have not started anything yet."""

    @initialize(modulo=st.booleans(), sdo_delay=st.integers(1, 6), latency=latencies)
    def power_up(self, modulo: bool, sdo_delay: int, latency: Latency) -> None:
        self.rig = Rig(9, latency=latency, modulo_axis=modulo)
        self.rig.values |= {"SATZANW": 0x8023, "MDI_VELOCITY": 1 << 30, "MDI_ACC": 1 << 14, "MDI_DEC": 1 << 14}
        self.rig.sdo_delay = sdo_delay
        self.rig.enable()
        self.last_word = self.rig.values["STW1"]
        self.last_controlword = self.rig.stepper.command.controlword
        self.last_mode = self.rig.stepper.command.modes_of_operation

    def cycle(self, count: int) -> None:
        for _ in range(count):
            self.count_edges()
            self.rig.step(plc=self.plc)
            command = self.rig.stepper.command
            self.judge(command.controlword, command.modes_of_operation)

    def count_edges(self) -> None:
        word = self.rig.values["STW1"]
        if not self.plc:
            self.last_word = None
        elif word & CONTROL_BY_PLC:
            if self.last_word is not None:
                self.allowed += bin(word & ~self.last_word & (ACTIVATE | INTERMEDIATE)).count("1")
            self.last_word = word

    def judge(self, controlword: int, mode: int) -> None:
        halt = (controlword | self.last_controlword) & ControlBit.HALT
        if mode != self.last_mode:
            assert not halt, "the mode is never changed while Halt is set"
        rises = controlword & ~self.last_controlword & ControlBit.NEW_SETPOINT
        if rises:
            assert not halt, "Halt falling and a new set-point in one Controlword"
            assert mode == self.last_mode, "a command of a mode before the drive confirmed it"
            if mode != Mode.HOMING:
                self.allowed -= 1
                assert self.allowed >= 0, "a traversing task without an edge"
        self.last_controlword, self.last_mode = controlword, mode

    def operate(self) -> None:
        if self.rig.state is not State.OPERATION_ENABLED:
            for word in (ON & ~1, ON):
                self.rig.values["STW1"] = word
                self.cycle(4 + 2 * self.rig.late_cycles)

    @rule(
        goal=st.sampled_from([300_000, -300_000, 1_000]),
        mod=st.sampled_from([0, 0, 1, 1, 2, 4]),
        word=st.sampled_from([ON, ON, ON, ON & ~REJECT, ON & ~INTERMEDIATE]),
        cycles=CYCLES,
    )
    def task(self, goal: int, mod: int, word: int, cycles: int) -> None:
        self.operate()
        self.rig.values |= {
            "SATZANW": 0x8000,
            "MDI_TARPOS": POSITION.to_wire(goal),
            "MDI_MOD": mod,
            "STW1": word,
        }
        self.cycle(1)
        self.rig.values["STW1"] |= ACTIVATE
        self.cycle(cycles)

    @rule(method=st.sampled_from([35, 35, 17, -18, 99]), cycles=CYCLES)
    def homing(self, method: int, cycles: int) -> None:
        self.operate()
        self.rig.values["SATZANW"] = 0x8000 | method & 0xFF
        self.rig.values["STW1"] |= HOMING
        self.cycle(cycles)

    @rule(bits=st.sampled_from([INTERMEDIATE, ACTIVATE, REJECT, HOMING, 1, 2, 4, 8, 0x400]), cycles=CYCLES)
    def bit_falls(self, bits: int, cycles: int) -> None:
        self.rig.values["STW1"] &= ~bits
        self.cycle(cycles)

    @rule(bits=st.sampled_from([0, ACTIVATE, HOMING]), cycles=CYCLES)
    def bits_return(self, bits: int, cycles: int) -> None:
        self.rig.values["STW1"] |= ON | bits
        self.cycle(cycles)

    @rule(cycles=CYCLES)
    def mdi_off(self, cycles: int) -> None:
        self.rig.values["SATZANW"] &= ~0x8000
        self.cycle(cycles)

    @rule(cycles=CYCLES)
    def plc_is_lost(self, cycles: int) -> None:
        self.plc = False
        self.cycle(cycles)
        self.plc = True

    @rule(number=st.sampled_from([7, 11]))
    def fault(self, number: int) -> None:
        self.rig.node.model.inject(number)
        self.cycle(30)
        self.rig.node.model.clear()
        for word in (0x0400, 0x0480, 0x0400):
            self.rig.values["STW1"] = word
            self.cycle(3)

    @rule(error=st.sampled_from([None, "abort 0609 0030h"]))
    def homing_parameters(self, error: str | None) -> None:
        self.rig.sdo_error = error


TestTasks = TaskMachine.TestCase
TestTasks.settings = settings(max_examples=30, stateful_step_count=20)
