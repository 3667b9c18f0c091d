"""``pdgw drives FILE``: repairs, problems and exit status of the import of data sheets."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from pdgw.ds301.eds.importer import import_eds
from pdgw.tools.cli import app

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
