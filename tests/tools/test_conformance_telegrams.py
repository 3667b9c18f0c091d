"""``pdgw conformance telegrams``: every case as it must be, and no bit of the positioner's control words forgotten."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from pdgw.profidrive.signals import signal
from pdgw.tools.commands.conformance import app
from pdgw.tools.conformance.telegrams import CASES, Case, run_case

NOT_EVALUATED = {"REFERENCE_CAM", "HOMING_NEGATIVE", "PROBE_2", "PROBE_FALLING_EDGE", "HARDWARE_LIMITS"}
"""Bits without an effect that a simulated drive could show (docs/motion.md)."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.title)
def test_what_is_asked_is_seen_on_both_sides(case: Case) -> None:
    assert run_case(case).failures == ()


@pytest.mark.parametrize("word", ["POS_STW1", "POS_STW2"])
def test_every_bit_of_the_positioner_has_a_case(word: str) -> None:
    asked = {case.bit.split(" ")[0] for case in CASES if case.word == word}
    assert {bit.name for bit in signal(word).bits} <= asked | NOT_EVALUATED


def test_a_case_that_sees_something_else_fails() -> None:
    case = next(case for case in CASES if case.on_can)
    outcome = run_case(replace(case, on_can={"607Ah": 1}))
    assert not outcome.passed
    assert "607Ah" in outcome.failures[0]


def test_the_command_prints_json_and_refuses_a_telegram_without_cases() -> None:
    found = CliRunner().invoke(app, ["telegrams", "7", "--json"])
    assert found.exit_code == 0
    assert json.loads(found.stdout)["failed"] == 0
    assert CliRunner().invoke(app, ["telegrams", "1"]).exit_code != 0
