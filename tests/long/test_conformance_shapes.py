"""``conformance shapes``: every field of the matrix as it must be, and the command that prints it."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from pdgw.peers.drive import SHAPES
from tests.long.commands.conformance import app
from tests.long.conformance.shapes import REFUSALS, TELEGRAMS, run_case


@pytest.mark.parametrize("number", TELEGRAMS)
@pytest.mark.parametrize("name", SHAPES)
def test_drive_of_each_variant_moves_as_commanded_or_is_rejected(name: str, number: int) -> None:
    assert run_case(name, number).failure == ""


def test_command_prints_the_matrix_and_rejects_an_unknown_variant() -> None:
    found = CliRunner().invoke(app, ["shapes", "unguarded", "--json"])
    assert found.exit_code == 0
    cases = json.loads(found.stdout)["cases"]
    assert [case["moved"] for case in cases] == [False] * len(TELEGRAMS)
    assert all(REFUSALS["unguarded", case["telegram"]] in case["text"] for case in cases)
    assert CliRunner().invoke(app, ["shapes", "round"]).exit_code != 0
