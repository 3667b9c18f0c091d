"""MOMRED and MELDW."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.dsp402.drive.images import DEMAND_UNKNOWN
from pdgw.gateway.motion.requests import MessageWord, reduced_torque
from pdgw.profidrive.signals import signal

WORD = MessageWord(6000)


def names(velocity: int = 0, demand: int = 0, torque: int = 0, **flags: bool) -> set[str]:
    states = WORD.states(enabled=flags.pop("enabled", False), ready=flags.pop("ready", False))
    word = WORD.word(velocity, demand, torque, states, **{"target_reached": False} | flags)
    fields = signal("MELDW").bits
    assert not word & ~sum(field.mask for field in fields)
    return {field.name for field in fields if field.of(word)}


@pytest.mark.parametrize(
    ("momred", "limit"), [(0, 3000), (0x2000, 1500), (0x4000, 0), (0x7FFF, 0), (-1, 3000), (-0x8000, 3000)]
)
def test_worked_example_102_torque_reduction(momred: int, limit: int) -> None:
    assert reduced_torque(3000, momred) == limit


@given(base=st.integers(0, 0xFFFF), momred=st.integers(-0x8000, 0x7FFF))
def test_a_reduction_only_ever_reduces(base: int, momred: int) -> None:
    assert 0 <= reduced_torque(base, momred) <= base


BELOW = {"TORQUE_BELOW_THRESHOLD", "SPEED_BELOW_THRESHOLD_3", "SPEED_BELOW_THRESHOLD_2"}
COOL = {"NO_MOTOR_OVERTEMPERATURE", "NO_POWER_STAGE_OVERTEMPERATURE"}


@pytest.mark.parametrize(
    ("values", "shown"),
    [
        ({}, {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE"}),
        ({"target_reached": True}, {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE", "RAMP_COMPLETED"}),
        ({"velocity": 61, "target_reached": True}, {*BELOW, *COOL}),
        ({"velocity": 299, "demand": 299}, {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE"}),
        (
            {"velocity": -300, "demand": -300},
            {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE"} - {"SPEED_BELOW_THRESHOLD_3"},
        ),
        ({"velocity": 1801, "demand": 1801}, {"TORQUE_BELOW_THRESHOLD", *COOL, "SPEED_WITHIN_TOLERANCE"}),
        ({"torque": -900}, {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE"} - {"TORQUE_BELOW_THRESHOLD"}),
        (
            {"enabled": True, "ready": True},
            {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE", "CONTROLLER_ENABLED", "PULSES_ENABLED", "DRIVE_READY"},
        ),
        ({"motor_hot": True}, {*BELOW, "NO_POWER_STAGE_OVERTEMPERATURE", "SPEED_WITHIN_TOLERANCE"}),
        ({"stage_hot": True}, {*BELOW, "NO_MOTOR_OVERTEMPERATURE", "SPEED_WITHIN_TOLERANCE"}),
    ],
)
def test_each_message_says_what_its_bit_means(values: dict[str, int], shown: set[str]) -> None:
    assert names(**values) == shown  # type: ignore[arg-type]


@pytest.mark.parametrize("velocity", [0, 1, -60, 3000])
def test_a_bit_made_from_a_missing_object_is_always_0(velocity: int) -> None:
    without_torque = MessageWord(6000, torque=False)
    assert not without_torque.word(velocity, velocity, 0, 0, target_reached=True) & MELDW["TORQUE_BELOW_THRESHOLD"]
    without_demand = WORD.word(velocity, DEMAND_UNKNOWN, 0, 0, target_reached=True)
    assert not without_demand & (MELDW["RAMP_COMPLETED"] | MELDW["SPEED_WITHIN_TOLERANCE"])


MELDW = {bit.name: bit.mask for bit in signal("MELDW").bits}
