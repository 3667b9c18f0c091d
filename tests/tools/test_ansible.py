"""The Ansible collection: its example inventory gives valid configurations, and its role starts no gateway."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from pdgw.gateway.configuration.file import load_config
from tests.test_package import PROJECT, ROOT

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
