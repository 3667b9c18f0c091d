"""``pdgw.Gateway``, its PLC and the fixtures for pytest, as a test of a machine uses them."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import pdgw
from pdgw.gateway.configuration.file import config_text
from tests.support.gateways.daemon import axis, configuration, drive_of

pytest_plugins = "pdgw.pytest_plugin"


@pytest.fixture
def gateway_config() -> pdgw.GatewayConfig:
    encoder = axis(9, telegram_number=81, more='simulate = true\nmotion = "shaft=7"').replace("[[axis]]", "[[encoder]]")
    return configuration(axis(4) + axis(7, more="simulate = true\nrated_speed_rpm = 2000") + encoder)


def test_one_axis_by_its_do_id_turns_with_a_speed_in_rpm(gateway: pdgw.Gateway, plc: pdgw.Plc) -> None:
    plc.run(3, 7, on=True, speed="1000 rpm")
    assert plc.actual("NIST_A", 7) == pytest.approx(0x2000, abs=0x20)
    assert plc.actual("NIST_A") == 0
    assert "in operation" in gateway.sentence(7).lower()
    plc.run(2, 7, on=False, expect={"ZSW1.OPERATION_ENABLED": 0})
    plc.exchange(1, 4, STW1=0x047E)
    assert plc.endpoint.setpoints[0]["STW1"] == 0x047E


def test_a_fault_is_injected_and_the_reason_is_shown(gateway: pdgw.Gateway, plc: pdgw.Plc) -> None:
    plc.run(3, 7, on=True)
    gateway.device(7).inject("motor feedback")
    plc.exchange(0.1)
    assert gateway.sentence(7) == gateway.status()["axes"][1]["sentence"]
    assert gateway.sentence(7).startswith("Fault: EMCY 7305h motor feedback")
    with pytest.raises(AssertionError, match="READY_TO_SWITCH_ON = 0"):
        plc.run(4, 7, on=True)
    gateway.device(7).clear()
    plc.run(3, 7, ack=True)
    plc.run(3, 7, on=True)


def test_the_fixtures_are_of_one_gateway(gateway: pdgw.Gateway, world: pdgw.World, plc: pdgw.Plc) -> None:
    assert world is gateway.world
    assert plc is gateway.plc
    plc.run(3, 9, on=True)
    gateway.device(9).inject("position-error")
    plc.until(lambda: "EMCY 1000h" in gateway.sentence(9), "the encoder reports its error")


def test_errors_name_what_is_allowed(gateway: pdgw.Gateway, plc: pdgw.Plc) -> None:
    for wrong, text in (
        (lambda: plc.exchange(0, 5), r"do_id = 5: not in the configuration, allowed: \[4, 7, 9\]"),
        (lambda: gateway.device(5), r"do_id = 5: no simulated device, allowed: \[4, 7, 9\]"),
        (lambda: gateway.sentence(5), r"do_id = 5: not in the configuration, allowed: \[4, 7, 9\]"),
        (lambda: plc.run(1, speeed="5 rpm"), "speeed"),
        (lambda: plc.run(1, 7, mdi={"to": 5}), "mdi"),
        (lambda: plc.actual("NIST_X"), r"'NIST_X' is not in the telegram.*did you mean.*NIST_A"),
        (lambda: plc.actual("NIST_A"), "no valid actual values: "),
        (lambda: plc.actual("NIST_A", 5), "do_id = 5"),
    ):
        with pytest.raises(pdgw.GatewayError, match=text):
            wrong()
    with pytest.raises(AssertionError, match=r"not within 0\.1 s"):
        plc.run(0.1, 7, on=True)
    plc.run(3, 7, on=True)
    late = r"NIST_A 1000 rpm \+- 10 rpm: NIST_A = .*rpm; expect axis 2: not within 0\.1 s"
    with pytest.raises(AssertionError, match=late):
        plc.run(0.1, 7, speed="1000 rpm", expect={"NIST_A": "1000 rpm +- 10 rpm"})
    for device, wrong_fault, known in (
        (7, "motor", "5 motor feedback"),
        (7, 13, "12 CANopen"),
        (9, 1, "position-error"),
    ):
        with pytest.raises(pdgw.CanopenError, match=known):
            gateway.device(device).inject(wrong_fault)


def test_habit_is_injected_by_its_name_and_cleared(gateway: pdgw.Gateway, plc: pdgw.Plc) -> None:
    plc.run(3, 7, on=True)
    gateway.device(7).inject("deaf")
    plc.exchange(0.1)
    gateway.device(7).inject("slow-sdo delay_ms=20")
    node = drive_of(gateway.daemon, 7).node
    assert node.faults == ["deaf", "slow-sdo"]
    gateway.device(7).clear()
    assert node.faults == []
    for device, wrong, known in (
        (7, "deff", r"12 CANopen; .*deaf.*did you mean deaf\?"),
        (9, "light speed=2", "no parameter"),
    ):
        with pytest.raises(pdgw.CanopenError, match=known):
            gateway.device(device).inject(wrong)


@pytest.mark.parametrize("value", [1500, -3.5, "1500", "-20"])
def test_speed_without_a_unit_is_an_error_that_names_units(plc: pdgw.Plc, value: object) -> None:
    with pytest.raises(pdgw.GatewayError, match=rf'speed = {value}: the unit is missing: "{value} rpm" or "{value} %"'):
        plc.run(1, speed=value)
    plc.run(1, speed=0)


def test_gateway_without_devices_names_the_key() -> None:
    with pdgw.Gateway(configuration(axis(1, more=""))) as gateway:
        with pytest.raises(pdgw.GatewayError, match=r"no bus has a device: set simulate = true"):
            gateway.plc.run(1, on=True)
        gateway.world.drive("world", 1)
        gateway.plc.run(10, on=True)


@pytest.mark.parametrize("module", ["pdgw.peers.world.gateway", "pdgw.profidrive.telegrams"])
def test_examples_in_docstrings_are_true(module: str) -> None:
    found = doctest.testmod(importlib.import_module(module), optionflags=doctest.ELLIPSIS)
    assert found.attempted
    assert not found.failed


def test_gateway_takes_the_path_of_its_configuration(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(config_text(configuration(axis(4))))
    for path in (file, str(file)):
        with pdgw.Gateway(path) as gateway:
            gateway.plc.run(3, on=True)
            assert gateway.plc.actual("ZSW1.OPERATION_ENABLED") == 1
