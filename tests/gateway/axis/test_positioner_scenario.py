"""The scenario of the positioner, in virtual time on the axis machine and the simulated drive."""

from __future__ import annotations

from pathlib import Path

from pdgw.gateway.configuration.file import simulated
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.scenario_file import load_scenario
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.rig import Rig

SCENARIO = Path(__file__).parents[3] / "tools" / "scenarios" / "positioner.yaml"
CYCLE = 4_000_000


def test_the_scenario_of_the_positioner_passes_on_a_simulated_axis() -> None:
    endpoint = PlcEndpoint([telegram(111)], CYCLE)
    engine = Engine(load_scenario(SCENARIO), endpoint)
    rig = Rig(111, positioner=simulated([111]).axis[0].settings_at(4).positioner)
    for _ in range(30_000):
        endpoint.actuals[0] = rig.actuals or None
        engine.step(rig.now)
        if engine.finished:
            break
        rig.values = dict(endpoint.setpoints[0])
        rig.step()
    assert engine.finished
    assert engine.passed, [result for result in engine.results if not result.passed]
    assert len(engine.results) >= 25
