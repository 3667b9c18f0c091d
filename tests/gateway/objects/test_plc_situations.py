"""What the first line reports when the PLC's frames or words are the cause; the remedy cures it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.gateway.daemon import Daemon
from pdgw.gateway.reasons import AxisState, Enable, Reason
from pdgw.gateway.service.status import snapshot
from pdgw.tools.output.status_check import Health, check_line
from pdgw.tools.output.status_text import cause_sentence, status_lines
from tests.support.documents.plc_situations import (
    CONTROLLER_SITUATIONS,
    PLC_SITUATIONS,
    ControllerSituation,
    PlcSituation,
    at_controller_situation,
    at_plc_situation,
)
from tests.support.documents.situations import BREAKERS, settle
from tests.support.gateways.daemon import Plc, axis, configuration, running

_ASKED = 10
"""Calls of ``--check`` that have the same result."""


def judge(daemon: Daemon, situation: PlcSituation | ControllerSituation) -> None:
    document = snapshot(daemon)
    line = cause_sentence(document["causes"][0])
    assert [text for text in situation.says if text.lower() not in line.lower()] == [], line
    assert [text for text in situation.lacks if text.lower() in line.lower()] == [], line
    health, checked = check_line(document)
    assert (health, line in checked) == (situation.health, True), checked


@pytest.mark.parametrize("situation", PLC_SITUATIONS.values(), ids=PLC_SITUATIONS.keys())
def test_first_line_names_what_the_plc_sends_and_its_remedy_cures_it(situation: PlcSituation) -> None:
    with at_plc_situation(situation) as (daemon, plc):
        for _ in range(_ASKED):
            plc.exchange()
            judge(daemon, situation)
        situation.cure(plc, daemon)
        settle(plc)
        plc.until(lambda: daemon.axes[0].enable_status.state is AxisState.OBEYS, "in operation")


@pytest.mark.parametrize("situation", CONTROLLER_SITUATIONS.values(), ids=CONTROLLER_SITUATIONS.keys())
def test_first_line_names_what_the_controller_does_and_its_remedy_cures_it(
    situation: ControllerSituation, tmp_path: Path
) -> None:
    with at_controller_situation(situation, tmp_path / "store.json") as site:
        judge(site.daemon, situation)
        situation.cure(site)
        site.enable()
        assert site.daemon.axes[0].enable_status.state is AxisState.OBEYS


@pytest.mark.parametrize("title", [title for title, item in PLC_SITUATIONS.items() if "EMCY" not in item.says])
def test_a_drive_without_power_is_named_before_the_frames_of_the_plc(title: str) -> None:
    """Both are in the chain: the page and the axis view show the second one beside the first."""
    situation = PLC_SITUATIONS[title]
    with at_plc_situation(situation) as (daemon, plc):
        BREAKERS[Enable.NODE](plc, daemon)
        settle(plc)
        chain = {link.enable: link for link in daemon.axes[0].enable_status.chain}
        assert daemon.axes[0].enable_status.broken == chain[Enable.NODE]
        text = f"{chain[Enable.PLC].evidence}. {chain[Enable.PLC].remedy}"
        assert [part for part in situation.says if part.lower() not in text.lower()] == [], text


def test_a_second_plc_is_a_warning_beside_the_first_one() -> None:
    with running(configuration(axis(1))) as daemon:
        plc, second = Plc(daemon, [1]), Plc(daemon, [1], "other")
        plc.enable()
        for _ in range(100):
            plc.exchange()
            second.send()
        document = snapshot(daemon)
        assert document["axes"][0]["state_id"] == AxisState.OBEYS.name
        assert document["plc"]["refused_id"] == Reason.OTHER_SENDER.name
        health, line = check_line(document)
        assert health is Health.WARNING
        assert document["plc"]["refused"] in line
        assert "switch the other sender off" in " ".join(status_lines(document, 400))
