"""Keys of the configuration that a drive lacks: all of them at once, as lines to paste."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import pytest

from pdgw.dsp402.units.mechanics import KEY_LINES, UnitKeys
from pdgw.dsp402.units.scaling import find_scaling
from pdgw.gateway.commissioning.telegram_check import lacks, missing_lines
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.errors import GatewayError
from tests.support.drives.drive_types import described


@pytest.mark.parametrize(
    ("number", "keys"),
    [
        (1, ("rated_speed_rpm", "velocity_unit")),
        (9, ("rated_speed_rpm", "velocity_unit", "rated_acceleration_rpm_s", "acceleration_unit")),
        (
            111,
            (
                "rated_speed_rpm",
                "velocity_unit",
                "rated_acceleration_rpm_s",
                "acceleration_unit",
                "counts_per_revolution",
            ),
        ),
    ],
)
def test_all_missing_keys_are_told_at_once(number: int, keys: tuple[str, ...]) -> None:
    drive = replace(described("rpm"), scaling=find_scaling({}))
    text = lacks(drive, number)
    assert missing_lines(drive, number) == tuple(KEY_LINES[key] for key in keys)
    for key in keys:
        assert f"{key} = " in text, "fault 104 names it with its line"


def test_lines_to_paste_are_refused_until_they_are_filled_in() -> None:
    for key, line in KEY_LINES.items():
        with pytest.raises(GatewayError, match=key):
            parse_config(f'[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n{line}\n')


def test_with_the_keys_that_were_told_nothing_is_missing() -> None:
    keys = UnitKeys(
        rated_speed_rpm=Fraction(3000),
        velocity_unit="rpm",
        counts_per_revolution=Fraction(4096),
        acceleration_unit="rpm/s",
        rated_acceleration=Fraction(3000),
    )
    drive = replace(described("rpm"), scaling=find_scaling({}, keys))
    assert [lacks(drive, number) for number in (1, 9, 111)] == ["", "", ""]
