"""Every fault of the catalogue against the gateway, and the harness itself against gateways that would fail."""

from __future__ import annotations

import json
from functools import cache

import pytest
from typer.testing import CliRunner

from pdgw.dsp406.encoder import EncoderClient
from pdgw.gateway.axis import encoder_machine
from pdgw.gateway.axis.executors.speed import SpeedExecutor
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.supervision.enable_guard import EnableGuard
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.reasons import Reason
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive.misbehaviour import DRIVE_MISBEHAVIOURS
from pdgw.peers.encoder.misbehaviour import ENCODER_MISBEHAVIOURS
from pdgw.profidrive.encoder import EncoderControl
from tests.long.commands.conformance import app
from tests.long.conformance import bench, encoders
from tests.long.conformance.faults import CASES, Activity, Case, Device, Reaction, Result, run_case
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, running

PATIENT = "watchdog_factor = 255"
"""The PLC of these tests is never lost, however busy the machine is."""


def case_id(case: Case) -> str:
    device = "" if case.device is Device.DRIVE else f" {case.device.value}"
    return f"{case.title} {case.activity.value}{device}"


@cache
def result_of(title: str) -> Result:
    """Run the case once in each process: a worker does not run the cases of the others."""
    return run_case(next(case for case in CASES if case_id(case) == title))


def test_every_fault_of_a_drive_and_of_an_encoder_has_a_case() -> None:
    for device, known in ((Device.DRIVE, DRIVE_MISBEHAVIOURS), (Device.ENCODER, ENCODER_MISBEHAVIOURS)):
        assert {case.fault for case in CASES if case.device is device} == set(known)
    assert len({case_id(case) for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", CASES, ids=case_id)
def test_gateway_reacts_to_each_fault_as_required(case: Case) -> None:
    result = result_of(case_id(case))
    assert result.failures == []
    assert not result.restarted
    assert not case.numbers or set(case.numbers) & set(result.numbers)
    if case.device is Device.DRIVE and case.reaction is not Reaction.GOES_ON:
        assert result.reason, "pdgw status tells why"


@pytest.mark.parametrize(
    ("title", "commands"),
    [
        # docs/translation.md "Losses": quick stop, then NMT stop when it does not answer, then configuration again.
        ("heartbeat-stops turning", ["CW 0002h", "NMT stop", "NMT enter pre operational"]),
        ("bus-off turning", ["CW 0002h", "NMT stop", "NMT enter pre operational"]),
        ("lost-pdos every=1 turning", ["CW 0002h", "NMT enter pre operational"]),
        ("reboot turning", ["NMT enter pre operational"]),
        ("unknown-state turning", ["CW 0002h"]),
        ("unknown-state, telegram 100 turning", ["CW 0002h"]),
        ("bouncing-status turning", ["CW 0002h"]),
        ("under-voltage turning", ["CW 0000h"]),
        ("wrong-identity from power-on", ["NMT enter pre operational"]),
    ],
)
def test_the_commands_come_in_their_order(title: str, commands: list[str]) -> None:
    sent = iter(result_of(title).sent)
    assert all(command in sent for command in commands), result_of(title).sent


@pytest.mark.parametrize("title", ["heartbeat-stops turning", "lost-pdos every=1 turning", "unknown-state turning"])
def test_unknown_state_is_a_quick_stop_not_a_coast(title: str) -> None:
    assert result_of(title).stopped == "quick stop"


@pytest.mark.parametrize(
    ("title", "shown"),
    [
        ("lost-pdos every=1, telegram 83 turning encoder", ["position", "IOPS BAD"]),
        ("wrong-identity from power-on encoder", ["IOPS BAD"]),
        ("input-voltage, telegram 82 turning encoder", ["position", "position, fault"]),
        ("frequency turning encoder", ["position", "position, warning"]),
        ("position-error turning encoder as G1 of a drive", ["position", "G1 error 0001h"]),
        ("heartbeat-stops turning encoder as G1 of a drive", ["position", "G1 error 0001h"]),
    ],
)
def test_how_the_position_is_shown(title: str, shown: list[str]) -> None:
    assert result_of(title).shown == shown


def test_a_sensor_error_is_shown_from_the_alarm_on() -> None:
    # The EMCY may come before the alarm is read: a fault is shown then, and the position is no longer good soon after.
    for title, error in (("position-error", "0001h"), ("memory, telegram 82", "1001h")):
        assert result_of(f"{title} turning encoder").shown[-1] == f"G1 error {error}, fault"


def test_an_encoder_that_is_lost_is_stopped_by_nmt_if_it_is_silent_and_configured_again() -> None:
    assert result_of("bus-off, telegram 82 turning encoder").sent[:2] == ["NMT stop", "NMT enter pre operational"]
    assert result_of("reboot, telegram 84 turning encoder").sent[:2] == ["NMT enter pre operational", "NMT start"]


# -- the harness ----------------------------------------------------------------------------------------------------------


@pytest.mark.planted
def test_a_gateway_that_starts_a_drive_again_by_itself_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    # It does not detect that the drive lost its enable input, and no second safeguard is active.
    monkeypatch.setattr(Interlock, "_changed", lambda self, drive, shown, now: drive)
    monkeypatch.setattr(EnableGuard, "step", lambda self, wish, controlword: True)
    result = run_case(Case("enable-input-dropped", Reaction.STOPS))
    assert result.restarted
    assert "started by itself" in result.failures


@pytest.mark.planted
def test_a_gateway_that_moves_on_when_a_limit_switch_is_released_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SpeedExecutor, "_held_at_limit", lambda self, target, *_: target)
    result = run_case(Case("limit-switch", Reaction.STANDS, (112,)))
    assert result.restarted
    assert "moves on by itself" in result.failures


def test_a_gateway_that_stops_without_need_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "PATIENCE_S", 2)
    result = run_case(Case("under-voltage", Reaction.GOES_ON))
    assert any("operation was left" in failure for failure in result.failures)
    assert any("unexpected fault numbers:" in failure for failure in result.failures)


