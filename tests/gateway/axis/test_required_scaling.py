"""What of the scaling each telegram needs."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from types import MappingProxyType

import pytest

from pdgw.dsp402.drive_type import DriveType, Quantity
from pdgw.gateway.axis.settings import AxisSettings, needed_quantities
from pdgw.gateway.commissioning.telegram_check import lacks, not_available
from pdgw.gateway.configuration.defaults import SIMULATED_KEYS
from pdgw.gateway.configuration.devices import PositionerConfig
from pdgw.profidrive.telegrams import telegram
from tests.support.drives.drive_types import engel

SPEED = (Quantity.SPEED,)


@pytest.mark.parametrize(
    ("number", "needed"),
    [(1, SPEED), (2, SPEED), (3, SPEED), (20, SPEED), (100, SPEED), (9, tuple(Quantity))],
)
def test_telegram_needs_only_the_references_of_its_signals(number: int, needed: tuple[Quantity, ...]) -> None:
    assert needed_quantities(telegram(number)) == needed


def _drive(modes: tuple[int, ...], missing: str = "") -> DriveType:
    drive = engel()
    scaling = replace(drive.scaling, counts_per_revolution=Fraction(4096), acceleration_per_rpm_s=Fraction(1, 10))
    entries = {name: entry for name, entry in drive.entries.items() if name != missing}
    return replace(
        drive, scaling=scaling, modes=MappingProxyType(dict.fromkeys(modes, "")), entries=MappingProxyType(entries)
    )


def test_111_is_refused_without_profile_velocity_mode() -> None:
    assert lacks(_drive((1, 3, 6)), 111) == ""
    assert "3 for setting up and jog" in lacks(_drive((1, 6, 9)), 111)


def test_a_fixed_stop_is_refused_without_the_actual_current() -> None:
    choices = PositionerConfig.model_validate(SIMULATED_KEYS | {"clamping_torque": 100}).choices(())
    settings = AxisSettings(positioner=choices)
    assert lacks(_drive((1, 3)), 111, settings) == ""
    assert "current_actual: 'not an object of this drive'" in lacks(_drive((1, 3), "current_actual"), 111, settings)
    assert lacks(_drive((1, 3), "current_actual"), 111) == "", "without a fixed stop nothing needs it"


@pytest.mark.parametrize("missing", ["profile_acceleration", "target_position", "velocity_actual"])
def test_objects_needed_for_motion_are_never_optional(missing: str) -> None:
    assert "not an object of this drive" in lacks(_drive((1, 3), missing), 9)


@pytest.mark.parametrize("number", [7, 9, 110, 111, 112])
def test_a_drive_without_profile_velocity_is_not_refused(number: int) -> None:
    drive = _drive((1, 3), "profile_velocity")
    assert lacks(drive, number) == ""
    assert any("6081h not available: traversing tasks run at" in line for line in not_available(drive, number))
