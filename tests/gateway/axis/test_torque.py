"""Torque: telegrams 102 and 103 with reduction and message word, telegram 20 with current, power and NAMUR word."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.ds301.node.planner import found_in_data_sheet
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.dsp402.pdo.planner import plan_pdos
from pdgw.gateway.axis.executors.message_words import namur_word
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.profidrive.signals import signal
from tests.support.axis.rig import Rig
from tests.support.drives.drive_types import References, engel
from tests.support.gateways.daemon import axis, configuration, drive_of, operating

# -- telegrams 102 and 103 ----------------------------------------------------------------------------------------


OFF = 0x047E
_NAMES = {bit.name: bit.mask for bit in signal("MELDW").bits}


def messages(rig: Rig) -> set[str]:
    return {name for name, mask in _NAMES.items() if rig.actuals["MELDW"] & mask}


@pytest.mark.parametrize("number", [102, 103])
def test_worked_example_750_rpm_at_half_torque(number: int) -> None:
    rig = Rig(number)
    rig.enable(OFF)
    half = rig.stepper.telegram.setpoints
    data = bytes.fromhex("047F 1000 0000 0000 2000 0000") + bytes(2 * (number - 102))
    rig.values |= half.as_dict(half.decode(data))
    rig.until(lambda actuals: actuals["NIST_B"] == 1 << 28, 500)
    assert rig.stepper.command.target_velocity == 1500
    assert (rig.stepper.command.max_torque, rig.node.model.max_torque) == (1500, 1500)


def test_torque_limit_is_100_percent_without_a_plc() -> None:
    rig = Rig(102)
    rig.step(3, plc=False)
    assert rig.node.model.max_torque == 3000
    rig.enable(OFF)
    rig.values["MOMRED"] = 0x4000
    rig.step(3)
    assert rig.node.model.max_torque == 0
    rig.step(3, plc=False)
    assert rig.node.model.max_torque == 3000


def test_a_negative_reduction_reduces_nothing() -> None:
    rig = Rig(102)
    rig.enable(OFF)
    rig.values["MOMRED"] = -0x2000
    rig.step(3)
    assert rig.node.model.max_torque == 3000


def test_reduced_torque_accelerates_more_slowly() -> None:
    def cycles(reduction: int) -> int:
        rig = Rig(102)
        rig.node.set_data(0x6083, 0, (1000).to_bytes(4, "little"), check_writable=True)
        rig.enable(OFF)
        rig.values |= {"MOMRED": reduction, "NSOLL_B": 1 << 29}
        return rig.until(lambda actuals: actuals["NIST_B"] >= 1 << 28, 5000)

    assert cycles(0x3C00) > 2 * cycles(0)


def test_the_message_word_follows_the_drive() -> None:
    rig = Rig(102)
    rig.step(3)
    standing = {"TORQUE_BELOW_THRESHOLD", "SPEED_BELOW_THRESHOLD_3", "SPEED_BELOW_THRESHOLD_2"}
    cool = {"NO_MOTOR_OVERTEMPERATURE", "NO_POWER_STAGE_OVERTEMPERATURE"}
    assert messages(rig) >= standing | cool
    assert not messages(rig) & {"CONTROLLER_ENABLED", "PULSES_ENABLED", "DRIVE_READY"}
    rig.enable(OFF)
    assert messages(rig) >= {"CONTROLLER_ENABLED", "PULSES_ENABLED", "DRIVE_READY"}
    rig.values["NSOLL_B"] = 1 << 29
    rig.until(lambda actuals: actuals["NIST_B"] == 1 << 29, 1000)
    rig.step(20)
    assert not messages(rig) & {"SPEED_BELOW_THRESHOLD_3", "SPEED_BELOW_THRESHOLD_2"}
    assert messages(rig) >= {"RAMP_COMPLETED", "SPEED_WITHIN_TOLERANCE"}


def test_a_drive_without_a_torque_limit_does_not_operate() -> None:
    rig = Rig(102)
    rig.stepper.set_references(replace(References(), max_torque=0))
    rig.step(2)
    assert rig.stepper.numbers == [FaultNumber.REFERENCE]
    assert "6072h" in rig.stepper.events[0].text
    assert rig.actuals["ZSW1"] & 0x0008


@pytest.mark.parametrize("number", [4, 103])
def test_missing_second_sensor_is_reported(number: int) -> None:
    rig = Rig(number)
    rig.step(3)
    assert (rig.actuals["G2_ZSW"], rig.actuals["G2_XIST2"]) == (0x8000, 0x0F01)
    assert rig.actuals["G1_ZSW"] == 0


def test_telegram_4_is_telegram_3_with_more_words() -> None:
    rig = Rig(4)
    rig.enable(OFF)
    rig.values["NSOLL_B"] = 1 << 28
    rig.until(lambda actuals: actuals["NIST_B"] == 1 << 28, 500)
    assert rig.actuals["G1_XIST1"]


def test_zsw1_8_is_the_deviation_of_meldw_8() -> None:
    rig = Rig(102)
    rig.enable(OFF)
    mask = signal("ZSW1").bit("WITHIN_TOLERANCE").mask
    assert rig.actuals["ZSW1"] & mask
    rig.feedback.velocity_demand = 400
    rig._tpdos.clear()
    rig.step()
    assert not rig.actuals["ZSW1"] & mask
    assert "SPEED_WITHIN_TOLERANCE" not in messages(rig)


@pytest.mark.parametrize(
    ("code", "gone"),
    [(0x4310, "NO_MOTOR_OVERTEMPERATURE"), (0x4210, "NO_POWER_STAGE_OVERTEMPERATURE")],
)
def test_overtemperature_is_shown_until_it_ends_in_the_drive(code: int, gone: str) -> None:
    rig = Rig(102)
    rig.enable(OFF)
    both = {"NO_MOTOR_OVERTEMPERATURE", "NO_POWER_STAGE_OVERTEMPERATURE"}
    assert both <= messages(rig)
    rig.stepper.machine.inputs.news.append(NodeNotice(Notice.EMERGENCY, "EMCY", rig.now, code, 0x09))
    rig.step()
    assert messages(rig) & both == both - {gone}
    rig.stepper.machine.inputs.news.append(NodeNotice(Notice.EMERGENCY, "EMCY", rig.now, 0, 0))
    rig.step()
    assert both <= messages(rig)


# -- telegram 20 --------------------------------------------------------------------------------------------------


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
    found = found_in_data_sheet(lacking.pdos)
    plan = plan_pdos(LAYOUTS[Operation.VELOCITY_WITH_LOAD], lacking, 1, found, sync=False)
    carried = [pdo.pdo.attributes for pdo in plan.tpdos]
    assert carried == [("statusword", "velocity_actual"), ("velocity_demand",)]
    assert plan.notes == ("Current Actual Value 6078h not available: current, torque and power are 0",)


def test_through_the_gateway() -> None:
    with operating(configuration(axis(1, telegram_number=20))) as (daemon, plc):
        assert drive_of(daemon).node.read(PdoDirection.TPDO.mapping_index + 1, 1) == 0x6078_0010
        drive_of(daemon).do(lambda node: setattr(node.model, "current_actual", 250))
        plc.until(lambda: plc.value("IAIST_GLATT") == 0x1000, "25 %")
