"""Status bits where masters of the market differ from a plain reading: OFF3 beside OFF2, pauses, selected modes, parking."""

from __future__ import annotations

import pytest

from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.objects.fault_buffer import FaultLog
from pdgw.profidrive.encoder import PARKED_NS, SensorInterface
from pdgw.profidrive.signals import signal
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import CYCLE_MS, Rig

ZSW1 = signal("ZSW1")
NO_QUICK_STOP, REACHED = ZSW1.bit("NO_QUICK_STOP").mask, ZSW1.bit("TARGET_REACHED").mask
STANDING = ZSW1.bit("DRIVE_STOPPED", positioning=True).mask
POS_ZSW1, POS_STW1 = signal("POS_ZSW1"), signal("POS_STW1")
MODES = POS_ZSW1.word("BLOCK_MODE", "SETTING_UP", "MDI_ACTIVE")
PARK, PARKED = signal("G1_STW").bit("PARK").mask, signal("G1_ZSW").bit("PARKED").mask
OFF, ON, TASK, PAUSE = 0x043E, 0x043F, 0x047F, 0x041F


def rig(number: int, **settings: object) -> Rig:
    made = Rig(number, positioner=CHOICES, **settings)
    made.enable()
    return made


@pytest.mark.parametrize("number", [1, 9, 102, 111])
@pytest.mark.parametrize(("word", "shown"), [(0x0438, False), (0x043A, False), (0x043C, True), (OFF, True)])
def test_zsw1_5_is_0_while_stw1_2_is_0_also_beside_a_coast_stop(number: int, word: int, shown: bool) -> None:
    made = rig(number)
    made.values["STW1"] = word
    made.step(10)
    assert bool(made.actuals["ZSW1"] & NO_QUICK_STOP) is shown


