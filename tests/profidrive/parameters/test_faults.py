"""The fault buffer against a plain model."""

from __future__ import annotations

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from pdgw.profidrive.parameters.faults import SIZE, Fault, FaultBuffer


class FaultBufferMachine(RuleBasedStateMachine):
    """The model is a plain list of 64 places."""

    def __init__(self) -> None:
        super().__init__()
        self.buffer = FaultBuffer()
        self.model: list[Fault | None] = [None] * SIZE
        self.changes = 0

    @rule(number=st.integers(1, 111))
    def fault(self, number: int) -> None:
        fault = Fault(number, 0x1000 + number, 0, self.changes)
        self.buffer.enter(fault)
        self.changes += 1
        for place in range(8):
            if self.model[place] is None:
                self.model[place] = fault
                break

    @rule()
    def acknowledge(self) -> None:
        self.buffer.acknowledge()
        if self.model[0] is not None:
            self.model = [None] * 8 + self.model[:-8]
            self.changes += 1

    @rule()
    def clear(self) -> None:
        self.buffer.clear()
        if any(self.model):
            self.model = [None] * SIZE
            self.changes += 1

    @invariant()
    def buffer_equals_the_model(self) -> None:
        assert [self.buffer.entry(n) for n in range(SIZE)] == self.model
        assert self.buffer.situations == sum(self.model[n] is not None for n in range(0, SIZE, 8))
        assert self.buffer.counter == self.changes % 65536


TestFaultBuffer = FaultBufferMachine.TestCase


def test_a_ninth_fault_is_counted_and_the_first_eight_stay() -> None:
    buffer = FaultBuffer()
    for number in range(1, 10):
        buffer.enter(Fault(number, 0, 0, 0))
    assert [buffer.entry(n) and buffer.entry(n).number for n in range(8)] == list(range(1, 9))  # type: ignore[union-attr]
    assert buffer.counter == 9


def test_a_fault_that_may_take_fewer_places_leaves_the_others() -> None:
    buffer = FaultBuffer()
    for number in range(1, 5):
        buffer.enter(Fault(number, 0, 0, 0), places=2)
    buffer.enter(Fault(9, 0, 0, 0))
    assert [fault.number for n in range(8) if (fault := buffer.entry(n))] == [1, 2, 9]
    assert buffer.counter == 5


def test_the_eldest_situation_falls_out_after_eight_acknowledgements() -> None:
    buffer = FaultBuffer()
    for number in range(1, 10):
        buffer.enter(Fault(number, 0, 0, 0))
        buffer.acknowledge()
    numbers = [fault.number for n in range(0, SIZE, 8) if (fault := buffer.entry(n))]
    assert numbers == [9, 8, 7, 6, 5, 4, 3]
