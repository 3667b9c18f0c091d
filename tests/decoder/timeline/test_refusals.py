"""The timeline shows every rejection with the gateway's text."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from pdgw.decoder.timeline.entries import AnomalyKind, ReasonChange, WordKind
from pdgw.decoder.timeline.text import entry_lines
from pdgw.gateway.reasons import Reason
from pdgw.profidrive.frame import IOPS_BAD
from tests.decoder.replay.test_replay import speed
from tests.support.axis.recorded import RecordedRig
from tests.support.readers.timeline import edges, texts, timeline

IOPS_OF_PLC = 6
"""Offset of telegram 1's IOPS in a frame."""


def last_outcome(rig: RecordedRig, folder: Path) -> Reason | None:
    return edges(timeline(rig, folder), WordKind.CONTROL)[-1].outcome


# -- refusals ---------------------------------------------------------------------------------------------------------


def without_off(rig: RecordedRig) -> None:
    rig.stw(0x047F, 30)


def no_control(rig: RecordedRig) -> None:
    rig.enable(0x047E)
    rig.stw(0x007E, 30)


def setpoint_disabled(rig: RecordedRig) -> None:
    rig.enable(0x047E)
    rig.stw(0x043F, 30)


def coast(rig: RecordedRig) -> None:
    rig.stw(0x047E)
    rig.stw(0x047C, 30)


def ramp(rig: RecordedRig) -> None:
    rig.enable(0x047E)
    rig.values["NSOLL_A"] = 0x4000
    rig.step(200)
    rig.stw(0x047E, 10)
    rig.stw(0x047F, 30)


def quick_stop(rig: RecordedRig) -> None:
    rig.enable(0x047E)
    rig.values["NSOLL_A"] = 0x4000
    rig.step(200)
    rig.stw(0x047B, 30)


def fault(rig: RecordedRig) -> None:
    rig.enable(0x047E)
    rig.node.model.inject(7)
    rig.step(30)
    rig.stw(0x047E, 30)


REFUSALS: dict[Reason, Callable[[RecordedRig], None]] = {
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
    rig = RecordedRig(1)
    rig.step(5)
    REFUSALS[reason](rig)
    found = timeline(rig, tmp_path)
    edge = edges(found, WordKind.CONTROL)[-1]
    assert edge.outcome is not None
    assert reason in edge.reasons
    assert reason.value in "\n".join(entry_lines(edge, found.opening.begin_ns))
    document = edge.document()
    assert reason.name in document["reasons"]
    assert document["outcome_text"] == edge.outcome.value
    assert found.summary.refusals[edge.outcome] >= 1


POSITIONING: dict[Reason, tuple[int, int]] = {
    Reason.MDI_OFF: (0x0000, 0x047F),
    Reason.HOMING_METHOD: (0x8005, 0x0C3F),
}
"""SATZANW and STW1 that are refused in operation."""


@pytest.mark.parametrize("reason", POSITIONING)
def test_refusals_of_positioning(reason: Reason, tmp_path: Path) -> None:
    rig = RecordedRig(9)
    rig.step(5)
    rig.enable()
    rig.values["SATZANW"], word = POSITIONING[reason]
    rig.stw(word, 30)
    assert last_outcome(rig, tmp_path) is reason


@pytest.mark.parametrize(("word", "reason"), [(0x045F, Reason.INTERMEDIATE_STOP), (0x046F, Reason.REJECTED)])
def test_stops_of_a_task_are_reported(word: int, reason: Reason, tmp_path: Path) -> None:
    rig = RecordedRig(9)
    rig.step(5)
    rig.enable()
    rig.values |= {"SATZANW": 0x8000, "MDI_TARPOS": 0x20000000, "MDI_VELOCITY": 0x40000000, "MDI_MOD": 1}
    rig.values |= {"MDI_ACC": 0x400, "MDI_DEC": 0x400}
    rig.stw(0x047F, 60)
    rig.stw(word, 5)
    assert last_outcome(rig, tmp_path) is reason


def test_edge_in_a_rejected_frame_is_reported(tmp_path: Path) -> None:
    rig = speed()
    number = next(i for i, (a, b) in enumerate(pairwise(rig.frames.plc)) if a[1][3] != b[1][3]) + 1
    for position in range(number, number + 3):
        now, frame = rig.frames.plc[position]
        rig.frames.plc[position] = (now, frame[:IOPS_OF_PLC] + bytes((IOPS_BAD,)) + frame[IOPS_OF_PLC + 1 :])
    found = timeline(rig, tmp_path)
    edge = edges(found, WordKind.CONTROL)[0]
    assert edge.note.startswith("not evaluated")
    assert len(texts(found, AnomalyKind.IOPS_BAD)) == 1


def on_with_late_status(delay_ms: int) -> RecordedRig:
    """OFF, then ON for 1.2 s; each state of the drive is seen late."""
    rig = RecordedRig(1)
    rig.step(5)
    rig.stw(0x047E, 20)
    rig.node.misbehave("late-status", delay_ms=delay_ms)
    rig.stw(0x047F, 300)
    return rig


def test_slow_start_of_a_drive_counts_as_followed(tmp_path: Path) -> None:
    """Brakes and contactors need some hundred milliseconds."""
    found = timeline(on_with_late_status(250), tmp_path)
    edge = edges(found, WordKind.CONTROL)[-1]
    assert edge.after == 0x047F
    assert edge.outcome is None
    assert edge.reasons == (Reason.NOT_OPERATING,)
    assert "-> executed" in "\n".join(entry_lines(edge, found.opening.begin_ns))


def test_start_later_than_a_second_counts_as_not_followed(tmp_path: Path) -> None:
    assert last_outcome(on_with_late_status(700), tmp_path) is Reason.NOT_OPERATING


def test_reason_after_an_off_is_not_its_result(tmp_path: Path) -> None:
    """After an OFF no reason is expected from the drive: the OFF is rated 100 ms later."""
    rig = RecordedRig(1)
    rig.step(5)
    rig.stw(0x047E, 60)
    rig.node.model.inject(7)
    rig.step(30)
    found = timeline(rig, tmp_path)
    assert edges(found, WordKind.CONTROL)[-1].reasons == (Reason.NOT_OPERATING,)
    changes = [entry for entry in found.entries if isinstance(entry, ReasonChange)]
    assert changes[-1].reason is Reason.DRIVE_FAULT
    assert not changes[-1].settling


def test_spontaneous_reason_has_its_own_line(tmp_path: Path) -> None:
    rig = RecordedRig(1)
    rig.step(5)
    rig.enable(0x047E)
    rig.step(60)
    rig.node.model.inject(7)
    rig.step(30)
    changes = [entry for entry in timeline(rig, tmp_path).entries if isinstance(entry, ReasonChange)]
    assert changes[-1].reason is Reason.DRIVE_FAULT
    assert not changes[-1].settling
