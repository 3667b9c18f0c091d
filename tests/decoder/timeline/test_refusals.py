"""The timeline of a recording shows every rejection as the gateway decided it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pdgw.gateway.reasons import FaultNumber, Reason
from pdgw.tools.decoder.timeline.entries import Anomaly, AnomalyKind, ReasonChange, WordKind
from pdgw.tools.decoder.timeline.text import entry_lines
from tests.support.gateways.daemon import ON, Plc, axis, configuration, drive_of
from tests.support.gateways.recorded_daemon import recorded, recording
from tests.support.readers.timeline import Timeline, edges, own_timeline


def run(plc: Plc, word: int | None = None, cycles: int = 40, **values: int) -> None:
    """Some cycles with other setpoints."""
    plc.endpoint.set(0, ({} if word is None else {"STW1": word}) | values)
    for _ in range(cycles):
        plc.exchange()


def timeline_of(folder: Path, happens: Callable[[Plc], None], number: int = 1) -> Timeline:
    """What happened once the drive was online."""
    with recorded(configuration(axis(1, telegram_number=number)), folder) as plc:
        plc.until(lambda: plc.state() == 0x40, "online")
        happens(plc)
        file = recording(folder)
    return own_timeline(file)


def without_off(plc: Plc) -> None:
    run(plc, ON)


def no_control(plc: Plc) -> None:
    plc.enable()
    run(plc, 0x007E)


def setpoint_disabled(plc: Plc) -> None:
    plc.enable()
    run(plc, 0x043F)


def coast(plc: Plc) -> None:
    run(plc, 0x047E)
    run(plc, 0x047C)


def ramp(plc: Plc) -> None:
    plc.enable()
    run(plc, NSOLL_A=0x4000, cycles=150)
    run(plc, 0x047E, 8)
    run(plc, ON)


def quick_stop(plc: Plc) -> None:
    plc.enable()
    run(plc, NSOLL_A=0x4000, cycles=150)
    run(plc, 0x047B)


def fault(plc: Plc) -> None:
    plc.enable()
    drive_of(plc.daemon).inject(7)
    run(plc)
    run(plc, 0x047E)


REFUSALS: dict[Reason, Callable[[Plc], None]] = {
    Reason.NEEDS_OFF: without_off,
    Reason.NO_CONTROL: no_control,
    Reason.SETPOINT_DISABLED: setpoint_disabled,
    Reason.COAST_STOP: coast,
    Reason.RAMP_STOP: ramp,
    Reason.QUICK_STOP: quick_stop,
    Reason.DRIVE_FAULT: fault,
}


@pytest.mark.parametrize("reason", REFUSALS)
def test_each_refusal_is_explained_with_the_gateways_text(reason: Reason, tmp_path: Path) -> None:
    found = timeline_of(tmp_path, REFUSALS[reason])
    edge = edges(found, WordKind.CONTROL)[-1]
    assert edge.outcome is reason
    assert reason.value in "\n".join(entry_lines(edge, found.opening.begin_ns))
    document = edge.document()
    assert (document["outcome"], document["outcome_text"]) == (reason.name, reason.value)
    is_effect = reason in {Reason.COAST_STOP, Reason.QUICK_STOP}
    assert bool(found.summary.refusals[reason]) is not is_effect
    assert Reason.SWITCHED_OFF not in found.summary.refusals, "an OFF that works is no refusal"


def test_a_start_is_executed_and_a_fault_has_its_own_line(tmp_path: Path) -> None:
    def happens(plc: Plc) -> None:
        plc.enable()
        run(plc)
        drive_of(plc.daemon).inject(7)
        run(plc)

    found = timeline_of(tmp_path, happens)
    on = next(edge for edge in edges(found, WordKind.CONTROL) if edge.after == ON)
    assert "-> executed" in "\n".join(entry_lines(on, found.opening.begin_ns))
    changes = [entry for entry in found.entries if isinstance(entry, ReasonChange)]
    assert changes[-1].reason is Reason.DRIVE_FAULT
    assert not changes[-1].settling
    assert not any(isinstance(entry, Anomaly) and entry.kind is AnomalyKind.GATEWAY_FAULT for entry in found.entries)


def test_a_lost_plc_is_a_fault_of_the_gateway_and_the_reason(tmp_path: Path) -> None:
    def happens(plc: Plc) -> None:
        plc.enable()
        run(plc)
        plc.endpoint.set(0, {"STW1": ON & ~0x400})
        run(plc, cycles=20)
        plc.enable()
        plc.silent = True
        run(plc, cycles=200)

    found = timeline_of(tmp_path, happens)
    faults = [
        item.text for item in found.entries if isinstance(item, Anomaly) and item.kind is AnomalyKind.GATEWAY_FAULT
    ]
    assert any(text.startswith(str(int(FaultNumber.CONTROL_LOST))) for text in faults)
    reasons = [entry.reason for entry in found.entries if isinstance(entry, ReasonChange)]
    assert {Reason.NO_CONTROL, Reason.PLC_LOST} <= set(reasons)
