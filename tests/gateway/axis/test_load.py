"""Telegram 20: current, torque, power and the NAMUR word after the speed."""

from __future__ import annotations

import pytest

from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.dsp402.pdo.planner import found_in_data_sheet, plan_pdos
from pdgw.gateway.axis.values import NodeNotice, Notice
from pdgw.gateway.motion.requests import namur_word
from pdgw.profidrive.signals import signal
from tests.support.axis.rig import Rig
from tests.support.drives.drive_types import engel
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, running

NAMUR = {bit.name: bit.mask for bit in signal("MELD_NAMUR").bits}


def load(current: int, rpm: int) -> tuple[int, int, int]:
    """IAIST, MIST and PIST with a current in 1/1000 and a speed."""
    rig = Rig(20)
    rig._tpdos.clear()
    rig.feedback.current_actual, rig.feedback.velocity_actual = current, 2 * rpm
    rig.step()
    return tuple(rig.actuals[name] for name in ("IAIST_GLATT", "MIST_GLATT", "PIST_GLATT"))  # type: ignore[return-value]


def test_100_percent_is_the_rated_current_and_power_is_torque_times_speed() -> None:
    assert load(1000, 3000) == (0x4000, 0x4000, 0x4000)
    assert load(500, 1500) == (0x2000, 0x2000, 0x1000)


def test_a_braking_motor_has_negative_power() -> None:
    assert load(-500, 3000) == (-0x2000, -0x2000, -0x2000)


def test_values_above_200_percent_are_limited() -> None:
    assert load(3000, 3000) == (0x7FFF, 0x7FFF, 0x7FFF)


def test_without_references_only_the_fault_class_is_shown() -> None:
    rig = Rig(20)
    rig._tpdos.clear()
    rig.feedback.current_actual, rig.feedback.velocity_actual = 1000, 6000
    values = ("NIST_A_GLATT", "IAIST_GLATT", "MIST_GLATT", "PIST_GLATT")
    assert all(rig.step()[name] for name in values)
    rig.stepper.set_references(None)
    rig.stepper.machine.inputs.news.append(NodeNotice(Notice.EMERGENCY, "EMCY", rig.now, 0x2310, 0x03))
    rig.step()
    assert not any(rig.actuals[name] for name in values)
    assert rig.actuals["MELD_NAMUR"] == NAMUR["POWER_UNIT"]


@pytest.mark.parametrize(
    ("code", "name"),
    [
        (0x2310, "POWER_UNIT"),
        (0x2330, "GROUND_FAULT"),
        (0x3210, "DC_LINK_OVERVOLTAGE"),
        (0x3220, "LINE"),
        (0x4210, "OVERTEMPERATURE"),
        (0x4310, "MOTOR_OVERLOAD"),
        (0x6100, "CONVERTER"),
        (0x8130, "COMMUNICATION"),
        (0x7305, "OTHER"),
        (0x8611, "OTHER"),
    ],
)
def test_namur_word_shows_the_fault_class(code: int, name: str) -> None:
    assert namur_word(code) == NAMUR[name]


def test_namur_word_stays_until_the_fault_of_the_drive_ends() -> None:
    rig = Rig(20)
    news = rig.stepper.machine.inputs.news
    news.append(NodeNotice(Notice.EMERGENCY, "EMCY", rig.now, 0x2310, 0x03))
    assert rig.step()["MELD_NAMUR"] == NAMUR["POWER_UNIT"]
    news.append(NodeNotice(Notice.EMERGENCY, "EMCY", rig.now, 0, 0))
    assert rig.step()["MELD_NAMUR"] == 0


def test_drive_without_actual_current_operates() -> None:
    drive = engel()
    entries = {name: entry for name, entry in drive.entries.items() if name != "current_actual"}
    lacking = drive.__class__(**{**{f: getattr(drive, f) for f in drive.__dataclass_fields__}, "entries": entries})
    found = found_in_data_sheet(lacking)
    plan = plan_pdos(LAYOUTS[Operation.VELOCITY_WITH_LOAD], lacking, 1, found, sync=False)
    carried = [pdo.pdo.attributes for pdo in plan.tpdos]
    assert carried == [("statusword", "velocity_actual"), ("velocity_demand",)]
    assert plan.notes == ("Current Actual Value 6078h not available: current, torque and power are 0",)


def test_through_the_gateway() -> None:
    with running(configuration(axis(1, telegram_number=20))) as daemon:
        plc = Plc(daemon, [20])
        plc.enable()
        assert drive_of(daemon).node.read(PdoDirection.TPDO.mapping_index + 1, 1) == 0x6078_0010
        drive_of(daemon).do(lambda node: setattr(node.model, "current_actual", 250))
        plc.until(lambda: plc.value("IAIST_GLATT") == 0x1000, "25 %")
