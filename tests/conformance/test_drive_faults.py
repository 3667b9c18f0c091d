"""Every fault of a simulated drive: is the drive stopped, the fault reported, and the drive not started again?

Source: docs/translation.md "Losses". Rule of all cases: no drive enters Operation Enabled again before the PLC has sent a
new OFF and ON. With these it does.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.dsp402.states import State, state_of
from pdgw.gateway.axis.executors.speed import SpeedExecutor
from pdgw.gateway.axis.interlock import Commanded
from pdgw.gateway.axis.supervision.drive_events import POWERED
from pdgw.gateway.axis.supervision.enable_guard import EnableGuard
from pdgw.peers.drive import SHAPES, shape
from pdgw.peers.drive.objects import EDS_PATH
from pdgw.profidrive.signals import signal
from tests.conformance import rig as rigs
from tests.conformance.fault_cases import CONFIGURES, DRIVE_CASES, LOSSES, Activity, Case, Reaction
from tests.conformance.rig import COMPLETE, PATIENCE_S, QUIET_CYCLES, DriveRig, drive
from tests.conformance.test_drive_shapes import REFUSALS, TELEGRAMS
from tests.support.gateways.daemon import axis, configuration, running

_NO_QUICK_STOP = signal("STW1").bit("NO_QUICK_STOP").mask
_START_HOMING, _HOMING_HERE = 0x0800, 35
_STANDING_CYCLES = 150
"""Cycles at standstill before the fault ends: longer than the detection of standstill."""
_MOVING = [case for case in DRIVE_CASES if case.activity is Activity.SPEED and case.telegram == 1 and not case.beside]
_WITH_OWN_FAULT = {"slow-sdo", "slow-boot", "frozen", "two-edges"}
_OTHERWISE = {
    ("limit-switch", 100): "the PLC has to stop",
    ("under-voltage", "shape"): "the fault number is ENGEL's",
    ("frozen-velocity", "shape"): "the unit of its positions is unknown",
    ("duplicated-pdos", "no-event-timer"): "looks like two drives",
    ("heartbeat-stops", "rpdo-timeout"): "it sends no heartbeats",
    ("heartbeat-stops", "stays-stopped"): "it stays in Quick Stop Active with power",
    ("lost-pdos", "stays-stopped"): "it stays in Quick Stop Active with power",
    ("unknown-state", "stays-stopped"): "it stays in Quick Stop Active with power",
    ("held-at-fixed-stop", 100): "the PLC has to stop",
    ("runs-away", 9): "a task has no check of its speed",
    ("runs-away", 100): "the PLC has to stop",
    ("runs-away", "stays-stopped"): "it stays in Quick Stop Active with power",
}
"""Combinations in which the reaction is another one, and why."""
_ALL = [
    (replace(case, telegram=number, sent=(), stopped="", within_ms=PATIENCE_S * 1000, says=""), name)
    for name in SHAPES
    if name not in _WITH_OWN_FAULT
    for number in TELEGRAMS
    if (name, number) not in REFUSALS
    for case in _MOVING
    if not {(case.fault, number), (case.fault, name), (case.fault, "shape")} & _OTHERWISE.keys()
]
COMBINATIONS = _ALL if COMPLETE else _ALL[:: 2 * len(_MOVING) + 1]
"""Telegrams, shapes and faults; without ``make conformance`` one fault in turn for every second telegram and shape."""


@pytest.mark.parametrize("case", DRIVE_CASES, ids=str)
def test_gateway_reacts_to_each_fault_of_a_drive(case: Case) -> None:
    more = f"eds = '{EDS_PATH}'\nsdo_timeout_ms = {case.sdo_timeout_ms}"
    with running(configuration(axis(1, telegram_number=case.telegram, more=more))) as daemon:
        rig = DriveRig(daemon, drive(daemon))
        rig.power_on(case)
        if case.reaction is Reaction.REFUSES:
            _check_refusal(rig, case)
        else:
            _check_operation(rig, case)


@pytest.mark.parametrize(("case", "name"), COMBINATIONS, ids=str)
def test_gateway_reacts_to_each_fault_of_each_shape(case: Case, name: str) -> None:
    with running(configuration(axis(1, telegram_number=case.telegram, more=""))) as daemon:
        rig = DriveRig(daemon, drive(daemon, shape=shape(name)))
        rig.power_on(case)
        _check_operation(rig, case)


def _check_refusal(rig: DriveRig, case: Case) -> None:
    """OFF and ON have no effect during the fault. After the fault, the still active ON has none either."""
    rig.off()
    rig.until(lambda: rig.has_reported(case.numbers), f"fault {case.numbers}")
    rig.cycles(3)
    rig.on()
    rig.cycles(QUIET_CYCLES)
    rig.check_reports(case)
    assert rig.plc.actuals[0] is None, "values are shown as good"
    assert rig.reason
    _check_no_restart(rig, case, 0)
    rig.enable()


def _check_operation(rig: DriveRig, case: Case) -> None:
    if case.activity is Activity.OFF:
        rig.online()
        rig.off()
        rig.until(lambda: rig.state is State.READY_TO_SWITCH_ON, "ready to switch on")
    else:
        rig.enable()
    if case.activity not in {Activity.HOMING, Activity.OFF}:
        rig.move()
        rig.until(rig.turning, "turning")
    mark, starts = len(rig.states), rig.starts
    rig.sent.clear()
    _begin(rig, case)
    if case.reaction is Reaction.STOPS:
        rig.until(lambda: rig.standing() and rig.model.state not in POWERED, "drive stopped")
    elif case.reaction is Reaction.STANDSTILL:
        rig.until(rig.standing, "standstill")
    if LOSSES.intersection(case.numbers):
        rig.until(lambda: CONFIGURES in rig.sent, "configured again")
    rig.cycles(_STANDING_CYCLES if case.reaction is Reaction.STANDSTILL else QUIET_CYCLES)
    rig.check_reports(case)
    assert case.stopped in {"", _stopped_by(rig, mark)}
    if case.reaction is Reaction.CONTINUES:
        _check_continues(rig, case, mark)
    elif case.reaction is Reaction.STANDSTILL:
        _check_standstill(rig)
    else:
        assert rig.reason
        if case.activity is Activity.OFF:
            starts = rig.starts  # those of the drive itself
        elif case.activity is not Activity.OFF1:
            rig.on()
        # A drive that enters operation by itself does so until the fault ends.
        _check_no_restart(rig, case, rig.starts if case.activity is Activity.OFF else starts)
    rig.enable()


def _begin(rig: DriveRig, case: Case) -> None:
    word = rig.plc.endpoint.setpoints[0][rig.word]
    if case.activity is not Activity.START:
        rig.start_fault(case.fault, case.values)
    if case.activity is Activity.STOPPING:
        rig.command(word & ~_NO_QUICK_STOP)
    if case.activity is Activity.OFF1:
        rig.off()
    if case.activity is Activity.HOMING:
        rig.plc.set(0, {"SATZANW": _HOMING_HERE, "MDI_VELOCITY": 0x1000})
        rig.command(word | _START_HOMING)


def _stopped_by(rig: DriveRig, mark: int) -> str:
    """How the drive stopped after an index of its states."""
    for state, speed in rig.states[mark:]:
        if state is State.QUICK_STOP_ACTIVE:
            return "quick stop"
        if state is State.FAULT_REACTION_ACTIVE:
            return "fault reaction"
        if state not in POWERED and speed:
            return "coast"
    return "at standstill"


def _check_continues(rig: DriveRig, case: Case, mark: int) -> None:
    assert rig.states[mark:] == [], "operation was left"
    rig.until(rig.moved, "moved as commanded")
    rig.off()
    rig.until(lambda: rig.standing() and rig.model.state not in POWERED, "OFF obeyed")
    assert case.numbers or not rig.numbers, f"unexpected fault numbers: {rig.numbers}"
    rig.end_fault()


def _check_standstill(rig: DriveRig) -> None:
    """The axis stays at standstill after the end of the fault too, until the PLC sends something else."""
    assert rig.standing(), "the axis moves again"
    assert rig.reason
    rig.end_fault()
    rig.cycles(QUIET_CYCLES)
    assert rig.standing(), "moves on by itself"
    rig.off()
    rig.until(lambda: rig.model.state not in POWERED, "OFF obeyed")


def _check_no_restart(rig: DriveRig, case: Case, starts: int) -> None:
    """End the fault, and restart the device if it was rejected. The ON that stays active must not start it."""
    rig.end_fault(restart=case.reaction is Reaction.REFUSES)
    rig.online()
    rig.cycles(QUIET_CYCLES)
    assert rig.starts == starts, "started by itself"


def test_faulty_axis_does_not_stop_another_one() -> None:
    with running(configuration(axis(1, more="") + axis(2))) as daemon:
        rig = DriveRig(daemon, drive(daemon))
        rig.device.start()
        rig.plc.set(1, {"STW1": 0x047E})
        rig.enable()
        rig.plc.exchange(0, 2, STW1=0x047F)
        rig.until(lambda: state_of(daemon.axes[1].drive.feedback.statusword) is State.OPERATION_ENABLED, "operation")
        rig.start_fault("unknown-state", {})
        rig.until(lambda: rig.plc.actuals[0] and rig.plc.actuals[0]["ZSW1"] & 0x4F == 0x08, "fault in ZSW1")
        rig.cycles(QUIET_CYCLES)
        assert rig.plc.actuals[1] is not None
        assert rig.plc.actuals[1]["ZSW1"] & 0x4F == 0x07
        assert not daemon.axes[1].faults
        assert rig.reason.startswith("drive state unknown: Statusword 162Ch"), "and not its Statusword.4 = 0"


# -- gateways that would fail -----------------------------------------------------------------------------------------------


@pytest.mark.planted
def test_gateway_that_starts_a_drive_again_by_itself_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    # It does not detect that the drive lost its enable input, and no second safeguard is active.
    monkeypatch.setattr(Commanded, "_changed", lambda self, drive, shown, phase, now: drive)
    monkeypatch.setattr(EnableGuard, "step", lambda self, wish, controlword: True)
    with pytest.raises(AssertionError, match="started by itself"):
        test_gateway_reacts_to_each_fault_of_a_drive(Case("enable-input-dropped", Reaction.STOPS))


@pytest.mark.planted
def test_gateway_that_moves_on_when_a_limit_switch_is_released_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    held = SpeedExecutor._held_at_limit

    def ignored(self: SpeedExecutor, target: int, tolerance: int) -> int:
        held(self, target, tolerance)
        return target

    monkeypatch.setattr(SpeedExecutor, "_held_at_limit", ignored)
    with pytest.raises(AssertionError, match="moves on by itself"):
        test_gateway_reacts_to_each_fault_of_a_drive(Case("limit-switch", Reaction.STANDSTILL, (112,)))


@pytest.mark.parametrize(
    ("case", "failure"),
    [
        (Case("under-voltage", Reaction.CONTINUES), "operation was left"),
        (Case("emcy-burst", Reaction.CONTINUES), "unexpected fault numbers"),
        (Case("duplicated-pdos", Reaction.STOPS), "drive stopped not within"),
        (Case("two-pdos", Reaction.REFUSES, (106,), Activity.START), "fault .* not within"),
        (Case("reboot", Reaction.STOPS, (105,), sent=("NMT stop",)), "NMT enter pre operational"),
        (Case("unknown-state", Reaction.STOPS, (107,), stopped="coast"), "quick stop"),
    ],
    ids=str,
)
def test_other_reaction_than_required_fails(case: Case, failure: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rigs, "PATIENCE_S", 2)
    with pytest.raises(AssertionError, match=failure):
        test_gateway_reacts_to_each_fault_of_a_drive(case)
