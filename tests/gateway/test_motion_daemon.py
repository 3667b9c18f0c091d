"""The motion telegrams through the whole gateway in virtual time: configuration, PDO mapping, frames, simulated drives."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.dsp402.states import State
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.example import simulated
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.reasons import FaultNumber, Reason
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import shape
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario_file import load_scenario
from tests.support.gateways.daemon import (
    POSITIONER,
    SIMULATED_POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    running,
    world_of,
)

SCENARIO = Path(__file__).parents[2] / "tools" / "scenarios" / "positioner.yaml"
DSC = "simulate = true\nfollowing_window = 4096\ndsc = "


def config(number: int, more: str) -> GatewayConfig:
    return configuration(axis(1, telegram_number=number, more=more))


@pytest.mark.parametrize("like", ["engel", "csp"])
def test_the_scenario_of_the_positioner_passes_through_the_gateway(like: str) -> None:
    with running(config(111, POSITIONER)) as daemon:
        world_of(daemon).drive("world", 1, shape=shape(like))
        plc = Plc(daemon, [111])
        engine = Engine(load_scenario(SCENARIO), plc.endpoint)
        while not engine.finished:
            engine.step(plc.loop.now())
            plc.exchange()
        assert engine.passed, [result for result in engine.results if not result.passed]


def test_every_telegram_can_be_simulated_by_number_alone() -> None:
    for number in (4, 5, 6, 7, 102, 103, 105, 106, 110, 111):
        assert simulated([number] * 2).axis[1].telegram == number


@pytest.mark.parametrize(("form", "mode"), [("position", 8), ("speed", 9)])
def test_dsc_through_the_gateway_holds_a_position(form: str, mode: int) -> None:
    with running(config(105, f'{DSC}"{form}"')) as daemon:
        plc = Plc(daemon, [105])
        plc.enable()
        drive = drive_of(daemon)
        assert drive.node.read(0x6061) == mode
        assert [drive.node.read(0x60C2, sub) for sub in (1, 2)] == [4, -3], "4 ms"
        for _ in range(400):
            position = plc.value("G1_XIST1")
            error = 2000 - (position - (1 << 32) if position >> 31 else position)
            plc.endpoint.set(0, {"XERR": error, "KPC": 20_000})
            plc.exchange()
        assert abs(plc.value("G1_XIST1") - 2000) <= 5


@pytest.mark.parametrize("form", ["position", "speed"])
def test_unit_that_changes_while_dsc_moves_the_axis_is_found(form: str) -> None:
    """With positions for each SYNC there is neither Target Velocity nor a new setpoint."""
    with running(config(105, f'{DSC}"{form}"')) as daemon:
        plc = Plc(daemon, [105])
        plc.enable()
        drive, way = drive_of(daemon), 0

        def moved() -> object:
            nonlocal way
            way += 20
            plc.endpoint.set(0, {"XERR": way - plc.value("G1_XIST1"), "KPC": 20_000})
            return daemon.axes[0].faults

        for _ in range(50):
            moved()
            plc.exchange()
        assert not daemon.axes[0].faults
        drive.do(lambda node: node.values.__setitem__((0x6094, 1), 10))
        plc.until(moved, "the fault")
        assert daemon.axes[0].faults[0].number == FaultNumber.VELOCITY
        assert "6094h/1 was 1h and is Ah now" in daemon.axes[0].faults[0].text


@pytest.mark.parametrize("form", ["position", "speed"])
def test_with_a_watchdog_of_a_second_dsc_does_not_turn_on_when_the_plc_is_silent(form: str) -> None:
    axes = axis(1, telegram_number=105, more=f'{DSC}"{form}"')
    with running(configuration(axes, transport="watchdog_factor = 250")) as daemon:
        plc = Plc(daemon, [105])
        plc.enable()
        for way in range(0, 10_000, 100):
            plc.endpoint.set(0, {"XERR": way - plc.value("G1_XIST1"), "KPC": 20_000})
            plc.exchange()
        drive = drive_of(daemon).node.model
        assert drive.velocity_actual > 0
        plc.silent = True
        for _ in range(40):
            plc.exchange()
        rest = drive.position
        for _ in range(10):
            plc.exchange()
        assert (drive.velocity_actual, drive.state, drive.position) == (0, State.OPERATION_ENABLED, rest)
        assert daemon.link.connected
        assert snapshot(daemon)["axes"][0]["reason"] == Reason.DSC_OUT_OF_DATE.value


@pytest.mark.parametrize("number", [5, 6, 105, 106])
def test_a_dsc_telegram_needs_to_know_where_the_loop_is_closed(number: int) -> None:
    with pytest.raises(
        GatewayError, match=f'telegram = {number} needs dsc = "position" or "speed", and following_window'
    ):
        config(number, "simulate = true")


@pytest.mark.parametrize("number", [102, 103, 4])
def test_speed_telegrams_turn_through_the_gateway(number: int) -> None:
    with running(config(number, "simulate = true")) as daemon:
        plc = Plc(daemon, [number])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_B": 1 << 28})
        plc.until(lambda: plc.value("NIST_B") == 1 << 28, "750 rpm")


def test_111_shows_the_numbers_of_faults_and_warnings() -> None:
    with running(config(111, SIMULATED_POSITIONER)) as daemon:
        plc = Plc(daemon, [111])
        plc.enable()
        assert (plc.value("FAULT_CODE"), plc.value("WARN_CODE")) == (0, 0)
        plc.endpoint.set(0, {"STW1": 0x043F})
        for _ in range(5):
            plc.exchange()
        plc.endpoint.set(0, {"POS_STW1": 99, "STW1": 0x047F})
        plc.until(lambda: plc.value("WARN_CODE") == FaultNumber.POSITIONER, "unknown block")
        plc.endpoint.set(0, {"STW1": 0x042F})
        plc.until(lambda: plc.value("WARN_CODE") == 0, "rejected")
        drive_of(daemon).node.model.inject(7)
        plc.until(lambda: plc.value("FAULT_CODE") == 7, "over-current")
