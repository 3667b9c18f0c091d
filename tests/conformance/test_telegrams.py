"""Every bit of the motion telegrams, and properties of every telegram of a drive with values of hypothesis."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from pdgw.dsp402.states import State
from pdgw.gateway.axis.supervision.drive_events import POWERED
from pdgw.gateway.configuration.file import simulated
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, telegram
from tests.conformance.rig import COMPLETE, DriveRig
from tests.conformance.shared_bits import NUMBERS, walk
from tests.conformance.telegram_bits import CASES, Case, enabled, gateway, run_case
from tests.support.axis.strategies import half_values
from tests.support.gateways.daemon import drive_of, running

# -- bits one by one, none of a word forgotten --------------------------------------------------------------------


NOT_EVALUATED = {"REFERENCE_CAM", "HOMING_NEGATIVE", "PROBE_2", "PROBE_FALLING_EDGE", "HARDWARE_LIMITS"}
"""Bits without an effect that a simulated drive could show (docs/motion.md)."""
WITHOUT_CASE = {
    "bits of the device": {f"{word}.DEVICE_{place}" for word in ("STW1", "ZSW1") for place in range(11, 16)},
    "no function here: 0, or ignored": {
        *(f"{word}.{bit}" for word in ("POS_STW", "POS_STW2") for bit in NOT_EVALUATED),
        *("STW1.OPEN_BRAKE", "ZSW1.ACCELERATES", "ZSW1.DECELERATES", "POS_ZSW2.CAM_1", "POS_ZSW2.CAM_2"),
        *("G1_STW.PRESET_RELATIVE", "G1_ZSW.PRESET_DONE", "G1_ZSW.PROBE_1", "G1_ZSW.PROBE_2"),
    },
    "needs blocks with outputs, a stop or switches that the simulated axis does not have; tests of their own": {
        *(f"POS_ZSW2.{bit}" for bit in ("OUTPUT_1", "OUTPUT_2", "FIXED_STOP_REACHED", "CLAMPING_TORQUE_REACHED")),
        *("POS_ZSW2.TO_FIXED_STOP", "STW2.TO_FIXED_STOP", "ZSW2.TO_FIXED_STOP"),
        *("POS_ZSW1.NEGATIVE_HARDWARE_LIMIT", "POS_ZSW1.POSITIVE_HARDWARE_LIMIT"),
    },
    "of a motion under way, seen by other cases": {
        *("ZSW1.WITHIN_TOLERANCE", "ZSW1.TARGET_REACHED", "MELDW.RAMP_COMPLETED", "AKTSATZ.MDI_ACTIVE"),
        *("STW1.DO_NOT_REJECT", "STW1.NO_INTERMEDIATE_STOP"),
        *(f"MDI_MOD.{bit}" for bit in ("ABSOLUTE", "POSITIVE_DIRECTION", "NEGATIVE_DIRECTION")),
    },
}
"""Bits no case is about, in one telegram or all, by the reason."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.title)
def test_each_command_bit_is_visible_on_both_sides(case: Case) -> None:
    run_case(case)


@pytest.mark.parametrize("word", ["POS_STW1", "POS_STW2"])
def test_every_bit_of_the_positioner_has_a_case(word: str) -> None:
    asked = {case.bit.split(" ")[0] for case in CASES if case.word == word}
    assert {bit.name for bit in signal(word).bits} <= asked | NOT_EVALUATED


@pytest.mark.parametrize("number", NUMBERS if COMPLETE else (103, 106, 110, 111))
def test_shared_bits_are_visible_in_each_telegram(number: int, subtests: pytest.Subtests) -> None:
    """The other telegrams have a part of the bits of these (``make conformance`` has them too)."""
    with gateway(number) as plc:
        plc.run_steps(enabled(number)[:1])
        for case in walk(number):
            with subtests.test(f"{case.title}: {case.did}"):
                plc.check(case)


@pytest.mark.parametrize("number", NUMBERS)
def test_every_bit_of_every_word_has_a_case_or_a_reason_why_not(number: int) -> None:
    chosen = telegram(number)
    positioning = chosen.setpoints.mode is ApplicationMode.POSITIONING
    bits = {
        f"{item.name}.{bit.name}"
        for half in (chosen.setpoints, chosen.actuals)
        for item in half.signals
        for bit in item.fields(positioning=positioning)
    }
    asked: set[str] = set()
    for case in (*(case for case in CASES if case.telegram == number), *walk(number)):
        asked.add(f"{case.word}.{case.bit.split(' ')[0]}")
        for step in case.steps:
            asked |= {*step.get("set", ()), *step.get("expect", ())}
    assert bits - asked <= set().union(*WITHOUT_CASE.values())


def test_case_that_sees_something_else_fails() -> None:
    case = next(case for case in CASES if case.on_can)
    with pytest.raises(AssertionError, match="607Ah"):
        run_case(replace(case, on_can={"607Ah": 1}))


# -- OFF and ON with any setpoints (``make conformance`` tries more) ----------------------------------------------


_DRIVES = [number for number, item in TELEGRAMS.items() if item.mode is not ApplicationMode.ENCODER]
DRIVES = _DRIVES if COMPLETE else [1, 9, 20, 100, 103, 106, 111, 112]
"""Without ``make conformance`` those of each executor with the most signals."""
EXAMPLES = settings(max_examples=100 if COMPLETE else 2, phases=[Phase.generate])
"""Not shrunk: that takes minutes."""
_ON = 0x0001


def frames(number: int) -> st.SearchStrategy[list[tuple[dict[str, int], int]]]:
    """Setpoints of a telegram, each with its number of cycles. Half of the control words leave the axis enabled."""
    half = telegram(number).setpoints
    enabled = 0x0F if number == 100 else 0x047F
    words = st.just(enabled) | st.integers(0, 0xFFFF)
    values = st.tuples(half_values(half), words).map(lambda drawn: half.as_dict((drawn[1], *drawn[0][1:])))
    return st.lists(st.tuples(values, st.integers(1, 50)), min_size=1, max_size=5)


@pytest.mark.parametrize("number", [number for number in DRIVES if number != 100])
@EXAMPLES
@given(data=st.data())
def test_no_setpoints_start_a_drive_without_off(number: int, data: st.DataObject) -> None:
    with running(simulated([number])) as daemon:
        rig = DriveRig(daemon, drive_of(daemon))
        for values, cycles in data.draw(frames(number)):
            rig.plc.set(0, values | {rig.word: values[rig.word] | _ON})
            rig.cycles(cycles)
        rig.online()
        rig.run_out()
        assert not [state for state, _ in rig.states if state in POWERED]


@pytest.mark.parametrize("number", DRIVES)
@EXAMPLES
@given(data=st.data())
def test_off_stops_and_on_starts_a_drive_after_any_setpoints(number: int, data: st.DataObject) -> None:
    with running(simulated([number])) as daemon:
        rig = DriveRig(daemon, drive_of(daemon))
        rig.enable()
        for values, cycles in data.draw(frames(number)):
            rig.plc.set(0, values)
            rig.cycles(cycles)
        rig.plc.set(0, dict.fromkeys(rig.plc.endpoint.setpoints[0], 0))
        rig.off()
        rig.until(lambda: rig.standing() and rig.model.state not in POWERED, "OFF obeyed")
        rig.enable()
        rig.run_out()
        assert rig.standing()
        assert rig.model.state is State.OPERATION_ENABLED
