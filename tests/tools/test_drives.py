"""``pdgw drives``: the known drives and a data sheet, its repairs and problems, and the exit status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.writer import DeviceInfo, write_eds
from pdgw.ds301.objects import Access, CanType, var
from pdgw.dsp402.identification.overlay import NO_CHOICE, overlays
from pdgw.peers.drive.objects import EDS_PATH, drive_objects
from pdgw.tools.cli import app


def _run(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["drives", *arguments])
    assert result.exit_code == 0, result.output
    return result.output


def _eds(
    tmp_path: Path, vendor_id: int, name: str, *more: tuple[int, CanType, int], without: tuple[int, ...] = ()
) -> str:
    further = [var(index, f"Object {index:04X}h", kind, Access.RO, default=value) for index, kind, value in more]
    objects = [spec for spec in drive_objects() if spec.index not in {*without, *(item.index for item in further)}]
    path = tmp_path / "drive.eds"
    path.write_text(write_eds(DeviceInfo("By hand", name, vendor_id, 1, 1), [*objects, *further]))
    return str(path)


def test_every_family_has_sources() -> None:
    document = json.loads(_run("--json"))
    assert {item["name"] for item in document} == {*overlays()}
    assert all(item["sources"] for item in document)
    for wanted in ("epos4", "epos2", "mcbl", "faulhaber", "tmcm", "elmo_gold", "elmo_simpliq", "akd", "lexium32"):
        assert wanted in overlays()
    for wanted in ("nanotec", "cmmt", "cmmp", "prbt", "beckhoff_ax", "engel"):
        assert wanted in overlays()


@pytest.mark.parametrize("name", sorted(overlays()))
def test_a_family_can_be_shown(name: str) -> None:
    output = _run(name)
    assert overlays()[name].title in output
    assert "sources:" in output


@pytest.mark.parametrize(
    ("vendor_id", "name", "family"),
    [
        (0xFB, "EPOS4 Module 50/15", "epos4"),
        (0xFB, "EPOS2 24/5", "epos2"),
        (0xFB, "MCD EPOS", None),
        (0x9A, "Gold Drive", "elmo_gold"),
        (0x9A, "", "elmo_simpliq"),
        (0x147, "MC5010 S", "faulhaber"),
        (0x147, "MCBL3006 CF", "mcbl"),
        (0x1D, "CMMT-AS-C2-3A", "cmmt"),
        (0x77, "LXM32A", "lexium32"),
        (0x400, "whatever", "engel"),
        (0x77, "whatever", None),
    ],
)
def test_a_family_is_chosen_by_vendor_and_name(vendor_id: int, name: str, family: str | None) -> None:
    found = NO_CHOICE.of(vendor_id, 0x99, name)
    assert (found.name if found else None) == family


def test_matched_data_sheet_is_shown_with_its_missing_objects(tmp_path: Path) -> None:
    without = (0x6094, 0x60C5, 0x60C6)
    file = _eds(tmp_path, 0xFB, "EPOS4 50/15", (0x60A9, CanType.U32, 0x00B4_4700), without=without)
    output = _run(file)
    assert "EPOS4 50/15: family epos4" in output
    assert "speed: 100 % = 3000 rpm = 60FFh 3000 (from 6080h, 60A9h = 00B44700h)" in output
    assert "telegram 9 needs more: the drive has no 60C5h: set rated_acceleration_rpm_s" in output.replace(
        "acceleration: ", ""
    )
    document = json.loads(_run("--json", file))[0]
    assert (document["family"], document["telegrams"]["1"]) == ("epos4", "")
    assert document["not_available"] == {}


def test_an_object_a_data_sheet_lacks_is_named_with_its_telegrams(tmp_path: Path) -> None:
    output = _run(_eds(tmp_path, 0xFB, "EPOS4 50/15", without=(0x60FD,)))
    assert "telegrams 7, 110, 111, 112: Digital Inputs 60FDh not available: the limit switches are 0" in output


def test_data_sheet_without_a_family_describes_the_drive_itself(tmp_path: Path) -> None:
    output = _run(_eds(tmp_path, 0x77, "Nobody's"))
    assert "no family" in output
    assert "6094h alone does not define the unit" in output
    assert "family engel" in _run(str(EDS_PATH))


def test_a_sheet_of_another_device_is_not_a_drive(tmp_path: Path) -> None:
    file = tmp_path / "io.eds"
    file.write_text("[DeviceInfo]\n[1000]\nParameterName=x\nDataType=7\nAccessType=ro\nDefaultValue=0x00030191\n")
    assert "no CiA 402 drive: 6040h and 6041h missing, device profile 401" in _run(str(file))
    assert json.loads(_run("--json", str(file)))[0]["notes"] == [
        "no CiA 402 drive: 6040h and 6041h missing, device profile 401"
    ]


def test_an_identity_that_contradicts_1018h_is_named(tmp_path: Path) -> None:
    file = Path(_eds(tmp_path, 0x77, "Mine"))
    file.write_text(file.read_text().replace("VendorNumber=0x77", "VendorNumber=0x78"))
    assert "[DeviceInfo] VendorNumber is 78h, but 1018h/1 is " in _run(str(file))


def test_a_misspelt_family_is_rejected_with_the_similar_name() -> None:
    result = CliRunner().invoke(app, ["drives", "epos5"])
    assert result.exit_code == 1
    assert str(result.exception).startswith("epos5: neither a file nor a family; did you mean epos4?")


def test_a_file_is_checked_and_matched_by_one_command() -> None:
    output = _run(str(EDS_PATH))
    assert "usable" in output
    assert "family engel" in output


NODE = 5
CORPUS = Path(__file__).parents[1] / "ds301" / "eds"
GOOD = CORPUS / "good.eds"


def test_check_prints_repairs_and_succeeds() -> None:
    result = CliRunner().invoke(
        app, ["drives", str(GOOD), str(CORPUS / "repaired" / "numbers.eds")], env={"COLUMNS": "200"}
    )
    assert result.exit_code == 0
    assert "0 repairs" in result.output
    assert "VendorNumber" in result.output


def test_check_of_a_refused_file_fails_and_still_reports_the_others() -> None:
    files = [str(CORPUS / "refused" / "ambiguous.eds"), str(GOOD)]
    result = CliRunner().invoke(app, ["drives", "--json", *files])
    assert result.exit_code == 1
    refused, good = json.loads(result.output)
    assert (refused["usable"], len(refused["problems"])) == (False, 6)
    assert refused["problems"][0] == {
        "line": 2,
        "section": "DeviceInfo",
        "key": "VendorNumber",
        "found": "abc",
        "reason": "not a number",
    }
    assert (good["usable"], good["objects"], good["repairs"]) == (True, 6, [])


def test_check_writes_the_repaired_file(tmp_path: Path) -> None:
    out = tmp_path / "out.eds"
    result = CliRunner().invoke(app, ["drives", str(CORPUS / "repaired" / "layout.eds"), "--write", str(out)])
    assert result.exit_code == 0
    assert import_eds(out, NODE).repairs == ()
