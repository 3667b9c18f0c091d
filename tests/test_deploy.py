"""What ``deploy/`` installs: the service manager accepts it, and it names commands, options and extras that exist.

The Ansible collection: its example inventory gives valid configurations, and its role starts no gateway.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from pdgw.gateway.configuration.file import load_config
from pdgw.tools.command_table import COMMANDS
from tests.support.buses import PATIENCE_S
from tests.test_package import PROJECT, ROOT

PINS, SUMS = "requirements.txt", "SHA256SUMS"
"""Files of a release."""
UNITS = ROOT / "deploy" / "systemd"
SERVICES = ("pdgw@.service", "pdgw-web@.service")
DROP_INS = ("realtime.conf", "raw-sockets.conf")
EXPOSURE = 45
"""Tenths of what systemd-analyze security may say at most: "OK"."""
needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


def installed(directory: Path, service: str, drop_in: str | None = None) -> Path:
    """The unit of one gateway, with a program this machine has."""
    text = (UNITS / service).read_text().replace("/opt/pdgw/bin/pdgw", "/bin/true").replace("%i", "line-3")
    unit = directory / service.replace("@", "-line-3")
    unit.write_text(text)
    if drop_in is not None:
        folder = directory / f"{unit.name}.d"
        folder.mkdir()
        shutil.copy(UNITS / drop_in, folder / drop_in)
    return unit


def systemd(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = ["systemd-analyze", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)


@needs_systemd
@pytest.mark.parametrize("drop_in", [None, *DROP_INS])
@pytest.mark.parametrize("service", SERVICES)
def test_systemd_accepts_the_units(tmp_path: Path, service: str, drop_in: str | None) -> None:
    unit = installed(tmp_path, service, drop_in)
    done = systemd("verify", "--man=no", str(unit))
    complaints = [line for line in done.stderr.splitlines() if tmp_path.name in line or unit.name in line]
    assert (done.returncode, complaints) == (0, [])


@needs_systemd
@pytest.mark.parametrize("service", SERVICES)
def test_systemd_units_have_few_privileges(tmp_path: Path, service: str) -> None:
    unit = installed(tmp_path, service)
    done = systemd("security", "--offline=true", f"--threshold={EXPOSURE}", str(unit))
    if "unrecognized option" in done.stderr or "Failed to" in done.stderr:
        pytest.skip(f"systemd-analyze security: {done.stderr.strip()}")
    assert done.returncode == 0, done.stdout[-400:]


def test_page_user_may_only_read_the_flight_recorder() -> None:
    gateway, page = ((UNITS / service).read_text().splitlines() for service in SERVICES)
    for lines in (gateway, page):
        assert {
            "NoNewPrivileges=yes",
            "ProtectSystem=strict",
            "ProtectProc=invisible",
            "CapabilityBoundingSet=",
        } <= set(lines)
        # A dynamic user's RuntimeDirectory is hidden from every other unit, and so the flight recorder from the page.
        assert not any(line.startswith("DynamicUser") for line in lines)
    assert {"User=pdgw", "RuntimeDirectoryMode=0750", "StateDirectoryMode=0700", "UMask=0027"} <= set(gateway)
    assert {"User=pdgw-web", "SupplementaryGroups=pdgw", "InaccessiblePaths=-/var/lib/pdgw"} <= set(page)
    users = [line.split() for line in (UNITS / "pdgw.conf").read_text().splitlines() if not line.startswith("#")]
    assert [user[:2] for user in users] == [["u", "pdgw"], ["u", "pdgw-web"], ["m", "pdgw-web"]]
    assert users[-1] == ["m", "pdgw-web", "pdgw"]


def test_the_page_never_gets_the_gateways_priority() -> None:
    gateway, page = ((UNITS / service).read_text().splitlines() for service in SERVICES)
    assert {"Type=notify", "WatchdogSec=2", "Restart=always", "RuntimeDirectoryPreserve=yes"} <= set(gateway)
    assert {"RestrictRealtime=yes", "Nice=10"} <= set(page)
    assert not any(line.startswith("AmbientCapabilities") for line in (*gateway, *page))


def commands() -> list[tuple[str, str]]:
    """Every call of ``pdgw`` in the files, by the file."""
    found = []
    for service in SERVICES:
        found += [
            (service, call) for call in re.findall(r"^ExecStart=\S*/pdgw (.*)$", (UNITS / service).read_text(), re.M)
        ]
    text = (ROOT / "deploy" / "Containerfile").read_text()
    found += [("Containerfile", call) for call in re.findall(r"CMD pdgw (\S+)", text)]
    found += [
        ("Containerfile", " ".join(re.findall(r'"([^"]+)"', call))) for call in re.findall(r"^CMD \[(.*)\]", text, re.M)
    ]
    return found


def test_systemd_units_start_commands_of_this_package() -> None:
    called = {(file, call.split()[0]) for file, call in commands()}
    assert called == {
        ("pdgw@.service", "run"),
        ("pdgw-web@.service", "web"),
        ("Containerfile", "status"),
        ("Containerfile", "run"),
    }
    assert {command for _, command in called} <= COMMANDS.keys()


def test_the_image_asks_for_extras_that_exist() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    asked = re.findall(r"(?:\.|profidrive-gateway)\[([a-z,]+)\]", (ROOT / "deploy" / "Containerfile").read_text())
    assert asked == ["web,mqtt"]
    assert {name for names in asked for name in names.split(",")} <= extras.keys()


def test_the_image_is_built_from_a_digest_and_from_pins_with_hashes() -> None:
    text = (ROOT / "deploy" / "Containerfile").read_text(encoding="utf-8")
    (base,) = re.findall(r"^ARG PYTHON=(\S+)$", text, re.MULTILINE)
    assert re.fullmatch(r"docker\.io/library/python:3\.11\.\d+-slim-bookworm@sha256:[0-9a-f]{64}", base)
    assert re.findall(r"^FROM (\S+)", text, re.MULTILINE) == ["${PYTHON}", "${PYTHON}"]
    # Its context is the folder of a release, with that release's pins.
    assert re.findall(r"--require-hashes -r (\S+)", text) == [PINS]
    assert "sha256sum --check --quiet " + SUMS in text


def test_the_role_installs_what_a_release_has_and_refuses_a_running_gateway() -> None:
    tasks = yaml.safe_load((ROOT / "deploy/ansible/roles/gateway/tasks/install.yml").read_text(encoding="utf-8"))
    first, *others = tasks
    assert first["ansible.builtin.command"]["argv"][:2] == ["systemctl", "list-units"]
    assert "running.stdout | length > 0" in first["failed_when"]
    assert "systemctl" not in str(others)
    assert "ansible.builtin.systemd_service" not in {key for task in tasks for key in task}
    text = str(others)
    assert f"/var/cache/pdgw/{PINS}" in text
    assert f"/opt/pdgw/{SUMS}" in text
    units = [item["name"] for task in others for item in task.get("loop", []) if isinstance(item, dict)]
    assert set(units) == {"pdgw.conf", *SERVICES}


COLLECTION = ROOT / "deploy" / "ansible"
ROLE = COLLECTION / "roles" / "gateway"
TASKS: list[dict[str, Any]] = yaml.safe_load((ROLE / "tasks" / "main.yml").read_text(encoding="utf-8"))


def test_the_role_starts_and_restarts_no_gateway() -> None:
    handlers = yaml.safe_load((ROLE / "handlers" / "main.yml").read_text(encoding="utf-8"))
    services = [
        item["ansible.builtin.systemd_service"]
        for item in (*TASKS, *handlers)
        if "ansible.builtin.systemd_service" in item
    ]
    assert len(services) == 2
    assert all(service.keys() <= {"name", "enabled", "daemon_reload"} for service in services)


def test_every_variable_of_the_role_has_a_default_and_every_file_exists() -> None:
    defaults = yaml.safe_load((ROLE / "defaults" / "main.yml").read_text(encoding="utf-8"))
    files = [path for path in COLLECTION.rglob("*") if path.is_file() and path.suffix in {".yml", ".j2"}]
    used = {name for path in files for name in re.findall(r"\bpdgw_\w+", path.read_text(encoding="utf-8"))}
    assert used == defaults.keys()
    templates = [task["ansible.builtin.template"]["src"] for task in TASKS if "ansible.builtin.template" in task]
    assert all((ROLE / "templates" / name).is_file() for name in templates)
    drop_ins = {item["name"] for task in TASKS for item in task.get("loop", []) if isinstance(item, dict)}
    assert drop_ins
    assert drop_ins <= {path.name for path in (ROOT / "deploy" / "systemd").iterdir()}
    galaxy = yaml.safe_load((COLLECTION / "galaxy.yml").read_text(encoding="utf-8"))
    assert galaxy["version"] == PROJECT["project"]["version"]


def hosts(group: dict[str, Any], inherited: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The variables of each host of a group."""
    variables = inherited | group.get("vars", {})
    found = {name: variables | (own or {}) for name, own in group.get("hosts", {}).items()}
    for inner in group.get("children", {}).values():
        found |= hosts(inner, variables)
    return found


