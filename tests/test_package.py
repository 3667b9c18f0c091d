"""The installed package: the wheel is complete, its metadata is complete, the public names work."""

from __future__ import annotations

import ast
import re
import runpy
import subprocess
import sys
import tomllib
from fnmatch import fnmatch
from importlib.metadata import metadata, version
from pathlib import Path
from typing import Any

import pytest

import pdgw
from pdgw.ds301.aborts import CanopenError
from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.errors import ProfidriveError
from tests.support.documents.sources import ROOMS
from tests.support.gateways.daemon import axis, configuration, reached, serving
from tests.support.readers.both_buses import write_capture

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "docs" / "examples"
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_an_older_python_is_rejected_with_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """By make and by pip, which runs setup.py before it reads ``requires-python`` of a folder."""
    (check,) = re.findall(r"@\$\(PYTHON\) -c '(.+)'", (ROOT / "Makefile").read_text(encoding="utf-8"))
    monkeypatch.setattr(sys, "version_info", (3, 10, 13, "final", 0))
    message = "needs Python 3.11 or newer, this is 3.10"
    with pytest.raises(SystemExit, match=message):
        exec(check, {})
    with pytest.raises(SystemExit, match=message):
        runpy.run_path(str(ROOT / "setup.py"))
    assert PROJECT["project"]["requires-python"] == ">=3.11"


def test_every_folder_with_modules_is_a_package() -> None:
    folders = {file.parent for room in ROOMS for file in (ROOT / room).rglob("*.py")}
    assert [folder for folder in folders if not (folder / "__init__.py").exists()] == []


def test_the_package_has_a_link_to_each_room() -> None:
    """With them, a checkout can be imported, and each file has only one path: that of its import."""
    links = {file.name: file.readlink() for file in (ROOT / "pdgw").iterdir() if file.is_symlink()}
    assert links == {room: Path("..") / room for room in ROOMS if room != "pdgw"}


