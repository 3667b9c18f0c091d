"""The Debian package without its Python packages: contents, manual pages, scripts. `make test-deb` installs the whole one."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from pdgw.tools.command_table import COMMANDS
from pdgw.workshop.debian.build import CONFFILES, DEPLOY, SCRIPTS, contents, package
from pdgw.workshop.debian.man import escaped, pages
from tests.support.buses import PATIENCE_S

EPOCH = "1700000000"
"""Before any file was written: dpkg-deb changes later times only."""
needs_dpkg = pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="dpkg-deb is not installed")


def run(*command: str, text: str | None = None) -> str:
    done = subprocess.run(command, input=text, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert (done.returncode, done.stderr) == (0, ""), command
    return done.stdout


@pytest.fixture(scope="module")
def manual() -> dict[str, str]:
    return pages("0.9.0")


def test_every_command_has_a_manual_page_with_its_options(manual: dict[str, str]) -> None:
    assert manual.keys() == {"pdgw.1", *(f"pdgw-{name}.1" for name in COMMANDS)}
    assert r".B \-\-simulate" in manual["pdgw-run.1"]
    assert ".SS pdgw trace save\n" in manual["pdgw-trace.1"]
    assert r"Example: pdgw status 1" in manual["pdgw-status.1"]
    for name in COMMANDS:
        assert f".BR pdgw\\-{name} (1)" in manual["pdgw.1"]


def test_text_of_a_manual_page_is_escaped_for_roff() -> None:
    assert escaped(".SH is 'a\\b'") == r"\&.SH is 'a\eb'"
    assert escaped("two\n  lines -v") == r"two lines \-v"


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")
def test_groff_accepts_the_manual_pages(manual: dict[str, str]) -> None:
    shown = run("groff", "-man", "-ww", "-Tascii", text="".join(manual.values()))
    assert "pdgw-timeline" in shown


@needs_dpkg
def test_the_package_has_units_users_and_documents_and_is_the_same_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, manual: dict[str, str]
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", EPOCH)
    monkeypatch.setattr("pdgw.workshop.debian.build.pages", lambda _: manual)
    made = []
    for name in ("one", "two"):
        contents(tmp_path / name, "0.9.0")
        made.append(package(tmp_path / name, "0.9.0-1", tmp_path / f"{name}-out"))
    assert made[0].name == "profidrive-gateway_0.9.0-1_all.deb"
    assert made[0].read_bytes() == made[1].read_bytes()
    listed = run("dpkg-deb", "--contents", str(made[0]))
    assert {line.split()[1] for line in listed.splitlines()} == {"root/root"}
    for path in (
        "./usr/lib/systemd/system/pdgw@.service",
        "./usr/lib/systemd/system/pdgw-web@.service",
        "./usr/lib/sysusers.d/pdgw.conf",
        "./usr/share/man/man1/pdgw-run.1.gz",
        "./opt/pdgw/bin/python3 -> /usr/bin/python3.",
        "./usr/bin/pdgw -> /opt/pdgw/bin/pdgw",
        *(f"./{name}" for name in CONFFILES),
    ):
        assert f" {path}" in listed, path
    fields = run("dpkg-deb", "--field", str(made[0]), "Depends", "Version")
    assert "python3 (>= 3." in fields
    assert "systemd-standalone-sysusers" in fields


def test_the_units_start_the_program_where_the_package_has_it() -> None:
    for path in (DEPLOY / "systemd").glob("*@.service"):
        assert "\nExecStart=/opt/pdgw/bin/pdgw " in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", SCRIPTS)
def test_no_script_of_the_package_starts_a_gateway(name: str) -> None:
    path = DEPLOY / "debian" / name
    run("sh", "-n", str(path))
    text = path.read_text(encoding="utf-8")
    assert set(re.findall(r"systemctl ([\w-]+)", text)) <= {"daemon-reload", "list-units", "stop"}
