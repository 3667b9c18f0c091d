"""An ON that waits for the drive has an end (``enter_ms``), and local mode uses it up in Switched On, too."""

from __future__ import annotations

from itertools import product

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.power_states import Phase
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.base.reasons import Reason
from tests.support.axis.stepper import step_interlock

OFF, ON, DISABLED = 0x047E, 0x047F, 0x0477
"""STW1; DISABLED is ON with STW1.3 = 0."""
DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE = 0x0, 0x2, 0x6, 0x7, 0xF
STOPS = {DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN}
SETTINGS = AxisSettings()
CYCLE = 100 * MS
LATENCY = SETTINGS.latency_ns // CYCLE
ENTER = SETTINGS.enter_ns // CYCLE
"""Cycles that an ON waits."""
NOT_READY, INHIBITED, READY, SWITCHED_ON, OPERATION = (
    STATUS_OF[state] | StatusBit.REMOTE
    for state in (
        State.NOT_READY_TO_SWITCH_ON,
        State.SWITCH_ON_DISABLED,
        State.READY_TO_SWITCH_ON,
        State.SWITCHED_ON,
        State.OPERATION_ENABLED,
    )
)


class Control:
    """An interlock that has an OFF, with a drive in Ready To Switch On that has shown Statusword.9 = 1."""

    def __init__(self, settings: AxisSettings = SETTINGS) -> None:
        self.power = Interlock(settings)
        self.now = SECOND
        self.step(OFF, READY, LATENCY + 1)

    def step(self, word: int, shown: int, cycles: int = 1) -> int:
        """The Controlword after these cycles of 100 ms."""
        for _ in range(cycles):
            self.now += CYCLE
            sent = step_interlock(self.power, word, shown, self.now)
        return sent

    def starts(self, word: int = ON) -> bool:
        """Whether a drive that follows at once enters operation."""
        return [self.step(word, shown) for shown in (READY, SWITCHED_ON, OPERATION)] == [SWITCH_ON, ENABLE, ENABLE]


@pytest.mark.parametrize("word", [ON, DISABLED])
def test_supply_that_returns_after_the_time_of_an_on_starts_nothing(word: int) -> None:
    control = Control()
    assert control.step(word, READY, ENTER) == SWITCH_ON
    assert control.step(word, READY) == SHUTDOWN
    assert control.power.reason is Reason.INHIBITED
    for shown in (READY, SWITCHED_ON, READY, SWITCHED_ON):
        assert control.step(ON, shown, 600) == DISABLE_VOLTAGE
        assert control.power.reason is Reason.NEEDS_OFF
    control.step(OFF, READY)
    assert control.starts()


@pytest.mark.parametrize("word", [ON, DISABLED])
def test_drive_that_is_switched_on_when_the_time_is_over_does_not_start(word: int) -> None:
    control = Control()
    control.step(word, READY, ENTER)
    assert control.step(ON, SWITCHED_ON) == SHUTDOWN
    assert control.step(ON, SWITCHED_ON) == DISABLE_VOLTAGE


def test_contactor_that_closes_within_the_time_of_an_on_starts_the_drive() -> None:
    control = Control()
    control.step(ON, READY, ENTER - 2)
    assert control.starts()


def test_drive_switched_on_without_stw1_3_waits_as_long_as_the_plc_likes() -> None:
    control = Control()
    control.step(DISABLED, READY)
    assert control.step(DISABLED, SWITCHED_ON, 100 * ENTER) == SWITCH_ON
    assert control.step(ON, SWITCHED_ON) == ENABLE


def test_time_of_an_on_begins_again_when_the_drive_falls_from_switched_on() -> None:
    control = Control()
    control.step(DISABLED, READY, ENTER - 1)
    control.step(DISABLED, SWITCHED_ON, ENTER)
    assert control.step(DISABLED, READY, ENTER) == SWITCH_ON
    assert control.step(DISABLED, READY) == SHUTDOWN


