"""``conformance shapes``: every field of the matrix as it must be, and the command that prints it."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from pdgw.peers.drive import SHAPES
from pdgw.workshop.commands.conformance import app
from pdgw.workshop.conformance.shapes import REFUSALS, TELEGRAMS, run_case


@pytest.mark.parametrize("number", TELEGRAMS)
@pytest.mark.parametrize("name", SHAPES)
def test_a_drive_of_each_shape_moves_as_told_or_is_refused_with_its_reason(name: str, number: int) -> None:
    assert run_case(name, number).failure == ""


def test_the_command_prints_the_matrix_and_refuses_a_shape_there_is_not() -> None:
    found = CliRunner().invoke(app, ["shapes", "unguarded", "--json"])
    assert found.exit_code == 0
    cases = json.loads(found.stdout)["cases"]
    assert [case["moved"] for case in cases] == [False] * len(TELEGRAMS)
    assert all(REFUSALS["unguarded", case["telegram"]] in case["text"] for case in cases)
    assert CliRunner().invoke(app, ["shapes", "round"]).exit_code != 0
