"""Telegrams with positions: each bit that is 1 and starts nothing is named.

The oracle is a second run in which the bit is 0 from its last rise on: if the drive is commanded the same, it had no effect.
"""

from __future__ import annotations

from random import Random

import pytest

from pdgw.dsp402.states import State
from pdgw.gateway.base.reasons import Enable
from pdgw.profidrive.datatypes import float_pattern
from pdgw.profidrive.signals import signal
from tests.gateway.axis.test_positioner import REFERENCES
from tests.support.axis.hand import OFF, ON
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import Rig

_STW1 = signal("STW1")
REJECT, INTERMEDIATE = 0x10, 0x20
"""STW1.4 and STW1.5; 0 rejects, or stops."""
TASK, JOG_1, JOG_2, HOMING = (
    _STW1.bit(name, positioning=True).mask for name in ("ACTIVATE_TASK", "JOG_1_ON", "JOG_2_ON", "START_HOMING")
)
FUNCTIONS = {
    7: (TASK, JOG_1, JOG_2, HOMING),
    9: (TASK, HOMING),  # its jogs have a note of their own
    110: (TASK, JOG_1, JOG_2, HOMING),
    111: (TASK, JOG_1, JOG_2, HOMING),
    112: (TASK, JOG_1, JOG_2, HOMING),
}
"""Bits that start something, by telegram."""
RAMPS = {"MDI_ACC": 1 << 14, "MDI_DEC": 1 << 14}
VALUES: dict[int, dict[str, int]] = {
    7: {"SATZANW": 2},
    9: {"SATZANW": 0x8000 | 35, "MDI_MOD": 1, "MDI_TARPOS": 1 << 20, "MDI_VELOCITY": 1 << 30} | RAMPS,
    110: {"SATZANW": 0x8000, "MDI_MOD": 1, "OVERRIDE": 1 << 14, "MDI_TARPOS": 300, "MDI_VELOCITY": 6000} | RAMPS,
    111: {"POS_STW1": 0x8100, "OVERRIDE": 1 << 14, "MDI_TARPOS": 300, "MDI_VELOCITY": 6000} | RAMPS,
    112: {"POS_STW1": 0x8100, "OVERRIDE": 1 << 14}
    | {
        name: float_pattern(value)
        for name, value in {"MDI_TARPOS_F": 0.3, "MDI_VELOCITY_F": 100, "MDI_ACC_F": 100, "MDI_DEC_F": 100}.items()
    },
}
"""A short task, and homing method 35."""
REST = 250
"""Cycles without another command that are a rest: more than a homing needs to end."""
LONGEST = 1000
RUNS = 20

Word = tuple[int, int]
"""STW1 and its number of cycles."""


def rig_of(number: int) -> Rig:
    rig = Rig(number) if number == 9 else Rig(number, positioner=CHOICES)
    rig.stepper.set_references(REFERENCES, homing_method=35)
    rig.values |= VALUES[number]
    return rig


def run(number: int, words: list[Word]) -> tuple[Rig, list[tuple[int, ...]]]:
    """The commands of each cycle; the last word stays until the axis rests, or for ``LONGEST`` cycles."""
    rig, commands = rig_of(number), []
    rig.enable()
    still, (last, _) = 0, words[-1]
    for word, cycles in (*words, (last, LONGEST)):
        rig.values["STW1"] = word
        for _ in range(cycles):
            rig.step()
            command = rig.stepper.command
            commands.append(
                (command.controlword, command.modes_of_operation, command.target_position, command.target_velocity)
            )
            still = still + 1 if commands[-2:-1] == commands[-1:] and not rig.feedback.velocity_actual else 0
            if cycles == LONGEST and still > REST:
                return rig, commands
    return rig, commands


def drawn(random: Random, number: int) -> list[Word]:
    """A sequence that may begin out of operation, and ends in it without a reject or an intermediate stop."""
    words: list[Word] = []
    functions = 0
    if random.random() < 0.3:
        functions = sum(bit for bit in FUNCTIONS[number] if random.random() < 0.4)
        words += [(OFF | functions, 60), (ON | functions, 60)]
    for _ in range(random.randrange(1, 6)):
        functions ^= random.choice(FUNCTIONS[number])
        missing = random.choice((0, 0, REJECT, REJECT, INTERMEDIATE))
        words.append((ON & ~missing | functions, random.choice((1, 1, 3, 30))))
    words.append((ON | functions, 3))
    return words


def without(words: list[Word], bit: int) -> list[Word]:
    """The same with the bit at 0 since its last rise."""
    zeros = [place for place, (word, _) in enumerate(words) if not word & bit]
    first = zeros[-1] + 1 if zeros else 0
    return [(word & ~bit, cycles) if place >= first else (word, cycles) for place, (word, cycles) in enumerate(words)]


@pytest.mark.parametrize("seed", range(RUNS))
@pytest.mark.parametrize("number", FUNCTIONS)
def test_each_bit_that_is_1_without_an_effect_at_rest_is_named(number: int, seed: int) -> None:
    random = Random(f"{number} {seed}")
    words = drawn(random, number)
    rig, commands = run(number, words)
    if rig.feedback.velocity_actual or rig.state is not State.OPERATION_ENABLED:
        return
    final = words[-1][0]
    for bit in FUNCTIONS[number]:
        if final & bit and run(number, without(words, bit))[1][: len(commands)] == commands:
            reason = rig.stepper.reason
            shown = f"{[(hex(word), cycles) for word, cycles in words]}: {bit:04X}h, {reason}"
            assert reason is not None, shown
            assert reason.enable is Enable.SETPOINT, shown
            assert rig.stepper.machine.executor.ignored & bit, shown
