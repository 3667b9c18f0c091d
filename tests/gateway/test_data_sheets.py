"""Data sheets of the market: the accepted telegrams of each drive, and its motion with them."""

from __future__ import annotations

import re
from pathlib import Path

import can
import pytest

from pdgw.ds301.communication import SDO_REQUEST
from pdgw.ds301.eds.importer import import_eds
from pdgw.dsp402.drive_type import DriveType, Quantity
from pdgw.dsp402.identification.describe import described_by_sheet
from pdgw.gateway.commissioning.telegram_check import lacks, not_available
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario_file import scenario_of
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from tests.conformance.rig import COMPLETE
from tests.support.drives.data_sheets import SHEETS, Sheet
from tests.support.gateways.daemon import POSITIONER, Plc, axis, configuration, running, until, world_of

TELEGRAMS = (1, 9, 111)
ACCEPTED = [(name, number) for name, sheet in SHEETS.items() for number in TELEGRAMS if number not in sheet.refused]
MOVED = ACCEPTED if COMPLETE else list({name: (name, number) for name, number in ACCEPTED}.values())
"""Each drive with the telegram that needs most of it; ``make conformance`` has all that are accepted."""
NEEDED = {1: len(SHEETS), 9: 12, 111: 10}
QUARTER = 0x1000
TEN_TURNS = 40_960
WITHOUT = {
    "maxon EPOS2 50/5": "60FDh",
    "maxon EPOS4 Module 50/15": "6078h",
    "Faulhaber MCBL CF": "60FDh 6078h",
    "Faulhaber MCLM CF": "60FDh 6078h",
    "Faulhaber MCBL CO": "",
    "Trinamic TMCM-1230": "606Bh 6078h",
    "Trinamic TMCM-1270": "606Bh 6078h",
    "Technosoft iPOS": "6084h 6078h",
    "Elmo Gold Drive": "",
    "Elmo SimplIQ": "",
    "SCHUNK LWA": "6084h 6078h",
    "Pilz PRBT": "6084h 6078h",
    "Yiyou EuServo": "60FDh 6078h",
    "Kollmorgen RGM": "60FDh 6078h",
    "Kollmorgen AKD": "6078h",
    "Nanotec PD4-N": "6078h",
}
"""Objects that telegram 111 can do without and the drive lacks."""
BITS = {
    "606Bh": ("MELDW", ("RAMP_COMPLETED", "SPEED_WITHIN_TOLERANCE")),
    "6078h": ("MELDW", ("TORQUE_BELOW_THRESHOLD",)),
    "60FDh": ("POS_ZSW1", ("NEGATIVE_HARDWARE_LIMIT", "POSITIVE_HARDWARE_LIMIT")),
}
"""What is made from an object."""


def described(sheet: Sheet) -> DriveType:
    """The drive as its data sheet and the keys of the configuration describe it."""
    units = configuration(axis(1, more=sheet.keys)).axis[0].units
    return described_by_sheet(import_eds(sheet.eds.encode(), 1).dictionary, units)


def config(sheet: Sheet, number: int, folder: Path) -> GatewayConfig:
    path = folder / "drive.eds"
    path.write_text(sheet.eds, encoding="ascii")
    more = f'eds = "{path}"\n{sheet.keys}' + (POSITIONER if number == 111 else "")
    return configuration(axis(1, telegram_number=number, more=more))


def test_start_of_a_drive_reads_each_part_of_its_identity_once() -> None:
    read: list[int] = []

    def note(message: can.Message) -> None:
        data = message.data
        if message.arbitration_id == SDO_REQUEST + 1 and data[:3] == b"\x40\x18\x10":
            read.append(data[3])

    path = Path(__file__).parents[2] / "dsp402/eds/engel.eds"
    settings = configuration(axis(1, more=f'simulate = true\neds = "{path}"'))
    with running(settings, lambda daemon: daemon.networks["can"].listeners.append(note)) as daemon:
        until(daemon, lambda: daemon.axes[0].good, "online")
    assert sorted(read) == [1, 2, 4]


@pytest.mark.parametrize("number", TELEGRAMS)
@pytest.mark.parametrize("name", SHEETS)
def test_a_data_sheet_is_accepted_or_refused_with_the_reason(name: str, number: int) -> None:
    sheet = SHEETS[name]
    refusal = lacks(described(sheet), telegram(number))
    if number in sheet.refused:
        assert sheet.refused[number] in refusal
    else:
        assert refusal == ""


def test_enough_data_sheets_are_accepted() -> None:
    accepted = {number: sum(found == number for _, found in ACCEPTED) for number in TELEGRAMS}
    assert all(accepted[number] >= NEEDED[number] for number in TELEGRAMS), accepted


