"""Cycles of a controller below one millisecond: granted where the configured cycle is as short, and exchanged in full."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pdgw.durations import MS
from pdgw.gateway.errors import GatewayError
from pdgw.peers.controller.controller import Phase
from pdgw.peers.controller.plc import project_of
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.blocks.connect_blocks import TICK_NS
from pdgw.profinet.connection.cpm import Verdict
from tests.support.gateways.daemon import axis, drive_of
from tests.support.gateways.profinet_daemon import OFF, configuration, plant

SPEED = 0x1000
LASTING_NS = 100 * MS


@pytest.mark.parametrize("clock", [8, 16])
def test_drive_follows_and_stops_in_cycles_below_one_millisecond(tmp_path: Path, clock: int) -> None:
    cycle_ns = clock * TICK_NS
    transport = f"cycle_time_ms = {cycle_ns / MS}\nwatchdog_factor = 100"
    with plant(configuration(axis(1), tmp_path / "store.json", transport=transport)) as site:
        site.plc.project = replace(site.plc.project, send_clock=clock, reduction_ratio=1, data_hold=400)
        site.connect()
        site.enable(1, SPEED)
        cyclic = site.link.device.cm.cyclic

        def counts() -> tuple[int, int]:
            return cyclic.sent, cyclic.received[Verdict.ACCEPTED]

        before = counts()
        site.run(LASTING_NS)
        for now, then in zip(counts(), before, strict=True):
            assert now - then == pytest.approx(LASTING_NS // cycle_ns, abs=5)
        assert cyclic.missed == 0
        model = drive_of(site.daemon).model
        site.until(lambda: model.ramp.speed > 0, "motion")
        site.set(1, OFF)
        site.until(lambda: not model.ramp.speed and model.state.name != "OPERATION_ENABLED", "standstill without power")


@pytest.mark.parametrize(("configured", "clock"), [(4, 16), (1, 16), (0.5, 8), (0.3, 8)])
def test_cycle_shorter_than_the_configured_one_is_refused(tmp_path: Path, configured: float, clock: int) -> None:
    transport = f"cycle_time_ms = {configured}"
    with plant(configuration(axis(1), tmp_path / "store.json", transport=transport)) as site:
        site.plc.project = replace(site.plc.project, send_clock=clock, reduction_ratio=1)
        site.plc.start(site.loop.now())
        site.until(lambda: site.plc.phase is Phase.ENDED, "the refusal")
        assert "DB 81 02 0B" in site.plc.learned.ended


@pytest.mark.parametrize(
    ("cycle_ns", "clock", "ratio"), [(MS // 4, 8, 1), (MS // 2, 16, 1), (MS, 32, 1), (512 * MS, 32, 512)]
)
def test_project_of_the_simulated_plc_has_the_cycle(cycle_ns: int, clock: int, ratio: int) -> None:
    project = project_of("press-1", [telegram(1)], cycle_ns)
    assert (project.send_clock, project.reduction_ratio) == (clock, ratio)


@pytest.mark.parametrize("cycle_ns", [MS // 8, 3 * MS // 4, 3 * MS, 1024 * MS, MS + 1])
def test_project_of_the_simulated_plc_refuses_other_cycles(cycle_ns: int) -> None:
    with pytest.raises(GatewayError, match=r"allowed with --profinet are 0\.25, 0\.5, 1, 2"):
        project_of("press-1", [telegram(1)], cycle_ns)
