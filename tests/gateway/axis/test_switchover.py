"""Another controller takes over with any words in any state of the drive: it starts nothing before its own OFF and ON."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import pytest

from pdgw.dsp402.states import State
from pdgw.gateway.axis.telegrams import DSC_TELEGRAM_NUMBERS, drive_telegram
from pdgw.gateway.links.confirmation import Orders
from pdgw.gateway.motion.dsc import DscChoices, DscForm
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import Rig

OFF, ON = 0x047E, 0x047F
WORDS = [
    0x0000,
    0x0400,
    OFF,
    ON,
    *(ON & ~(1 << bit) for bit in range(11)),
    ON | 0x80,
    ON | 0x100,
    ON | 0x800,
    OFF | 0x80,
    0x0C3F,
]
AWAY = (State.READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED, State.SWITCHED_ON)
VALUES = {"NSOLL_A": 0x2000, "SATZANW": 0x8000, "MDI_TARPOS": 0x0100_0000, "MDI_VELOCITY": 1 << 30, "MDI_MOD": 1}
VALUES |= {"MDI_ACC": 0x4000, "MDI_DEC": 0x4000, "POS_STW1": 0x8100, "OVERRIDE": 0x4000}


def step(rig: Rig, word: int, cycles: int) -> None:
    rig.values["STW1"] = word
    rig.step(cycles)


def enabled(rig: Rig) -> None:
    rig.enable(0x043E)
    step(rig, ON, 60)


def begun(rig: Rig, *words: int) -> None:
    enabled(rig)
    for word in words:
        step(rig, word, 2)


BEFORE: dict[str, Callable[[Rig], None]] = {
    "nothing": lambda rig: step(rig, 0x0400, 3),
    "ready": lambda rig: step(rig, OFF, 6),
    "operation": enabled,
    "off1 ramp": lambda rig: begun(rig, OFF),
    "off2": lambda rig: begun(rig, 0x047D),
    "off3": lambda rig: begun(rig, 0x047B),
    "disabled": lambda rig: begun(rig, ON & ~0x8),
    "locked": lambda rig: begun(rig, 0x047B, ON, ON),
}


def take_over(rig: Rig, word: int) -> bool:
    """Switch over as the link does. Return whether the new controller's command continues."""
    half = rig.stepper.telegram.setpoints
    before = half.from_dict(rig.values)
    repeats_commands = Orders(half).repeats_commands(half.from_dict({**rig.values, "STW1": word}), before)
    if not repeats_commands:
        rig.step(plc=False)
    rig.values["STW1"] = word
    return repeats_commands


@pytest.mark.parametrize("number", [1, 111])
@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("word", WORDS, ids=lambda word: f"{word:04X}h")
def test_a_switchover_starts_no_drive_in_any_state(number: int, before: str, word: int) -> None:
    switch_over(Rig(number, positioner=CHOICES), before, word)


@pytest.mark.parametrize("form", DscForm)
@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("word", [0x0000, OFF, ON, ON & ~0x8, ON | 0x80], ids=lambda word: f"{word:04X}h")
def test_a_switchover_starts_no_drive_with_dsc(form: DscForm, before: str, word: int) -> None:
    rig = Rig(105, dsc=DscChoices(form, following_window=4096))
    rig.values["KPC"] = 1000
    switch_over(rig, before, word)


@pytest.mark.parametrize("number", DSC_TELEGRAM_NUMBERS)
def test_dsc_continues_unchanged_over_a_switchover(number: int) -> None:
    """One executor has all of them, and their words are compared as those of telegram 1."""
    assert drive_telegram(number) == drive_telegram(105)

    def repeats_commands(of: int, new: int, old: int) -> bool:
        half = telegram(of).setpoints
        zero = dict.fromkeys(half.names, 0)
        return Orders(half).repeats_commands(
            half.from_dict({**zero, "STW1": new}), half.from_dict({**zero, "STW1": old})
        )

    for new, old in product(WORDS, WORDS):
        assert repeats_commands(number, new, old) == repeats_commands(1, new, old), (new, old)


def switch_over(rig: Rig, before: str, word: int) -> None:
    rig.values |= {name: value for name, value in VALUES.items() if name in rig.values}
    BEFORE[before](rig)
    old = rig.values["STW1"]
    operated = rig.state is State.OPERATION_ENABLED
    repeats_commands = take_over(rig, word)
    if repeats_commands and (operated or word == old):
        return
    controlwords = len(rig.controlwords)
    if not operated:
        rig.step(100)
        enables = [item for item in rig.controlwords[controlwords:] if item & 0xF == 0xF]
        assert not enables, "no Enable Operation"
        assert rig.state is not State.OPERATION_ENABLED
    else:
        for _ in range(250):
            rig.step()
            if rig.state in AWAY:
                break
        rig.step(20)
        assert rig.state in AWAY, "stopped"
        step(rig, OFF, 50)
        step(rig, ON, 50)
        assert rig.state is State.OPERATION_ENABLED, "after its own OFF and ON"


@pytest.mark.parametrize("number", [1, 111])
@pytest.mark.parametrize("bit", range(16))
def test_switchover_passes_stops_but_no_rising_bits(number: int, bit: int) -> None:
    half = Rig(number, positioner=CHOICES).stepper.telegram.setpoints
    zero = dict.fromkeys(half.names, 0)
    orders = Orders(half)

    def repeats_commands(new: int, old: int) -> bool:
        return orders.repeats_commands(half.from_dict({**zero, "STW1": new}), half.from_dict({**zero, "STW1": old}))

    assert not repeats_commands(ON | 1 << bit, ON & ~(1 << bit))
    stops = {0, 1, 2, 3, 4, 5, 10} | ({6, 8, 9} if number == 1 else set())
    assert repeats_commands(0xFFFF & ~(1 << bit), 0xFFFF) == (bit in stops - ({4, 5, 6} if number == 1 else set()))
    assert repeats_commands(ON & ~(1 << bit), ON) == (bit in stops or not ON & 1 << bit)