def test_stw1_3_does_not_begin_the_time_of_an_on_again() -> None:
    control = Control()
    for word in (DISABLED, ON) * (ENTER // 2):
        assert control.step(word, READY) == SWITCH_ON
    assert control.step(DISABLED, READY) == SHUTDOWN


def test_second_off_begins_the_time_of_an_on_again() -> None:
    control = Control()
    for _ in range(3):
        assert control.step(ON, READY, ENTER) == SWITCH_ON
        assert control.step(OFF, READY) == SHUTDOWN
    assert control.starts()


def test_drive_that_tests_itself_repeatedly_does_not_start() -> None:
    """A state that changes does not begin the time of an ON again."""
    control = Control()
    assert control.step(ON, READY, ENTER // 2) == SWITCH_ON
    for shown in (NOT_READY, READY, INHIBITED, READY, SWITCHED_ON):
        assert control.step(ON, shown) in STOPS


@pytest.mark.parametrize("enter_ms", [1000, 60_000])
def test_enter_ms_is_the_time_of_an_on(enter_ms: int) -> None:
    control = Control(AxisSettings(enter_ns=enter_ms * MS))
    assert control.step(ON, READY, enter_ms * MS // CYCLE) == SWITCH_ON
    assert control.step(ON, READY) == SHUTDOWN


def test_slow_answers_of_a_drive_make_the_time_of_an_on_longer() -> None:
    """No ON ends before the drive could have shown that it follows."""
    settings = AxisSettings(reaction_ns=2 * SETTINGS.enter_ns)
    control = Control(settings)
    assert control.step(ON, READY, settings.latency_ns // CYCLE) == SWITCH_ON
    assert control.step(ON, READY) == SHUTDOWN


# -- local mode ---------------------------------------------------------------------------------------------------


def local(shown: int) -> int:
    """The same state in local mode."""
    return shown & ~StatusBit.REMOTE


@pytest.mark.parametrize("cycles", [1, 10, 90, 600])
@pytest.mark.parametrize("before", [DISABLED, ON])
@pytest.mark.parametrize("ended", [READY, SWITCHED_ON])
def test_end_of_local_mode_in_switched_on_starts_nothing_while_on_is_kept(cycles: int, before: int, ended: int) -> None:
    control = Control()
    control.step(DISABLED, READY)
    control.step(before, SWITCHED_ON)
    control.step(before, local(SWITCHED_ON))
    assert control.step(ON, local(SWITCHED_ON), cycles) == QUICK_STOP
    assert control.power.phase is Phase.UNCONFIRMED, "Enable Operation may be on its way"
    for shown in (ended, SWITCHED_ON, ended):
        assert control.step(ON, shown) in STOPS
        assert control.power.reason is Reason.NEEDS_OFF
    control.step(OFF, READY)
    assert control.starts()


def test_on_of_a_drive_in_local_mode_has_its_reason() -> None:
    control = Control()
    control.step(DISABLED, READY)
    control.step(DISABLED, local(SWITCHED_ON))
    control.step(ON, local(SWITCHED_ON))
    assert control.power.reason is Reason.LOCAL_MODE


def test_stw1_3_that_rises_after_local_mode_starts_the_drive() -> None:
    control = Control()
    control.step(DISABLED, READY)
    control.step(DISABLED, SWITCHED_ON)
    assert control.step(DISABLED, local(SWITCHED_ON), 600) == SWITCH_ON
    control.step(DISABLED, SWITCHED_ON)
    assert control.step(ON, SWITCHED_ON) == ENABLE


def test_no_word_after_local_mode_in_switched_on_starts_a_drive_while_on_is_kept() -> None:
    """Every sequence of five Statuswords after one with Statusword.9 = 0."""
    words = [f(shown) for shown in (INHIBITED, READY, SWITCHED_ON) for f in (local, lambda word: word)]
    for shown in product(words, repeat=5):
        control = Control()
        control.step(DISABLED, READY)
        control.step(ON, local(SWITCHED_ON))
        assert {control.step(ON, word) for word in shown} <= STOPS, shown


def test_drive_that_shows_statusword_9_from_switched_on_starts_as_any() -> None:
    """Its bit may fall before the state does, and 0 below Switched On is no local mode."""
    control = Control()
    control.power.restarted()
    control.step(OFF, local(READY), LATENCY + 1)
    for _ in range(3):
        assert control.step(DISABLED, local(READY)) == SWITCH_ON
        assert control.step(DISABLED, SWITCHED_ON, LATENCY + 1) == SWITCH_ON
        assert control.step(ON, SWITCHED_ON) == ENABLE
        assert control.step(ON, OPERATION) == ENABLE
        for shown in (OPERATION, SWITCHED_ON, local(SWITCHED_ON), local(READY)):
            control.step(DISABLED, shown)
        control.step(OFF, local(READY))