@pytest.mark.parametrize("name", SHEETS)
def test_each_missing_optional_object_has_its_line(name: str) -> None:
    lines = not_available(described(SHEETS[name]), telegram(111))
    assert {re.findall(r"[0-9A-F]{4}h(?= not available: )", line)[0] for line in lines} == {*WITHOUT[name].split()}


def turns(plc: Plc, drive: SimulatedDrive) -> None:
    plc.enable()
    plc.endpoint.set(0, {"NSOLL_A": QUARTER})
    plc.until(lambda: drive.model.ramp.speed == pytest.approx(750, rel=0.01), "750 rpm")
    plc.until(lambda: abs(plc.value("NIST_A") - QUARTER) <= 8, "the actual speed")
    plc.endpoint.set(0, {"NSOLL_A": 0})
    plc.until(lambda: drive.model.ramp.speed == 0, "standstill")


def travels(plc: Plc, drive: SimulatedDrive) -> None:
    scaling = plc.daemon.axes[0].drive.drive_type.scaling  # type: ignore[union-attr]
    target = int((TEN_TURNS << 30) / scaling.reference(Quantity.POSITION))
    half = int((1500 * scaling.velocity_per_rpm * (1 << 30)) / scaling.reference(Quantity.PROFILE_VELOCITY))  # type: ignore[operator]
    plc.enable()
    task = {"SATZANW": 0x8000, "MDI_TARPOS": target, "MDI_VELOCITY": half, "MDI_MOD": 1}
    plc.endpoint.set(0, {**task, "MDI_ACC": 0x4000, "MDI_DEC": 0x2000, "STW1": 0x043F})
    plc.exchange(5)
    plc.endpoint.set(0, {"STW1": 0x047F})
    fastest = 0.0
    while not (drive.model.ramp.speed == 0 and fastest):
        plc.exchange()
        fastest = max(fastest, drive.model.ramp.speed)
    assert fastest == pytest.approx(1500, rel=0.01)
    ramp = drive.model.shape.acceleration_per_rpm_s * (5000 if "6084h" in WITHOUT[drive.node.shape.name] else 10_000)
    assert drive.model.profile_acceleration == pytest.approx(float(ramp), abs=1), "one ramp for both: the smaller"
    assert drive.model.position_actual == pytest.approx(TEN_TURNS, abs=2)
    plc.until(lambda: signal("ZSW1").bit("TARGET_REACHED").of(plc.value("ZSW1")), "target reached")


STEPS = [
    {"enable": True},
    {"set": {"OVERRIDE": "100 %"}},
    {"jog": 2},
    {"expect": {"NIST_B": "300 rpm +- 5 rpm"}, "note": "jog at its velocity"},
    {"jog": 0},
    {"expect": {"ZSW1.TARGET_REACHED": 1, "ZSW1.DRIVE_STOPPED": 1}},
    {"set_reference": True},
    {"mdi": {"to": 50_000, "velocity": 6000}},
    {"expect": {"NIST_B": "600 rpm +- 10 rpm", "ZSW1.TARGET_REACHED": 0}},
    {"expect": {"XIST_A": "50000 +- 20", "ZSW1.TARGET_REACHED": 1}, "within": "10 s"},
]


def positions(plc: Plc, drive: SimulatedDrive) -> None:
    begin, ever = drive.model.position, {"MELDW": 0, "POS_ZSW1": 0}
    engine = Engine(scenario_of([telegram(111)], STEPS), plc.endpoint)
    while not engine.finished:
        engine.step(plc.loop.now())
        plc.exchange()
        for word in ever:
            ever[word] |= max(0, plc.value(word))
    assert engine.passed, [result for result in engine.results if not result.passed]
    assert drive.model.position - begin > 5 * 4096, "the jog, then five turns"
    for index in WITHOUT[drive.node.shape.name].split():
        word, bits = BITS.get(index, ("MELDW", ()))
        assert not any(signal(word).bit(bit).of(ever[word]) for bit in bits), f"{index} is missing"


MOVES = {1: turns, 9: travels, 111: positions}


@pytest.mark.parametrize(("name", "number"), MOVED)
def test_an_accepted_drive_moves_as_commanded(name: str, number: int, tmp_path: Path) -> None:
    sheet = SHEETS[name]
    with running(config(sheet, number, tmp_path)) as daemon:
        drive = world_of(daemon).drive("world", 1, shape=sheet.shape)
        client = daemon.axes[0].drive
        until(daemon, lambda: client.generation or client.status.value == "refused", "online")
        assert client.generation, client.status_text
        MOVES[number](Plc(daemon, [number]), drive)
