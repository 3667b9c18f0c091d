"""``pdgw status --check``, ``--watch``: a line and a code monitoring systems know; a picture that comes again."""

from __future__ import annotations

import json
from typing import Any

import pytest

from pdgw.gateway.service.causes import causes
from pdgw.gateway.service.status import snapshot
from pdgw.tools.commands.gateway.status import status
from pdgw.tools.output.status_text import Health, check_line
from tests.support.cli import pdgw
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, drive_of, running
from tests.support.processes import free_tcp_port


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    """A gateway that is well."""
    encoder = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
    with running(configuration(axis(1) + encoder)) as daemon:
        plc = Plc(daemon, [1, 81])
        plc.endpoint.set(1, {"STW2_ENC": 0x0400})
        plc.enable()
        plc.until(lambda: daemon.encoders[0].reason is None, "the encoder obeys")
        return snapshot(daemon)


def changed(document: dict[str, Any], **keys: object) -> dict[str, Any]:
    """The same with other values of the first axis."""
    axes = [document["axes"][0] | keys]
    return document | {"axes": axes, "causes": causes([*axes, *document["encoders"]])}


def test_check_rejects_other_output_formats() -> None:
    done = pdgw("status", "--check", "--json", "--watch")
    assert done.returncode == 2
    assert "prints one line, not allowed with --json, --watch" in done.stderr


def test_check_of_a_gateway_without_problems_is_ok(document: dict[str, Any]) -> None:
    health, line = check_line(document)
    assert health == Health.OK == 0
    assert line.startswith("OK - pdgw: PLC connected, 2 of 2 in operation | objects=2 obeying=2 findings=0 uptime=")


@pytest.mark.parametrize(
    ("state", "health"),
    [("OFF", 0), ("STARTING", 1), ("WAITS", 1), ("STOPPING", 1), ("FAULT", 2), ("NOT_ON_THE_BUS", 2)],
)
def test_the_state_of_an_axis_decides(document: dict[str, Any], state: str, health: int) -> None:
    found, line = check_line(changed(document, state_id=state, state=state.title(), reason="that is why"))
    assert found == health
    assert ("axis 1 " in line) == (health > 0)
    assert ("that is why" in line) == (health > 0)


def test_the_worst_comes_first_and_everything_is_in_one_line(document: dict[str, Any]) -> None:
    warning = {"active": True, "text": "a warning\nof two lines"}
    worse = changed(document, faults=[warning]) | {"buses": [{"name": "can0", "healthy": False}]}
    health, line = check_line(worse | {"plc": document["plc"] | {"connected": False}})
    assert health == Health.CRITICAL
    assert line.startswith("CRITICAL - pdgw: no PLC; bus can0 lost; axis 1: a warning of two lines |")
    assert check_line(changed(document, faults=[warning]))[0] == Health.WARNING
    assert check_line(changed(document, faults=[warning | {"active": False}]))[0] == Health.OK


def test_a_drive_in_fault_is_critical() -> None:
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 1, "ready")
        assert check_line(snapshot(daemon))[0] == Health.OK
        drive_of(daemon).inject(7)
        plc.until(lambda: check_line(snapshot(daemon))[0] == Health.CRITICAL, "told")


def test_no_gateway_is_unknown() -> None:
    done = pdgw("status", "--check", "--port", str(free_tcp_port()))
    assert done.returncode == Health.UNKNOWN == 3
    assert done.stdout.startswith("UNKNOWN - no gateway answers")
    assert done.stderr == ""


def test_watch_queries_repeatedly(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    class EnoughError(Exception):
        """The user's Ctrl-C."""

    answers = iter(range(3))

    def pause(_: float) -> None:
        if next(answers) == 2:
            raise EnoughError

    monkeypatch.setattr("pdgw.tools.commands.gateway.status.time.sleep", pause)
    with pytest.raises(EnoughError):
        status(free_tcp_port(), watch=True, as_json=True)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert all("no gateway answers" in json.loads(line)["error"] for line in lines)


def test_watch_ends_with_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    def pause(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pdgw.tools.commands.gateway.status.time.sleep", pause)
    done = pdgw("status", "--watch", "--port", str(free_tcp_port()))
    assert "retry every second" in done.stdout
    assert done.returncode == 130
    assert "Traceback" not in done.stderr