def test_every_data_file_of_the_packages_is_installed() -> None:
    patterns = PROJECT["tool"]["setuptools"]["package-data"]["*"]
    files = subprocess.run(
        ["git", "ls-files", *ROOMS], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    left_out = [
        file
        for file in files
        if not file.endswith(".py")
        and not (ROOT / file).is_symlink()
        and not any(fnmatch(Path(file).name, pattern.removeprefix("**/")) for pattern in patterns)
    ]
    assert left_out == []


def test_metadata_has_author_description_and_audience() -> None:
    said = metadata("profidrive-gateway")
    assert said["Author"] == "profidrive-gateway"
    assert said["Summary"]
    assert {"PROFIdrive", "CANopen"} <= set(said["Keywords"].split(","))
    classifiers = said.get_all("Classifier") or []
    assert "Typing :: Typed" in classifiers
    assert all(not text.startswith("License") for text in classifiers), "the licence is an SPDX expression"


# -- the public package -----------------------------------------------------------------------------------------------


def documentation(found: Any) -> str | None:
    """The docstring; what is compiled has its own in the source beside it."""
    if not found.__doc__ and hasattr(found, "__name__"):
        source = Path(sys.modules[found.__module__].__file__ or "")
        tree = ast.parse(source.with_name(f"{source.name.partition('.')[0]}.py").read_text(encoding="utf-8"))
        return next(ast.get_docstring(item) for item in ast.walk(tree) if getattr(item, "name", "") == found.__name__)  # type: ignore[arg-type]
    return str(found.__doc__ or "")


@pytest.mark.parametrize("name", pdgw.__all__)
def test_every_public_name_of_pdgw_exists_and_is_documented(name: str) -> None:
    found = getattr(pdgw, name)
    assert documentation(found)
    assert name in dir(pdgw)
    assert f"`{name}" in (ROOT / "docs" / "tutorials" / "python-developer.md").read_text(encoding="utf-8")


def test_every_public_error_has_the_common_base() -> None:
    errors = [getattr(pdgw, name) for name in pdgw.__all__ if name.endswith("Error")]
    assert len(errors) == 4
    assert all(issubclass(item, pdgw.PdgwError) for item in errors)
    with pytest.raises(pdgw.PdgwError, match=r"telegram.*expected"):
        pdgw.telegram(999)
    with pytest.raises(pdgw.PdgwError):
        pdgw.parse_config("[can]")


@pytest.mark.parametrize("module", ["__init__", "__main__"])
def test_ctrl_c_during_import_prints_no_traceback(module: str) -> None:
    tree = ast.parse((ROOT / "pdgw" / f"{module}.py").read_text(encoding="utf-8"))
    loaded = {alias.name for item in tree.body if isinstance(item, ast.Import) for alias in item.names}
    loaded |= {str(item.module) for item in tree.body if isinstance(item, ast.ImportFrom)}
    assert loaded <= {"__future__", "gc", "signal"}


def test_file_names_may_be_text_as_in_the_readme(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text('[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n')
    assert [item.telegram for item in pdgw.load_config(str(file)).axis] == [1]
    assert pdgw.load_config(str(file)) == pdgw.load_config(file)
    eds = ROOT / "dsp406" / "eds" / "rotary.eds"
    assert pdgw.import_eds(str(eds), 1).text == pdgw.import_eds(eds, 1).text


def test_repr_of_public_objects_is_one_line() -> None:
    assert repr(pdgw.telegram(1)) == "<Telegram 1: STW1 NSOLL_A -> ZSW1 NIST_A>"
    assert repr(pdgw.telegram(1).setpoints) == "<setpoints of telegram 1: STW1 NSOLL_A>"
    assert repr(pdgw.signal("NSOLL_A")) == "<Signal NSOLL_A (N2): speed setpoint A>"
    with pytest.raises(ProfidriveError, match=r"'stw9' is not allowed, .* did you mean .*STW1.*\?"):
        pdgw.signal("stw9")


def test_public_names_are_the_original_objects() -> None:
    assert pdgw.__version__ == version("profidrive-gateway")
    assert pdgw.telegram(1).setpoints.names == ("STW1", "NSOLL_A")
    assert (pdgw.GatewayError, pdgw.CanopenError, pdgw.ProfidriveError) == (GatewayError, CanopenError, ProfidriveError)
    with pytest.raises(AttributeError, match="Unknown"):
        pdgw.Unknown  # noqa: B018


# -- examples ---------------------------------------------------------------------------------------------------------


def run_example(name: str, capsys: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    """The lines an example prints."""
    before = sys.argv
    sys.argv = [name, *arguments]
    try:
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    finally:
        sys.argv = before
    return capsys.readouterr().out.splitlines()


def test_example_decode_a_frame(capsys: pytest.CaptureFixture[str]) -> None:
    head, *signals = run_example("decode_frame.py", capsys)
    assert "FrameID C001h" in head
    assert signals == ["STW1 047Fh", "NSOLL_A 50.000 %"]


def test_example_build_an_stw1(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_example("build_stw1.py", capsys) == ["OFF 047Eh, ON 047Fh", "04 7f 08 00"]


def test_example_iterate_a_capture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capture = tmp_path / "both.pcapng"
    write_capture(capture, 8)
    lines = run_example("iterate_capture.py", capsys, str(capture))
    assert len(lines) == 8
    assert "plc: axis 1: {'stw1': 1151, 'nsoll_a': 0}" in lines[0]
    assert "can: axis 1: {'target_velocity': 0, 'controlword': 15}" in lines[1]


def test_example_read_a_parameter(capsys: pytest.CaptureFixture[str]) -> None:
    with serving(configuration(axis(1))) as (daemon, client), reached(daemon):
        lines = run_example("read_parameter.py", capsys, str(client.address[1]))
    assert lines[0] == "922 0 1"
    assert len(lines) == 3


def test_unknown_parameter_and_missing_device_are_reported() -> None:
    with pytest.raises(GatewayError, match="P922"):
        pdgw.read_parameters(("127.0.0.1", 9), 1, "speed")
    with pytest.raises(GatewayError, match="no answer on the record channel"):
        pdgw.read_parameters(("127.0.0.1", 9), 1, "P922")


def test_records_of_a_capture_that_is_not_there() -> None:
    with pytest.raises(GatewayError, match="cannot be read"):
        next(pdgw.read_records("nowhere.pcap"))
    with pytest.raises(ProfidriveError, match="telegram"):
        next(pdgw.read_records("nowhere.pcap", telegrams=[77]))


def test_example_a_gateway_inside_a_test(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_example("gateway_in_a_test.py", capsys) == ["the drive turned, and stopped when the PLC fell silent"]
