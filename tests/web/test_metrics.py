"""The metrics of a fixed gateway, read by Prometheus' own tools; alerts and dashboard know no others."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import AxisState, Reason
from pdgw.gateway.links.new_frames import Verdict
from pdgw.profidrive.parameters.codec import ParameterAddress
from pdgw.tools.web.metrics import exposition
from pdgw.tools.web.status.watch import Watch
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, running, serving
from tests.support.page import ShownGateway, look

DEPLOY = Path(__file__).parents[2] / "deploy"
PROMTOOL = shutil.which("promtool")
needs_promtool = pytest.mark.skipif(PROMTOOL is None, reason="no promtool on this machine (apt-get install prometheus)")
ENCODER = "[[encoder]]\ndo_id = 3\nnode_id = 20\ntelegram = 83\nsimulate = true\n"
Samples = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def samples(text: str) -> Samples:
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


class Scraped:
    """A gateway with two axes and an encoder: axis 1 turns, axis 2 lost its node in operation."""

    def __init__(self) -> None:
        self.gateway = ShownGateway()
        slide = axis(1, more='simulate = true\nname = "slide"')
        with running(configuration(slide + axis(2) + ENCODER)) as daemon:
            plc = Plc(daemon, [1, 1, 83])
            plc.enable(0)
            plc.enable(1)
            plc.endpoint.set(0, {"NSOLL_A": 0x2000})
            drive_of(daemon, 2).node.power_off()
            plc.until(lambda: daemon.axes[1].faults and daemon.axes[1].reason is Reason.DRIVE_OFFLINE, "axis 2 lost")
            self.gateway.show(daemon)
            self.watch = Watch(daemon.config, self.gateway)
        self.expose = exposition(self.watch)

    def look(self) -> str:
        look(self.watch)
        return self.expose().decode()


@pytest.fixture(scope="module")
def scraped() -> Scraped:
    return Scraped()


@pytest.fixture(scope="module")
def text(scraped: Scraped) -> str:
    return scraped.look()


def value(text: str, name: str, **labels: str) -> float | None:
    return samples(text).get((name, tuple(sorted(labels.items()))))


def test_axes_have_one_state_each(text: str) -> None:
    found = [key for key, one in samples(text).items() if key[0] == "pdgw_axis_state" and one == 1]
    assert {labels for _, labels in found} == {
        (("do", "1"), ("state", "obeys")),
        (("do", "2"), ("state", "not_on_the_bus")),
        (("do", "3"), ("state", "waits")),
    }
    assert sum(key[0] == "pdgw_axis_state" for key in samples(text)) == 3 * len(AxisState)


def test_why_an_axis_is_blocked_and_its_faults(text: str) -> None:
    assert value(text, "pdgw_object_blocked", do="2", reason="drive_offline") == 1
    number = str(int(FaultNumber.NODE_LOST))
    assert value(text, "pdgw_fault_active", do="2", number=number) == 1
    assert value(text, "pdgw_faults_total", do="2", number=number) == 1
    assert value(text, "pdgw_node_online", do="2", node="2") == 0
    assert value(text, "pdgw_node_online", do="1", node="1") == 1
    assert value(text, "pdgw_object_blocked", do="1", reason="drive_offline") is None


def test_the_exchange_is_counted(text: str, scraped: Scraped) -> None:
    assert value(text, "pdgw_up") == value(text, "pdgw_plc_connected") == value(text, "pdgw_simulated") == 1
    assert (value(text, "pdgw_plc_frames_accepted_total") or 0) > 100
    reasons = {dict(labels)["reason"] for name, labels in samples(text) if name == "pdgw_frames_dropped_total"}
    assert reasons == {verdict.name.lower() for verdict in Verdict if verdict is not Verdict.ACCEPTED}
    cycles = value(text, "pdgw_cycle_seconds_count")
    assert cycles == sum(scraped.gateway.document["cycle_times"]["counts"])
    assert value(text, "pdgw_cycle_seconds_bucket", le="+Inf") == cycles
    assert value(text, "pdgw_cycle_time_seconds") == 0.004


def test_a_fault_is_active_until_it_is_acknowledged() -> None:
    gateway = ShownGateway()
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        plc.enable()
        watch = Watch(daemon.config, gateway)
        expose = exposition(watch)

        def exposed() -> str:
            gateway.show(daemon)
            look(watch)
            return expose().decode()

        drive_of(daemon).inject(7)
        plc.until(lambda: daemon.axes[0].reason is Reason.DRIVE_FAULT and daemon.axes[0].faults, "the fault")
        assert value(exposed(), "pdgw_fault_active", do="1", number="7") == 1
        drive_of(daemon).clear()
        plc.endpoint.set(0, {"STW1": 0x04FE})
        plc.until(lambda: daemon.axes[0].reason is not Reason.DRIVE_FAULT, "acknowledged")
        text = exposed()
    assert value(text, "pdgw_fault_active", do="1", number="7") is None
    assert value(text, "pdgw_faults_total", do="1", number="7") == 1


def test_requests_and_refusals_beside_the_exchange_are_counted() -> None:
    gateway = ShownGateway()
    with serving(configuration(axis(1))) as (daemon, client):
        aborts = daemon.axes[0].client.sdo.aborts
        client.request([ParameterAddress(922)])
        client.request([ParameterAddress(0x5FFF)])
        client.request([ParameterAddress(922), ParameterAddress(0x2FFE, 9, 1)])
        gateway.show(daemon)
        watch = Watch(daemon.config, gateway)
        look(watch)
        text = exposition(watch)().decode()
        refused = daemon.axes[0].client.sdo.aborts
    assert value(text, "pdgw_parameter_requests_total", do="1", result="answered") == 1
    assert value(text, "pdgw_parameter_requests_total", do="1", result="refused") == 2
    assert value(text, "pdgw_sdo_aborts_total", bus="can", node="1") == refused
    assert refused > aborts


def test_the_load_of_a_bus_is_planned_and_measured(scraped: Scraped) -> None:
    document = scraped.gateway.document
    text = scraped.look()
    planned = value(text, "pdgw_can_bus_load_ratio", bus="can", kind="planned")
    assert planned is not None
    assert 0.05 < planned < 1
    uptime = document["uptime_s"]
    for item in document["counters"]:
        if item["part"] == "bus can" and item["name"] in {"sent", "received"}:
            item["value"] += 2000
    document["uptime_s"] += 2
    try:
        measured = value(scraped.look(), "pdgw_can_bus_load_ratio", bus="can", kind="measured")
    finally:
        document["uptime_s"] = uptime
    assert measured is not None
    assert 2000 * 60 / 1_000_000 < measured < 2000 * 111 / 1_000_000, "2000 frames a second of 1 to 8 bytes at 1 Mbit/s"


def test_metrics_without_a_gateway_show_only_that(scraped: Scraped) -> None:
    scraped.gateway.failure = "stopped"
    try:
        assert set(samples(scraped.look())) == {("pdgw_up", ())}
    finally:
        scraped.gateway.failure = ""
    assert value(scraped.look(), "pdgw_up") == 1


def test_no_label_has_free_text_or_an_address(text: str) -> None:
    for name, labels in samples(text):
        for label, content in labels:
            assert re.fullmatch(r"[a-z0-9_.+-]+|\+Inf", content), f"{name} {label} {content}"


def names_in(texts: Iterator[str]) -> set[str]:
    return {name for text in texts for name in re.findall(r"\bpdgw_[a-z_]+\b", text)}


def test_alerts_and_dashboard_use_existing_metrics(text: str) -> None:
    board = json.loads((DEPLOY / "grafana" / "pdgw.json").read_text())
    asked = names_in(target["expr"] for panel in board["panels"] for target in panel["targets"])
    asked |= names_in(iter([(DEPLOY / "prometheus" / "alerts.yml").read_text()]))
    assert len(asked) > 10
    assert asked <= {name for name, _ in samples(text)}


@needs_promtool
def test_promtool_finds_nothing_wrong_with_the_metrics(text: str) -> None:
    done = subprocess.run([str(PROMTOOL), "check", "metrics"], input=text, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


@needs_promtool
@pytest.mark.parametrize(
    "command", [("test", "rules", "alerts.test.yml"), ("check", "config", "prometheus.yml")], ids=lambda parts: parts[0]
)
def test_promtool_accepts_the_deployed_files(command: tuple[str, ...]) -> None:
    folder = DEPLOY / "prometheus"
    done = subprocess.run([str(PROMTOOL), *command], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