def test_gateway_that_does_not_stop_or_report_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "PATIENCE_S", 0.5)
    assert "drive stopped not within" in run_case(Case("duplicated-pdos", Reaction.STOPS)).failures[0]
    assert "fault (106,) not within" in run_case(Case("two-pdos", Reaction.REFUSES, (106,), Activity.START)).failures[0]


def encoder_case(fault: str, reaction: Reaction, numbers: tuple[int, ...] = (), **values: int) -> Case:
    return Case(fault, reaction, numbers, values=values, telegram=81, device=Device.ENCODER)


@pytest.mark.planted
def test_a_gateway_that_shows_a_frozen_position_as_good_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    refresh = EncoderClient.refresh
    monkeypatch.setattr(EncoderClient, "refresh", lambda self, now: refresh(self, now) or self.generation > 0)
    monkeypatch.setattr(bench, "PATIENCE_S", 1)
    monkeypatch.setattr(encoders, "_STALE_NS", 500 * 1_000_000)
    result = run_case(encoder_case("lost-pdos", Reaction.LOSES, (101,), every=1))
    assert any("IOPS BAD not within" in failure for failure in result.failures)
    assert any("ms old was shown as good" in failure for failure in result.failures)


@pytest.mark.planted
def test_a_gateway_that_forgets_a_fault_without_an_acknowledge_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    step = EncoderControl.step

    def forgetful(self: EncoderControl, word: int | None, *, fault: bool, warning: bool) -> int:
        self.fault = False
        return step(self, word, fault=fault, warning=warning)

    monkeypatch.setattr(EncoderControl, "step", forgetful)
    monkeypatch.setattr(encoder_machine, "_LATCHED", ())
    result = run_case(encoder_case("input-voltage", Reaction.FAULT, (10,)))
    assert "the fault ended by itself" in result.failures


def test_gateway_with_unexpected_reports_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "PATIENCE_S", 2)
    result = run_case(encoder_case("position-error", Reaction.MEASURES))
    assert any("the position was not good" in failure for failure in result.failures)
    assert "unexpected fault numbers: [10]" in result.failures
    assert "warning not within" in run_case(encoder_case("duplicated-pdos", Reaction.WARNS)).failures[0]


def test_command_prints_a_matrix_and_exits_with_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    good = CliRunner().invoke(app, ["faults", "drive-fault"])
    assert good.exit_code == 0
    assert "drive-fault" in good.output
    assert "1 of 1 as they must be" in good.output
    monkeypatch.setattr("tests.long.commands.conformance.CASES", (Case("emcy-burst", Reaction.GOES_ON),))
    bad = CliRunner().invoke(app, ["faults", "--json"])
    document = json.loads(bad.output)
    assert (bad.exit_code, document["failed"]) == (1, 1)
    assert document["cases"][0]["failures"] == ["unexpected fault numbers: [10]"]
    assert document["cases"][0]["fault_numbers"] == [10]


# -- with PLC and daemon around it ----------------------------------------------------------------------------------------


def misbehave(daemon: Daemon, name: str, **values: int) -> None:
    def begin(node: object) -> None:
        drive_of(daemon).node.misbehave(name, **values)

    drive_of(daemon).do(begin)


def test_lost_drive_is_in_status_and_fault_buffer_and_on_has_no_effect() -> None:
    with running(configuration(axis(1), transport=PATIENT)) as daemon:
        plc = Plc(daemon, [1])
        plc.endpoint.set(0, {"NSOLL_A": 0x1000})
        plc.enable()
        misbehave(daemon, "bus-off", recovery_ms=0)
        plc.until(lambda: plc.endpoint.actuals[0] is None, "IOPS BAD")
        plc.until(lambda: snapshot(daemon)["axes"][0]["faults"], "told")
        status = snapshot(daemon)["axes"][0]
        assert status["reason"] == "node 1 on bus can: no TPDO1, TPDO2 for 200 ms"
        assert status["faults"][0]["number"] == 101
        assert daemon.axes[0].fault_log.entries()[0].number == 101, "P947"
        drive_of(daemon).do(lambda node: node.behave())
        plc.until(lambda: plc.endpoint.actuals[0] is not None, "back")
        for _ in range(20):
            plc.exchange()
        assert plc.state() == 0x40
        plc.enable()


def test_faulty_axis_does_not_stop_another_one() -> None:
    with running(configuration(axis(1) + axis(2), transport=PATIENT)) as daemon:
        plc = Plc(daemon, [1, 1])
        plc.endpoint.set(1, {"STW1": 0x047E})
        plc.enable(0)
        plc.enable(1)
        misbehave(daemon, "unknown-state")
        plc.until(lambda: plc.state(0) == 0x08, "fault in ZSW1")
        for _ in range(20):
            plc.exchange()
        assert plc.state(1) == 0x07
        assert not daemon.axes[1].faults
        assert snapshot(daemon)["axes"][0]["reason"] == Reason.NO_SUPPLY.value, "162Ch has Statusword.4 = 0"
