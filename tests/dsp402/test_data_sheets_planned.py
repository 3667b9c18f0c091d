"""Data sheets of drives that differ in one thing: what 100 % is, what is planned, and what each is refused for."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.dsp402.drive.client import load_eds
from pdgw.dsp402.drive_type import DriveType, Dsp402Error, Quantity
from pdgw.dsp402.identification.describe import answers_of_defaults, describe
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.dsp402.pdo.planner import found_in_data_sheet, plan_pdos

FOLDER = Path(__file__).parent / "eds"
NODE = 5
DEMAND = "the bit for speed within tolerance is 0; a frozen ramp keeps the actual speed"
NO_DEMAND = f"Velocity Demand Value 606Bh not available: {DEMAND}"
PLANS = {
    "fixed-pdo": (
        "RPDO2 305h: Controlword 6040h, Target velocity 60FFh; its own mapping; its own COB-ID",
        "TPDO2 285h: Velocity actual value 606Ch, Statusword 6041h; on change and by event timer; its own mapping; "
        "its own COB-ID",
        NO_DEMAND,
    ),
    "no-event-timer": (
        "RPDO1 205h: Target velocity 60FFh, Controlword 6040h",
        "TPDO1 185h: Statusword 6041h, Velocity actual value 606Ch; on SYNC",
        NO_DEMAND,
        "TPDO1 on SYNC: it has no event timer (1800h/5)",
    ),
    "unmappable": (
        "RPDO1 205h: Controlword 6040h",
        "TPDO1 185h: Statusword 6041h, Velocity actual value 606Ch; on change and by event timer",
        "written by SDO when they change: Target velocity 60FFh",
        NO_DEMAND,
    ),
    "own-cob-ids": (
        "RPDO1 32Ah: Target velocity 60FFh, Controlword 6040h; its own COB-ID",
        "TPDO1 1AAh: Statusword 6041h, Velocity actual value 606Ch; on change and by event timer; its own COB-ID",
        NO_DEMAND,
    ),
    "vl": (
        "RPDO1 205h: vl target velocity 6042h, Controlword 6040h",
        "TPDO1 185h: Statusword 6041h, vl velocity actual value 6044h; on change and by event timer",
        f"vl velocity demand 6043h not available in a PDO: {DEMAND}",
    ),
}


def _drive(name: str) -> DriveType:
    dictionary = load_eds(FOLDER / f"{name}.eds", NODE)
    return describe(dictionary, answers_of_defaults(dictionary))


def test_every_data_sheet_has_its_plan() -> None:
    assert {path.stem for path in FOLDER.glob("*.eds")} == {*PLANS}


@pytest.mark.parametrize("name", PLANS)
def test_the_plan_of_telegram_1_is_what_the_data_sheet_allows(name: str) -> None:
    drive = _drive(name)
    assert drive.scaling.reference(Quantity.SPEED) == 3000
    found = plan_pdos(LAYOUTS[Operation.VELOCITY], drive, NODE, found_in_data_sheet(drive), sync=False)
    assert found.lines == PLANS[name]


@pytest.mark.parametrize("name", PLANS)
def test_positioning_is_refused_with_the_object_that_is_missing(name: str) -> None:
    drive = _drive(name)
    with pytest.raises(Dsp402Error, match="Target Position 607Ah: 'not an object of this drive'"):
        plan_pdos(LAYOUTS[Operation.POSITIONING], drive, NODE, found_in_data_sheet(drive), sync=False)
