"""Telegram 9 with random commands: frames to the drive compared with the rules of its guide and one task per edge."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, State
from pdgw.peers.drive import Latency
from tests.gateway.axis.test_positioning import ACTIVATE, HOMING, INTERMEDIATE, ON, POSITION, REJECT
from tests.support.axis.rig import Rig
from tests.support.axis.strategies import latencies

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
TestTasks.settings = settings(max_examples=80, stateful_step_count=20)
