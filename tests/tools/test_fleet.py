"""``pdgw status --fleet``: one table by cause over the pages of an inventory."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.reasons import Reason
from pdgw.tools.output.fleet_table import lines, rows
from pdgw.tools.output.status_check import Health
from pdgw.tools.service import fleet
from pdgw.tools.service.fleet import Place, ask, places
from tests.support.cli import pdgw
from tests.support.status_pages import document, inventory, pages
from tests.test_package import PROJECT, ROOT


def body(name: str, reason: Reason | None = None) -> tuple[int, bytes]:
    return 200, json.dumps(document(name, reason)).encode()


def test_gateways_with_one_cause_are_one_row_and_the_worst_comes_first(tmp_path: Path) -> None:
    responses = [
        body("a"),
        body("b", Reason.NEEDS_OFF),
        body("c", Reason.NO_PLC),
        body("d", Reason.NEEDS_OFF),
        (503, b"{}"),
    ]
    with pages(responses) as served:
        ports = dict(zip("abcde", (port for port, _ in served), strict=True))
        done = pdgw("status", "--fleet", str(inventory(tmp_path / "hosts.yml", ports)))
        as_json = pdgw("status", "--json", "--fleet", str(tmp_path / "hosts.yml"))
    assert done.returncode == as_json.returncode == Health.UNKNOWN
    text = done.stdout.splitlines()
    assert text[0] == "5 gateways: 1 OK, 2 WARNING, 1 CRITICAL, 1 UNKNOWN"
    assert [line.split() for line in text if line[:1].isupper()] == [
        ["UNKNOWN", "1", "no_answer"],
        ["CRITICAL", "1", "no_plc"],
        ["WARNING", "2", "needs_off"],
    ]
    assert text[-1].strip() == "b, d"
    assert [(row["cause"], row["gateways"]) for row in json.loads(as_json.stdout)] == [
        ("no_answer", ["e"]),
        ("no_plc", ["c"]),
        ("needs_off", ["b", "d"]),
    ]


def test_fleet_without_causes_is_ok(tmp_path: Path) -> None:
    with pages([body("a")]) as ((port, _),):
        done = pdgw("status", "--fleet", str(inventory(tmp_path / "hosts.yml", {"a": port})))
    assert (done.returncode, done.stdout) == (0, "1 gateways: 1 OK\n")


def test_the_token_of_the_inventory_is_sent(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("0123456789abcdef\n")
    with pages([body("a")]) as ((port, requests),):
        pdgw(
            "status",
            "--fleet",
            str(inventory(tmp_path / "h.yml", {"a": port}, pdgw_token_file="token")),
        )
    assert requests[0].startswith(b"GET /api/v1/status HTTP/1.1\r\n")
    assert b"\r\nAuthorization: Bearer 0123456789abcdef\r\n" in requests[0]


@pytest.mark.parametrize(
    ("response", "error"),
    [
        ((503, b"{}"), "the page runs, but its gateway does not answer"),
        ((401, b"{}"), "HTTP status 401"),
        ((200, b"[]"), "the answer is not a status document"),
        ((200, b"<html>"), "Expecting value"),
        ((200, b" " * 200), "longer than 100 bytes"),
    ],
)
def test_invalid_status_answer_becomes_an_error_text(
    response: tuple[int, bytes], error: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fleet, "_LONGEST", 100)
    with pages([response]) as ((port, _),):
        answer = ask(Place("a", "127.0.0.1", port))
    assert answer.document is None
    assert error in answer.error
    assert ask(Place("a", "127.0.0.1", port)).error  # the port is closed
    assert ask(Place("a", "127.0.0.1", port, token_file="none")).error


def test_a_document_of_another_format_does_not_hide_the_others() -> None:
    table = rows({"a": {"schema": 9}, "b": document("b", Reason.NEEDS_OFF)}, {})
    assert [(row.cause, row.gateways) for row in table] == [("no_answer", ("a",)), ("needs_off", ("b",))]
    assert "unexpected format" in table[0].text
    assert all(len(line) <= 60 for line in lines(table, ["a", "b"], 60))


# -- the inventory ----------------------------------------------------------------------------------------------------

INVENTORY = """
all:
  vars: {pdgw_page_port: 9000}
  children:
    office: {hosts: {printer: }}
    gateways:
      vars: {pdgw_tls: true}
      children:
        presses:
          vars: {pdgw_tls: false}
          hosts:
            press-1: {ansible_host: 10.0.0.1, pdgw_page_port: 8421}
        conveyors:
      hosts: {spare: }
conveyors:
  hosts: {belt: {pdgw_token_file: web.token}}
"""


def test_hosts_of_the_group_have_the_variables_of_all_groups_around_them(tmp_path: Path) -> None:
    path = tmp_path / "hosts.yml"
    path.write_text(INVENTORY)
    assert places(path) == [
        Place("belt", "belt", 9000, tls=True, token_file=str(tmp_path / "web.token")),
        Place("press-1", "10.0.0.1", 8421, tls=False),
        Place("spare", "spare", 9000, tls=True),
    ]


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("gateways: [", "cannot be read"),
        ("- a", "not an Ansible inventory"),
        ("office: {hosts: {a: }}", "group gateways has no host"),
        ("gateways: {hosts: {a: {pdgw_page_port: 70000}}}", "pdgw_page_port 70000, expected 1 to 65535"),
        ("gateways: {hosts: {a: {pdgw_tls: 'no'}}}", "pdgw_tls 'no', expected true or false"),
        ("gateways: {children: {gateways: }}", "not an Ansible inventory"),
    ],
)
def test_invalid_inventory_is_one_error_line(text: str, error: str, tmp_path: Path) -> None:
    path = tmp_path / "hosts.yml"
    path.write_text(text)
    with pytest.raises(GatewayError, match=error):
        places(path)


def test_fleet_table_rejects_options_for_one_gateway(tmp_path: Path) -> None:
    done = pdgw("status", "--fleet", "hosts.yml", "--check", "--watch")
    assert done.returncode == 2
    assert "prints one table, not allowed with --watch, --check" in " ".join(done.stderr.replace("│", " ").split())


# -- the collection ---------------------------------------------------------------------------------------------------

COLLECTION = ROOT / "deploy" / "ansible"
ROLE = COLLECTION / "roles" / "gateway"
TASKS: list[dict[str, Any]] = yaml.safe_load((ROLE / "tasks" / "main.yml").read_text(encoding="utf-8"))


def test_the_example_inventory_is_read_by_the_command_too() -> None:
    found = {place.name: (place.host, place.port) for place in places(COLLECTION / "inventory" / "hosts.yml")}
    assert found == {
        "conveyor-1": ("192.168.10.21", 8420),
        "press-1": ("192.168.10.11", 8420),
        "press-2": ("192.168.10.12", 8420),
    }


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


@pytest.mark.parametrize(("host", "axes"), [("press-1", 2), ("conveyor-1", 1)])
def test_the_configuration_of_a_host_is_accepted(host: str, axes: int, tmp_path: Path) -> None:
    jinja2 = pytest.importorskip("jinja2", reason="no jinja2 (pip install 'profidrive-gateway[archive]')")
    inventory_dir = COLLECTION / "inventory"
    defaults = yaml.safe_load((ROLE / "defaults" / "main.yml").read_text(encoding="utf-8"))
    variables = defaults | dict(fleet._hosts(yaml.safe_load((inventory_dir / "hosts.yml").read_text())))[host]
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
