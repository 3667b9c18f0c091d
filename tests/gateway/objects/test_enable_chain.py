"""The chain of enables: each link is judged by itself, the physical one speaks, and every surface says the same."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from pdgw.ds301.node.node import Cause, NodeStatus
from pdgw.dsp402.states import State
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import AxisState, Enable, Reason
from pdgw.gateway.base.step_text import remedy_text
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.objects.enable_chain import AXIS_CHAIN, ENCODER_CHAIN
from pdgw.gateway.objects.enable_status import ChainLink
from pdgw.gateway.service.status import explanation, snapshot
from pdgw.tools.output.status_text import Health, check_line
from tests.support.documents.situations import (
    BREAKERS,
    SLOW_PLC,
    in_operation,
    run_out,
    show_no_supply,
    shown,
)
from tests.support.gateways.daemon import (
    OFF,
    ON,
    Plc,
    axis,
    configuration,
    drive_of,
    encoder_of,
    running,
    switch_off,
)

ENCODER = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
_AFTER = {
    Enable.BUS: {Enable.NODE, Enable.SUPPLY, Enable.NO_FAULT, Enable.OPERATION},
    Enable.NODE: {Enable.SUPPLY, Enable.NO_FAULT, Enable.OPERATION},
    Enable.SUPPLY: {Enable.OPERATION},
    Enable.NO_FAULT: {Enable.OPERATION},
    Enable.PLC: {Enable.OPERATION, Enable.CONTROL, Enable.ON_EDGE, Enable.SETPOINT},
    Enable.CONTROL: {Enable.OPERATION, Enable.ON_EDGE, Enable.SETPOINT},
    Enable.ON_EDGE: {Enable.OPERATION, Enable.SETPOINT},
}
"""Links that cannot be judged while another one is broken: a drive without commands cannot follow."""


def links(daemon: Daemon) -> dict[Enable, ChainLink]:
    return {link.enable: link for link in daemon.axes[0].enable_status.chain}


def first(daemon: Daemon) -> ChainLink:
    link = daemon.axes[0].enable_status.broken
    assert link is not None
    return link


def document(daemon: Daemon) -> dict[str, Any]:
    item: dict[str, Any] = snapshot(daemon)["axes"][0]
    return item


@pytest.mark.parametrize("reason", Reason, ids=lambda reason: reason.name)
def test_every_reason_declares_state_link_and_remedy(reason: Reason) -> None:
    chain = ENCODER_CHAIN if reason.name.startswith(("ENCODER", "SENSOR")) else AXIS_CHAIN
    assert reason.enable in chain
    assert reason.state in AxisState
    assert (reason.state is AxisState.OBEYS) == (reason in (Reason.LAGS, Reason.HOME_LOST)), (
        "a reason keeps from operation"
    )
    text = remedy_text(reason.remedy)
    assert text.strip(" .") == text != ""


def test_number_of_a_reason_is_its_place_among_the_names_of_a_recording() -> None:
    assert [reason.code for reason in Reason] == list(range(1, len(Reason) + 1))


def test_axis_in_operation_has_a_whole_chain() -> None:
    with in_operation() as (daemon, _):
        assert all(link.ok for link in links(daemon).values())
        assert document(daemon)["sentence"] == AxisState.OBEYS.value
        assert document(daemon)["remedy"] == ""


def test_repeated_losses_are_named_until_the_axis_operates_again() -> None:
    with in_operation() as (daemon, plc):
        for _ in range(3):
            assert daemon.axes[0].enable_status.state is AxisState.OBEYS
            plc.silent = True
            plc.until(lambda: not daemon.link.connected, "the loss")
            plc.exchange()
            plc.silent = False
            plc.enable()
        assert daemon.axes[0].enable_status.state is AxisState.OBEYS, "an axis that moves does not wait"
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: not daemon.axes[0].powered, "power off")
        assert first(daemon).reason is Reason.WATCHDOG_SHORT


CAUSES = {
    Enable.BUS: "fault 102: CAN bus lost",
    Enable.NODE: "Not on the bus: node 1 on bus can sends no data in time",
    Enable.SUPPLY: "fault 122: drive acts without a command: left operation, shows Switch On Disabled",
    Enable.NO_FAULT: "fault 7: EMCY 2310h over-current",
    Enable.OPERATION: "fault 122: drive acts without a command: left operation, shows Ready to Switch On",
    Enable.PLC: "fault 103: PLC lost: no valid frame for 15 cycles",
    Enable.CONTROL: "warning 120: control by PLC removed in operation",
    Enable.ON_EDGE: "Stopping: OFF1 ramp in progress",
    Enable.SETPOINT: "Waits: no setpoint",
}


@pytest.mark.parametrize("enable", CAUSES, ids=lambda enable: enable.name)
def test_each_broken_link_names_itself_and_is_the_cause_of_the_stop(enable: Enable) -> None:
    with in_operation() as (daemon, plc):
        run_out(plc)
        BREAKERS[enable](plc, daemon)
        run_out(plc)
        link = first(daemon)
        assert link.enable is enable
        assert link.reason is not None
        assert link.reason.enable is enable
        before = AXIS_CHAIN[: AXIS_CHAIN.index(enable)]
        assert all(links(daemon)[known].ok is not False for known in before)
        texts = [line["text"] for line in explanation(daemon, daemon.objects)]
        assert texts[texts.index("In operation") + 1].startswith(CAUSES[enable])


PAIRS = [*pairwise(BREAKERS), (Enable.BUS, Enable.PLC), (Enable.NODE, Enable.CONTROL)]
"""The order of the chain is that of its neighbours; a broken link does not hide one of the PLC."""


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: f"{pair[0].name}-{pair[1].name}")
def test_of_two_broken_links_the_physical_one_speaks_on_every_surface(pair: tuple[Enable, Enable]) -> None:
    with in_operation() as (daemon, plc):
        for enable in pair:
            BREAKERS[enable](plc, daemon)
        run_out(plc)
        found = links(daemon)
        front, back = pair
        expected, other = (back, front) if front in _AFTER.get(back, ()) else (front, back)
        link = first(daemon)
        assert link.enable is expected, daemon.axes[0].enable_status.sentence
        if other in _AFTER.get(expected, ()):
            assert found[other].ok is not True
        elif other is not Enable.SETPOINT:
            assert found[other].ok is False
        result = shown(daemon)
        assert link.evidence in result.sentence
        remedy = f"{link.todo[:1].upper()}{link.todo[1:]}."
        assert result.sentence == f"{daemon.axes[0].enable_status.state.value}: {link.evidence}. {remedy}"
        assert f'reason="{link.reason.name.lower()}"' in result.surfaces.pop("metrics")  # type: ignore[union-attr]
        if link.reason is Reason.SWITCHED_OFF:
            del result.surfaces["--check"]  # off as the PLC asks: nothing to report
        event = result.surfaces.pop("event")
        assert event.startswith(f"{daemon.axes[0].enable_status.state.value}: ")
        assert event.endswith(f". {remedy}"), "its evidence and time are those of its first cycle"
        for name, text in result.surfaces.items():
            assert result.sentence in text, name


def test_log_names_the_same_link(caplog: pytest.LogCaptureFixture) -> None:
    with in_operation() as (daemon, plc), caplog.at_level("INFO", "gateway"):
        switch_off(daemon, drive_of(daemon))
        plc.silent = True
        run_out(plc)
        said = [record.getMessage() for record in caplog.records if getattr(record, "event", "") == "reason"]
        assert said[-1].startswith("axis 1: Not on the bus: node 1 on bus can ")
        assert said[-1].endswith(". Check power, CAN cable, termination, bit rate and node-ID of the drive.")


@pytest.mark.parametrize("enable", [Enable.NODE, Enable.BUS, Enable.NO_FAULT], ids=lambda enable: enable.name)
def test_check_is_critical_without_a_drive_whatever_the_plc_sends(enable: Enable) -> None:
    with in_operation() as (daemon, plc):
        BREAKERS[enable](plc, daemon)
        for word in (ON, 0, OFF, OFF & ~0x2, OFF & ~0x4, OFF & ~0x400, None):
            plc.silent = word is None
            plc.endpoint.set(0, {"STW1": word or 0})
            run_out(plc)
            health, line = check_line(snapshot(daemon))
            assert health is Health.CRITICAL
            assert daemon.axes[0].enable_status.sentence in line


def test_fault_has_its_name_time_and_remedy_also_after_a_loss_of_the_plc() -> None:
    with in_operation() as (daemon, plc):
        names = {fault.name for fault in daemon.axes[0].manufacturer_faults.values()}
        drive_of(daemon).inject(7)
        run_out(plc)
        before = document(daemon)
        cause = before["cause"]
        assert before["sentence"].startswith(f"Fault: {cause['text']}, since {cause['time'][11:19]}. ")
        assert before["sentence"].endswith("; then acknowledge (STW1.7).")
        assert "EMCY" in cause["text"]
        assert any(name in before["reason"] for name in names), "the manufacturer's"
        plc.silent = True
        run_out(plc)
        after = document(daemon)
        assert after["faults"][0]["number"] == FaultNumber.PLC_LOST
        assert after["cause"]["id"] == cause["id"]
        assert after["sentence"] == before["sentence"]
        assert shown(daemon).surfaces["MQTT"] == before["sentence"]


def test_older_loss_of_the_plc_does_not_hide_a_fault_of_the_drive() -> None:
    with in_operation() as (daemon, plc):
        plc.silent = True
        run_out(plc)
        plc.silent = False
        plc.endpoint.set(0, {"STW1": OFF})
        run_out(plc)
        drive_of(daemon).inject(7)
        run_out(plc)
        assert document(daemon)["cause"]["number"] < FaultNumber.NODE_LOST
        assert "EMCY" in document(daemon)["sentence"]


def test_supply_counts_only_where_the_drive_has_shown_it_without_power() -> None:
    """Many drives set Statusword.4 only with their power stage: idle, its 0 proves nothing."""

    def plain(daemon: Daemon) -> None:
        drive_of(daemon).model.disguises.append(show_no_supply)

    with running(configuration(axis(1), transport=SLOW_PLC), plain) as daemon:
        plc = Plc(daemon, [1])
        plc.endpoint.set(0, {"STW1": OFF})
        run_out(plc)
        assert links(daemon)[Enable.SUPPLY].ok is None
        assert first(daemon).reason is Reason.SWITCHED_OFF
        plc.endpoint.set(0, {"STW1": ON})
        run_out(plc)
        assert first(daemon).reason is Reason.NO_SUPPLY


@pytest.mark.parametrize(
    ("word", "state", "evidence", "health"),
    [
        (OFF, AxisState.OFF, Reason.SWITCHED_OFF.value, Health.OK),
        (ON & ~0x8, AxisState.WAITS, "STW1.3 = 0 (Disable Operation)", Health.WARNING),
        (ON & ~0x2, AxisState.WAITS, "STW1.1 = 0 (OFF2)", Health.WARNING),
        (ON & ~0x4, AxisState.WAITS, "STW1.2 = 0 (OFF3)", Health.WARNING),
        (ON & ~0xE, AxisState.WAITS, "STW1.1 = STW1.2 = STW1.3 = 0 (OFF2, OFF3, Disable Operation)", Health.WARNING),
    ],
)
def test_word_of_the_plc_that_keeps_an_axis_off_is_named(
    word: int, state: AxisState, evidence: str, health: Health
) -> None:
    """An interlock in the PLC beside ON: the axis is not off as the PLC asks, and all missing bits are named."""
    with in_operation() as (daemon, plc):
        plc.endpoint.set(0, {"STW1": word})
        run_out(plc)
        assert daemon.axes[0].enable_status.state is state
        assert first(daemon).evidence.endswith(evidence)
        assert check_line(snapshot(daemon))[0] is health


def test_a_refused_device_is_distinguished_from_an_absent_one() -> None:
    with in_operation() as (daemon, plc):
        switch_off(daemon, drive_of(daemon))
        run_out(plc)
        assert first(daemon).reason is Reason.DRIVE_OFFLINE
        client = daemon.axes[0].client
        client.status, client.refusal = NodeStatus.REFUSED, Cause("1018h/1 is 5, not 4")
        assert first(daemon).reason is Reason.NODE_REFUSED, daemon.axes[0].enable_status.sentence


def test_chain_of_an_encoder_is_judged_alike() -> None:
    with running(configuration(axis(1) + ENCODER, transport=SLOW_PLC)) as daemon:
        plc = Plc(daemon, [1, 81])
        plc.endpoint.set(1, {"STW2_ENC": 0x0400})
        encoder = daemon.encoders[0]
        plc.until(lambda: encoder.enable_status.broken is None, "in operation")
        plc.endpoint.set(1, {"STW2_ENC": 0})
        plc.until(lambda: encoder.enable_status.broken is not None, "no control")
        assert encoder.enable_status.broken is not None
        assert encoder.enable_status.broken.reason is Reason.ENCODER_NO_CONTROL
        switch_off(daemon, encoder_of(daemon))
        plc.silent = True
        run_out(plc)
        chain = {link.enable: link for link in encoder.enable_status.chain}
        assert encoder.enable_status.broken.reason is Reason.ENCODER_OFFLINE
        assert chain[Enable.PLC].reason is Reason.ENCODER_NO_PLC
        assert chain[Enable.SENSOR].ok is None


def test_gateway_that_is_stopped_has_not_lost_its_plc(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "gateway"):
        with in_operation() as (daemon, _):
            drive = drive_of(daemon)
            assert drive.model.state is State.OPERATION_ENABLED
        assert not [fault for fault in daemon.axes[0].faults if fault.number == FaultNumber.PLC_LOST]
        assert "PLC lost" not in caplog.text
    assert Reason.GATEWAY_STOPS.value in caplog.text