def moving(number: int, **settings: object) -> Rig:
    made = rig(number, **settings)
    if number == 9:
        made.values |= {"SATZANW": 0x8000, "MDI_MOD": 1, "MDI_TARPOS": 0x3000_0000, "MDI_VELOCITY": 0x1000_0000}
        made.values |= {"MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
    else:
        made.values |= {"POS_STW1": POS_STW1.word("MDI", "ABSOLUTE"), "MDI_TARPOS": 400_000, "MDI_VELOCITY": 6000}
        made.values |= {"OVERRIDE": 0x4000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
    made.values["STW1"] = TASK
    made.step(60)
    assert made.feedback.velocity_actual > 0
    return made


@pytest.mark.parametrize("number", [9, 111])
@pytest.mark.parametrize("reached", [False, True])
def test_an_intermediate_stop_shows_reached_only_where_configured(number: int, reached: bool) -> None:
    made = moving(number, intermediate_stop_reached=reached)
    made.values["STW1"] = PAUSE
    while not made.step()["ZSW1"] & STANDING:
        assert not made.actuals["ZSW1"] & REACHED, "it still brakes"
    assert bool(made.step(5)["ZSW1"] & REACHED) is reached
    made.values["STW1"] = TASK
    assert not made.step(20)["ZSW1"] & REACHED, "the task goes on"


@pytest.mark.parametrize(("number", "mode"), [(9, ""), (111, "ABSOLUTE"), (111, "SETTING_UP")])
def test_an_intermediate_stop_is_reached_when_an_axis_in_the_standstill_window_turns_no_more(
    number: int, mode: str
) -> None:
    made = rig(number, intermediate_stop_reached=True)
    made.values |= {"MDI_VELOCITY": 0x40_0000, "MDI_TARPOS": 0x3000_0000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
    if number == 9:
        made.values |= {"SATZANW": 0x8000, "MDI_MOD": 1}
    else:
        made.values |= {"MDI_VELOCITY": 50, "MDI_TARPOS": 400_000, "OVERRIDE": 0x4000}
        made.values["POS_STW1"] = POS_STW1.word("MDI", mode, "POSITIVE_DIRECTION")
    made.values["STW1"] = TASK
    made.step(60)
    assert made.actuals["ZSW1"] & (STANDING | REACHED) == STANDING
    made.values["STW1"] = PAUSE
    while made.step() and made.feedback.velocity_actual:
        assert not made.actuals["ZSW1"] & REACHED, "it still turns"
    assert made.step(5)["ZSW1"] & REACHED


@pytest.mark.parametrize(
    ("word", "shown"),
    [
        (0, "BLOCK_MODE"),
        (POS_STW1.word("MDI"), "MDI_ACTIVE"),
        (POS_STW1.word("MDI", "SETTING_UP"), "SETTING_UP"),
    ],
)
def test_pos_zsw1_shows_the_selected_mode_before_a_task(word: int, shown: str) -> None:
    made = Rig(111, positioner=CHOICES)
    made.values |= {"POS_STW1": word, "STW1": OFF}
    assert not made.step(4)["POS_ZSW1"] & MODES, "no mode out of operation"
    made.enable()
    assert made.step()["POS_ZSW1"] & MODES == POS_ZSW1.bit(shown).mask
    made.values["STW1"] = ON | 0x0100
    made.step(5)
    assert not made.actuals["POS_ZSW1"] & MODES, "jog is a mode of its own"


def fault(number: int, time_ns: int) -> FaultRecord:
    return FaultRecord(number, 0x1000, 0, "", time_ns)


def test_fault_code_is_the_first_fault_of_the_present_situation() -> None:
    log = FaultLog(0)
    for number, time_ns in ((105, 1000), (7, 5000), (3, 6000)):
        log.enter(fault(number, time_ns))
    assert [log.fault_code(since) for since in (0, 4000, 5500, 9000)] == [105, 7, 3, 3]
    log.acknowledge()
    assert log.fault_code(0) == 0


def test_fault_code_is_the_new_fault_after_a_full_situation() -> None:
    log = FaultLog(0)
    for number in range(101, 112):
        log.enter(fault(number, number))
    log.enter(fault(7, 5000))
    assert log.fault_code(4000) == 7


def test_equal_faults_have_one_place_and_the_drives_own_fault_always_has_one() -> None:
    log = FaultLog(0)
    for number in (*range(101, 108), *[103] * 100):
        log.enter(fault(number, 1000))
    assert log.count == 107
    assert log.buffer.counter == 7, "P944"
    log.enter(fault(7, 5000))
    assert [entry.number for entry in log.entries()[:8]] == [101, 102, 103, 104, 105, 106, 7, 0]
    assert 7 in {record.number for record in log.unacknowledged()}
    log.acknowledge()
    assert log.entries()[8 + 6].number == 7
    assert not log.unacknowledged()


def test_repeated_faults_do_not_hide_the_one_before() -> None:
    log = FaultLog(0)
    for number in (7, *[103] * 100):
        log.enter(fault(number, 5000))
    assert log.fault_code(4000) == 7
    cause = log.cause(4000)
    assert cause is not None
    assert cause.record.number == 7
    assert log.reported(present=0)[-1] == cause


def test_fault_that_returns_before_its_acknowledgement_is_the_fault_code_again() -> None:
    log = FaultLog(0)
    for number, time_ns in ((7, 1000), (103, 5000), (7, 9000)):
        log.enter(fault(number, time_ns))
    assert log.fault_code(8000) == 7
    assert [entry.number for entry in log.entries()[:3]] == [7, 103, 0]


def test_a_short_park_request_is_shown_for_100_ms() -> None:
    sensor = SensorInterface(1 << 32)
    cycle = CYCLE_MS * 1_000_000
    sensor.step(0, 5, 0)
    words = [sensor.step(PARK if n == 1 else 0, 5, n * cycle)[0] for n in range(1, 60)]
    parked = [n for n, word in enumerate(words, 1) if word & PARKED]
    assert parked == list(range(1, 1 + PARKED_NS // cycle))
