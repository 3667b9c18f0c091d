"""Reports of scenarios: what CI systems and people read of a run."""

from __future__ import annotations

import json
import signal
from html.parser import HTMLParser
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.commands.simulation.plc import Output
from pdgw.tools.output.reports import Check, Report
from tests.support.cli import pdgw

CHECKS = (
    Check("axis 1", "ready", "ZSW1.READY = 1", (), 0.25),
    Check("axis 2", "speed < 10 & falling", "NIST_A = 20", ("NIST_A = 20", "expected less"), 3.0),
)
REPORT = Report("a run", CHECKS, 'listen = "<any>"', {"gateway": "127.0.0.1"})


class Cells(HTMLParser):
    """The texts of a page, and that every element is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, _attributes: object) -> None:
        if tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def cells(page: str) -> list[str]:
    parser = Cells()
    parser.feed(page)
    parser.close()
    assert parser.open == []
    return parser.texts


def test_junit_has_a_case_for_each_check_and_the_facts_as_properties() -> None:
    suite = ElementTree.fromstring(REPORT.junit())[0]
    assert (suite.get("tests"), suite.get("failures"), suite.get("time")) == ("2", "1", "3.250")
    properties = {item.get("name"): item.get("value") for item in suite.iter("property")}
    assert properties["version"] == f"pdgw {version('profidrive-gateway')}"
    assert properties["configuration"] == 'listen = "<any>"'
    assert properties["date"] == suite.get("timestamp")
    good, bad = suite.iter("testcase")
    assert (good.get("classname"), good.get("name"), good.find("failure")) == ("axis 1", "ready", None)
    failure = bad.find("failure")
    assert failure is not None
    assert (failure.get("message"), failure.text) == ("NIST_A = 20", "NIST_A = 20\nexpected less")


def test_the_page_shows_failures_first_and_the_configuration() -> None:
    texts = cells(REPORT.page())
    assert texts.index("Failed") < texts.index("Passed")
    assert {"1 of 2 passed", "speed < 10 & falling", 'listen = "<any>"'} <= set(texts)
    assert "http" not in REPORT.page()


@given(text=st.text(max_size=40))
def test_any_text_gives_well_formed_files(text: str) -> None:
    report = Report(text, (Check(text, text, text, (text or "x",)),), text, {text: text})
    ElementTree.fromstring(report.junit())
    cells(report.page())


@pytest.mark.parametrize(("answered", "draws"), [(False, False), (True, False), (False, True)])
def test_missing_gateway_is_reported_while_the_scenario_waits(
    answered: bool, draws: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint = PlcEndpoint([telegram(1)], 4_000_000)
    output = Output(endpoint, 500, as_lines=draws)
    endpoint.counters["received"] = int(answered)
    for _ in range(600):
        endpoint.build()
        output.show(None, "")
    said = capsys.readouterr().err
    assert said.count("no datagram from a gateway: start one") == (not answered and not draws)


@pytest.mark.e2e
def test_scenario_writes_both_reports_and_suggests_a_gateway_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # those of the tests stay
    path = tmp_path / "story.yaml"
    waits = "{expect: {ZSW1: 0}, within: 20 ms}, {hold: 9999 s}, {expect: {ZSW1: 0}, within: 9999 s}"
    path.write_text(f"name: story\nsteps: [{waits}]\n")
    files = ["--junit", str(tmp_path / "r.xml"), "--html", str(tmp_path / "r.html")]
    files += ["--json", str(tmp_path / "r.json")]
    result = pdgw("sim", "plc", str(path), "--gateway", "127.0.0.1:9", *files)
    assert result.returncode == 1
    assert "the scenario did not reach a gateway: no datagram from a gateway: start one" in result.stderr
    assert json.loads((tmp_path / "r.json").read_text())["passed"] is False
    suite = ElementTree.parse(tmp_path / "r.xml").getroot()[0]
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("story", "2", "2")
    assert "no datagram from a gateway" in (tmp_path / "r.html").read_text()
