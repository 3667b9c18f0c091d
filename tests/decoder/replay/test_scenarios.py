"""The scenarios of the documents' tour and of the package, in virtual time: what the gateway records is replayed equal."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.durations import SECOND
from pdgw.gateway.configuration.file import simulated
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario_file import load_scenario
from tests.support.gateways.recorded_daemon import differences, recorded, replay_of
from tests.tour.console import File, steps
from tests.tour.tour import DOCUMENTS, ROOT

LONGEST_NS = 20 * SECOND
"""Of a scenario without an end."""
SCENARIOS = {path.name: path.read_text() for path in (ROOT / "tools" / "scenarios").glob("[!d]*.yaml")} | {
    item.name: item.text
    for path in DOCUMENTS
    for item in steps(path.read_text())
    if isinstance(item, File) and item.name.endswith(".yaml")
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_is_replayed_equal(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(SCENARIOS[name])
    scenario = load_scenario(path)
    with recorded(simulated(scenario.telegrams), tmp_path) as plc:
        engine = Engine(scenario, plc.endpoint)
        while not engine.finished and plc.loop.now() < LONGEST_NS:
            engine.step(plc.loop.now())
            plc.exchange()
        assert engine.passed, [result for result in engine.results if not result.passed]
    for result in replay_of(tmp_path):
        assert not differences([result])
        assert result.steps > 700
