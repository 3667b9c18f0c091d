"""The motion telegrams through the whole gateway in virtual time: configuration, PDO mapping, frames, simulated drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pdgw.ds301.objects import Access, CanType, var
from pdgw.dsp402.states import State
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import simulated
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import shape
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario_file import load_scenario
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import ParameterAddress, Values
from pdgw.profidrive.signals import signal
from tests.support.gateways.daemon import (
    OFF,
    POSITIONER,
    SIMULATED_POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    exchanging,
    operating,
    running,
    serving,
    world_of,
)

SCENARIO = Path(__file__).parents[2] / "tools" / "scenarios" / "positioner.yaml"
HOME_SET = signal("ZSW1").bit("HOME_POSITION_SET", positioning=True).mask
DSC = "simulate = true\nfollowing_window = 4096\ndsc = "


def config(number: int, more: str) -> GatewayConfig:
    return configuration(axis(1, telegram_number=number, more=more))


def test_the_scenario_of_the_positioner_passes_through_the_gateway() -> None:
    with running(config(111, POSITIONER)) as daemon:
        world_of(daemon).drive("world", 1)
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
    with operating(config(105, f'{DSC}"{form}"')) as (daemon, plc):
        drive = drive_of(daemon)
        assert drive.node.read(0x6061) == mode
        assert [drive.node.read(0x60C2, sub) for sub in (1, 2)] == [4, -3], "4 ms"
        for _ in range(400):
            position = plc.value("G1_XIST1")
            error = 2000 - (position - (1 << 32) if position >> 31 else position)
            plc.endpoint.set(0, {"XERR": error, "KPC": 20_000})
            plc.exchange()
        assert abs(plc.value("G1_XIST1") - 2000) <= 5


@pytest.mark.parametrize("number", [9, 111])
@pytest.mark.parametrize(
    ("address", "value"),
    [
        (ParameterAddress(0x607E, 0, 0), Values(DataType.UNSIGNED8, (0x80,))),
        (ParameterAddress(0x608F, 1, 1), Values(DataType.UNSIGNED32, (4000,))),
    ],
    ids=["polarity", "unit"],
)
def test_polarity_or_unit_written_by_a_client_clears_the_home_position(
    number: int, address: ParameterAddress, value: Values
) -> None:
    """Also if the write ends within one cycle of the PLC."""
    counts = shape("counts")
    like = replace(counts, has=(*counts.has, var(0x607E, "Polarity", CanType.U8, Access.RW)))
    more = f"rated_acceleration_rpm_s = 1000\nacceleration_unit = 'inc/s/s'\n{POSITIONER}"
    axes = axis(1, telegram_number=number, more=more)

    def connect(daemon: Daemon) -> None:
        world_of(daemon).drive("world", 1, shape=like)

    config = configuration(axes, transport="cycle_time_ms = 32")
    with serving(config, 1, connect) as (daemon, client):
        plc = Plc(daemon, [number])
        plc.enable()
        homing = {"STW1": 0x0C3F, "SATZANW": 35, "MDI_VELOCITY": 1 << 28} if number == 9 else {"STW1": 0x0C3F}
        plc.endpoint.set(0, homing)
        plc.until(lambda: plc.value("ZSW1") & HOME_SET, "home position set")
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "off")
        assert plc.value("ZSW1") & HOME_SET
        with exchanging(plc):
            assert not client.request([address], [value])[0].failed
        plc.exchange()
        assert not plc.value("ZSW1") & HOME_SET


@pytest.mark.parametrize("form", ["position", "speed"])
def test_unit_that_changes_while_dsc_moves_the_axis_is_found(form: str) -> None:
    """With positions for each SYNC there is neither Target Velocity nor a new setpoint."""
    with operating(config(105, f'{DSC}"{form}"')) as (daemon, plc):
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
    with operating(configuration(axes, transport="watchdog_factor = 250")) as (daemon, plc):
        for way in range(0, 10_000, 100):
            plc.endpoint.set(0, {"XERR": way - plc.value("G1_XIST1"), "KPC": 20_000})
            plc.exchange()
        drive = drive_of(daemon).node.model
        assert drive.velocity_actual > 0
        plc.silent = True
        plc.exchange(40)
        rest = drive.position
        plc.exchange(10)
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
    with operating(config(number, "simulate = true")) as (_, plc):
        plc.endpoint.set(0, {"NSOLL_B": 1 << 28})
        plc.until(lambda: plc.value("NIST_B") == 1 << 28, "750 rpm")


def test_111_shows_the_numbers_of_faults_and_warnings() -> None:
    with operating(config(111, SIMULATED_POSITIONER)) as (daemon, plc):
        assert (plc.value("FAULT_CODE"), plc.value("WARN_CODE")) == (0, 0)
        plc.endpoint.set(0, {"STW1": 0x043F})
        plc.exchange(5)
        plc.endpoint.set(0, {"POS_STW1": 99, "STW1": 0x047F})
        plc.until(lambda: plc.value("WARN_CODE") == FaultNumber.POSITIONER, "unknown block")
        plc.endpoint.set(0, {"STW1": 0x042F})
        plc.until(lambda: plc.value("WARN_CODE") == 0, "rejected")
        drive_of(daemon).node.model.inject(7)
        plc.until(lambda: plc.value("FAULT_CODE") == 7, "over-current")