@pytest.mark.parametrize(("host", "axes"), [("press-1", 2), ("conveyor-1", 1)])
def test_the_configuration_of_a_host_is_accepted(host: str, axes: int, tmp_path: Path) -> None:
    jinja2 = pytest.importorskip("jinja2", reason="no jinja2 (pip install 'profidrive-gateway[archive]')")
    inventory_dir = COLLECTION / "inventory"
    defaults = yaml.safe_load((ROLE / "defaults" / "main.yml").read_text(encoding="utf-8"))
    variables = hosts(yaml.safe_load((inventory_dir / "hosts.yml").read_text())["all"], defaults)[host]
    (tmp_path / "token").write_text("0123456789abcdef")
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters["to_json"] = json.dumps
    text = environment.from_string((ROLE / "templates" / "gateway.toml.j2").read_text(encoding="utf-8")).render(
        variables,
        ansible_managed="",
        inventory_hostname=host,
        inventory_dir=str(inventory_dir),
        lookup=lambda _, path: Path(path).read_text(encoding="utf-8"),
    )
    file = tmp_path / "gateway.toml"
    file.write_text(text.replace("/etc/pdgw/web.token", str(tmp_path / "token")))
    config = load_config(file)
    assert (config.name, len(config.axis), str(config.transport.peer)) == (host, axes, "192.168.20.1")
