"""The safety rules: each is broken by its own record, and by no other."""

from __future__ import annotations

import pickle

import pytest

from pdgw.dsp402.states import State
from tests.long.rules import (
    ZSW1_ACKNOWLEDGED,
    ZSW1_HOME_SET,
    ZSW1_OPERATION,
    ZSW1_REACHED,
    Rule,
    Seen,
    broken,
)

DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN = 0x0, 0x2, 0x6
BREAKS = {
    Rule.ON: Seen(energizes=True, on=False),
    Rule.RELEASED: Seen(energizes=True, released=False),
    Rule.KEPT: Seen(held=True, may_hold=False),
    Rule.RAMP: Seen(SHUTDOWN, ramps=True),
    Rule.OFF2: Seen(QUICK_STOP, off2=True),
    Rule.OFF3: Seen(SHUTDOWN, off3=True),
    Rule.LATCH: Seen(DISABLE_VOLTAGE, quick_stops=True, may_coast=False),
    Rule.UNKNOWN: Seen(SHUTDOWN, None),
    Rule.STOPS: Seen(age=2, bound=1),
    Rule.MOVES: Seen(moves=True, ordered=False),
    Rule.OPERATES: Seen(zsw1=ZSW1_OPERATION, operates=False),
    Rule.FAULT: Seen(state=State.FAULT),
    Rule.REACHED: Seen(zsw1=ZSW1_REACHED, follows=False),
    Rule.ACKNOWLEDGED: Seen(zsw1=ZSW1_ACKNOWLEDGED, accepted=False),
    Rule.HOMED: Seen(zsw1=ZSW1_HOME_SET, homed=False),
    Rule.HOMES: Seen(zsw1=ZSW1_HOME_SET, homes=True),
    Rule.REASON: Seen(refused=True),
    Rule.WAITS: Seen(waits=True),
    Rule.GUARD: Seen(guarded=True),
    Rule.RESET: Seen(resets=True, acknowledges=False),
    Rule.LATE: Seen(overdue=True),
    Rule.NEEDLESS: Seen(brake=1),
    Rule.WITHHELD: Seen(brake=1, braked=1, unstopped=True),
    Rule.BRAKE: Seen(braked=1, off=False),
    Rule.STORED: Seen(unstored=True),
    Rule.RETURNS: Seen(stuck=True),
    Rule.FOLLOWS: Seen(apart=True),
    Rule.CALM: Seen(reported=True),
    Rule.RUNS: Seen(stopped=True),
    Rule.ALLOWED: Seen(denied=True),
}


@pytest.mark.parametrize("rule", Rule)
def test_each_rule_is_broken_by_its_own_record_alone(rule: Rule) -> None:
    assert broken(BREAKS[rule]) == [rule]


@pytest.mark.parametrize(
    "seen",
    [
        Seen(),
        Seen(DISABLE_VOLTAGE, off2=True, off3=True, quick_stops=True),
        Seen(QUICK_STOP, None, off3=True, quick_stops=True, may_coast=False),
        Seen(DISABLE_VOLTAGE, State.READY_TO_SWITCH_ON, off3=True, may_coast=False),
        Seen(refused=True, waits=True, reason=True),
        Seen(brake=2, braked=1, unstopped=True, overdue=True),
        Seen(brake=1, continues=True),
    ],
)
def test_stop_with_its_command_and_refusal_with_its_reason_break_no_rule(seen: Seen) -> None:
    assert broken(seen) == []


def test_a_walk_in_another_process_can_name_the_broken_rule() -> None:
    assert pickle.loads(pickle.dumps(Rule.STOPS)) is Rule.STOPS
