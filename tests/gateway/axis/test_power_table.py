"""The power table walked exhaustively: what must hold in every cell, whatever its row, and that the interlock runs it."""

from __future__ import annotations

import itertools

import pytest

from pdgw.base.durations import MS
from pdgw.dsp402.states import STATUS_OF, State
from pdgw.gateway.axis.demand_report import OFFS, Flag, PowerWish
from pdgw.gateway.axis.interlock import QUICK_STOP_STANDING_NS, Interlock
from pdgw.gateway.axis.orders import ORDERS, Leave, Line
from pdgw.gateway.axis.power_cells import CELLS, Cell, cell
from pdgw.gateway.axis.power_states import DRIVE_OF_STATE, Action, Drive, Phase
from pdgw.gateway.axis.power_table import (
    COASTS,
    DISABLES,
    ENABLES,
    IN_OPERATION,
    NO_PLC,
    OFF,
    QUICK_STOPS,
    ROWS,
    SHOWS_OPERATION,
    UNPOWERED,
)
from pdgw.gateway.axis.settings import AxisSettings, PlcLossReaction
from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS, INTERNAL_FAULT
from pdgw.gateway.base.reasons import Reason

FOLLOWS = {Phase.FOLLOW, Phase.PASS}
POWERS = {Action.SWITCH_ON, Action.ENABLE_OPERATION, Action.PASS}
"""Actions that may put the power stage on."""
NOT_ASKED = set(PowerWish) - {PowerWish.ON, PowerWish.ENABLE, PowerWish.RESUME}
"""Wishes of a PLC that does not ask for ON, or of none."""
STOPS = {Action.DISABLE_VOLTAGE, Action.QUICK_STOP, Action.SHUTDOWN}
EVERYTHING = list(itertools.product(Phase, Drive, PowerWish))


def walk(*, phases: object = Phase, drives: object = Drive, wishes: object = PowerWish) -> list[tuple[str, Cell]]:
    """Cells with a name for messages."""
    return [
        (f"{phase.name}, {drive.name}, {wish.name}", cell(phase, drive, wish))
        for phase, drive, wish in EVERYTHING
        if phase in phases and drive in drives and wish in wishes  # type: ignore[operator]
    ]


def test_every_row_of_the_power_table_applies_to_some_state() -> None:
    assert {item.row for item in CELLS} == set(range(len(ROWS)))
    assert len(CELLS) == len(EVERYTHING)


def test_each_command_to_stop_has_a_limit_of_its_effect() -> None:
    """A drive with power must leave its state in time, or become slower. Only a drive that follows the PLC has no limit."""
    powered = set(Drive) - set(UNPOWERED) - {Drive.NO_REFERENCES}
    for name, item in walk(drives=powered):
        columns = ORDERS[item.order]
        follows = item.action is Action.PASS or (item.action is Action.ENABLE_OPERATION and item.operating)
        assert follows or columns.leave is not Leave.NONE or columns.line is not Line.NONE, name


def test_only_an_off_leads_to_a_phase_that_accepts_commands() -> None:
    for phase, drive, wish in EVERYTHING:
        if phase not in FOLLOWS and cell(phase, drive, wish).phase in FOLLOWS:
            resumes = phase is Phase.RAMP_STOP and wish is PowerWish.RESUME and drive in IN_OPERATION
            assert resumes or (wish in OFFS and drive in UNPOWERED), (phase, drive, wish)


def test_power_is_switched_on_only_in_a_phase_that_accepts_commands() -> None:
    for name, item in walk():
        assert item.action not in POWERS or item.phase in FOLLOWS, name


def test_off_never_switches_power_on() -> None:
    for name, item in walk(wishes=OFFS, phases=set(Phase) - {Phase.PASS}):
        assert item.action not in POWERS - {Action.PASS}, name
    for name, item in walk(wishes={PowerWish.OFF, PowerWish.OFF_DISABLED}, phases=set(Phase) - {Phase.PASS}):
        assert item.action is not Action.PASS, name


def test_enable_without_on_is_sent_only_to_a_drive_that_is_enabled() -> None:
    """General rule: no Controlword switches power on unless the PLC commands ON."""
    enabled = set(IN_OPERATION)
    for name, item in walk(wishes=NOT_ASKED, drives=set(Drive) - enabled, phases=set(Phase) - {Phase.PASS}):
        assert item.controlword & 0x1 == 0, name
    for name, item in walk(wishes=NOT_ASKED, drives=enabled, phases=set(Phase) - {Phase.PASS}):
        assert item.controlword in {0x0, 0x2, 0x6, 0xF}, name


def test_ramp_is_commanded_only_after_enable_operation() -> None:
    for name, item in walk():
        if item.action is Action.RAMP:
            assert any(f", {drive.name}, " in name for drive in IN_OPERATION), name


def test_off_of_an_unpowered_drive_counts_in_every_locked_phase() -> None:
    stopped = set(Phase) - FOLLOWS
    for name, item in walk(wishes={PowerWish.OFF, PowerWish.OFF_DISABLED}, drives=UNPOWERED, phases=stopped):
        assert (item.phase, item.action) == (Phase.FOLLOW, Action.SHUTDOWN), name
    for name, item in walk(wishes={PowerWish.RAW_OFF}, drives=UNPOWERED, phases=stopped):
        assert (item.phase, item.action) == (Phase.PASS, Action.PASS), name


def test_off3_reaches_an_unpowered_drive_in_every_known_phase() -> None:
    for name, item in walk(wishes={PowerWish.QUICK_STOP}, drives=UNPOWERED, phases=set(Phase) - {Phase.UNCONFIRMED}):
        fell = name.startswith(("FOLLOW, FELL", "PASS, FELL"))
        entering = name.startswith(("FOLLOW, ENTERING", "PASS, ENTERING", "FOLLOW, LOCAL", "PASS, LOCAL"))
        after = Phase.UNCONFIRMED if entering else Phase.LOCKED
        assert fell or (item.phase, item.action) == (after, Action.QUICK_STOP), name


def test_a_locked_axis_in_operation_brakes_on_off3_and_on_the_loss_of_the_plc() -> None:
    braking = {PowerWish.QUICK_STOP, PowerWish.NO_PLC_QUICK_STOP, PowerWish.NO_PLC_RAMP}
    for name, item in walk(wishes=braking, drives=SHOWS_OPERATION, phases={Phase.LOCKED}):
        assert (item.phase, item.action) == (Phase.QUICK_STOP, Action.QUICK_STOP), name


def test_without_a_plc_no_reason_names_a_plc_command() -> None:
    plcs_own = {Reason.NEEDS_OFF, Reason.RAMP_STOP, Reason.QUICK_STOP, Reason.COAST_STOP, Reason.NOT_OPERATING}
    for name, item in walk(wishes=NO_PLC):
        assert item.reason not in plcs_own, name


@pytest.mark.parametrize("drive", [Drive.LOST, Drive.UNKNOWN])
def test_a_drive_that_may_be_turning_gets_quick_stop_unless_off2(drive: Drive) -> None:
    for name, item in walk(drives={drive}, wishes=set(PowerWish) - set(COASTS), phases=set(Phase) - {Phase.COAST}):
        assert (item.phase, item.action) == (Phase.UNCONFIRMED, Action.QUICK_STOP), name


def test_off2_has_priority_in_every_row_until_the_drive_is_off() -> None:
    for name, item in walk(wishes=COASTS):
        off = any(f", {drive.name}, " in name for drive in (*OFF, Drive.FAULT))
        assert item.action is Action.DISABLE_VOLTAGE, name
        assert item.phase is (Phase.LOCKED if off else Phase.COAST), name
    for name, item in walk(phases={Phase.COAST}, drives=set(Drive) - set(UNPOWERED) - {Drive.FAULT}):
        assert (item.phase, item.action) == (Phase.COAST, Action.DISABLE_VOLTAGE), name


@pytest.mark.parametrize("drive", [Drive.FAULT, Drive.NO_REFERENCES])
def test_no_command_is_accepted_after_a_fault_or_without_references(drive: Drive) -> None:
    asked = set(PowerWish) - set(COASTS)
    for name, item in walk(drives={drive}, phases=set(Phase) - {Phase.UNCONFIRMED, Phase.COAST}, wishes=asked):
        assert (item.phase, item.action) == (Phase.LOCKED, Action.DISABLE_VOLTAGE), name
    for name, item in walk(drives={drive}, phases={Phase.UNCONFIRMED}, wishes=asked):
        doubtful = (Phase.UNCONFIRMED, Action.QUICK_STOP)
        ended = (Phase.LOCKED, Action.DISABLE_VOLTAGE)
        assert (item.phase, item.action) == (ended if drive is Drive.FAULT else doubtful), name


def test_no_enable_or_ramp_in_the_first_cycle_after_a_loss_or_restart() -> None:
    """What an executor forgets when it is not in operation, it has forgotten then."""
    gone = {Drive.LOST, Drive.RESTARTED, Drive.NO_REFERENCES, Drive.POWERED_UNREAD}
    after = {item.phase for _, item in walk(drives=gone)}
    enabling = {Action.ENABLE_OPERATION, Action.RAMP, Action.RAMP_END}
    assert not [where for where, item in walk(phases=after) if item.action in enabling]


def test_powered_drive_without_references_is_braked() -> None:
    asked, phases = set(PowerWish) - set(COASTS), set(Phase) - {Phase.COAST}
    for name, item in walk(drives={Drive.POWERED_UNREAD}, wishes=asked, phases=phases):
        assert (item.phase, item.action) == (Phase.UNCONFIRMED, Action.QUICK_STOP), name


@pytest.mark.parametrize("wish", [PowerWish.STOP, PowerWish.HOLD])
def test_without_control_by_plc_nothing_starts_and_no_lock_ends(wish: PowerWish) -> None:
    for name, item in walk(
        wishes={wish}, drives=set(UNPOWERED) | {Drive.LOST, Drive.FAULT}, phases=set(Phase) - {Phase.PASS}
    ):
        assert item.phase not in FOLLOWS, name
        assert item.action in STOPS, name
    item = cell(Phase.FOLLOW, Drive.OPERATING, wish)
    stays = (Phase.FOLLOW, Action.ENABLE_OPERATION)
    assert (item.phase, item.action) == (stays if wish is PowerWish.HOLD else (Phase.RAMP_STOP, Action.RAMP))


def test_a_drive_that_may_be_in_operation_brakes_without_the_plc_or_its_control() -> None:
    asked = {PowerWish.STOP, PowerWish.HOLD, PowerWish.NO_PLC_RAMP, PowerWish.NO_PLC_QUICK_STOP}
    for name, item in walk(phases=FOLLOWS, drives={Drive.ENTERING, Drive.LOCAL}, wishes=asked):
        assert (item.phase, item.action) == (Phase.UNCONFIRMED, Action.QUICK_STOP), name


@pytest.mark.parametrize("phase", list(FOLLOWS))
@pytest.mark.parametrize("wish", [PowerWish.COAST, PowerWish.QUICK_STOP])
def test_off2_and_off3_lock_in_every_state_of_the_drive(phase: Phase, wish: PowerWish) -> None:
    for name, item in walk(phases={phase}, wishes={wish}):
        assert item.phase not in FOLLOWS, name
        assert item.action in STOPS, name


def test_operation_is_shown_only_where_it_is_commanded_and_shown_as_commanded() -> None:
    for name, item in walk():
        commanded = item.controlword == 0xF and item.action is not Action.RAMP or item.action is Action.PASS
        shown = any(f", {drive.name}, " in name for drive in IN_OPERATION)
        assert item.operating is (commanded and shown), name


def test_zsw1_4_and_5_show_the_off2_and_off3_in_force() -> None:
    for name, item in walk():
        coasts = name.endswith((", COAST", "NO_PLC_COAST"))
        stops = name.endswith((", QUICK_STOP", ", QUICK_STOP_DISABLED")) or item.phase is Phase.QUICK_STOP
        assert bool(item.visible & Flag.NO_COAST_STOP) is not coasts, name
        assert bool(item.visible & Flag.NO_QUICK_STOP) is not stops, name
        assert item.visible | Flag.NO_COAST_STOP | Flag.NO_QUICK_STOP == Flag.OF_THE_DRIVE, name


def test_unknown_state_ends_only_with_power_off_a_fault_or_an_accepted_off() -> None:
    ends = {Drive.DISABLED, Drive.FELL_OFF, Drive.FAULT, *QUICK_STOPS}
    others = set(PowerWish) - set(OFFS) - set(COASTS)
    for name, item in walk(phases={Phase.UNCONFIRMED}, drives=set(Drive) - ends, wishes=others):
        assert item.phase is Phase.UNCONFIRMED, name
    for name, item in walk(
        phases={Phase.UNCONFIRMED}, drives=(*SHOWS_OPERATION, Drive.READY), wishes={PowerWish.ENABLE}
    ):
        assert item.action is Action.QUICK_STOP, name


@pytest.mark.parametrize("phase", [Phase.FOLLOW, Phase.RAMP_STOP, Phase.SHUTDOWN, Phase.QUICK_STOP])
def test_off3_in_operation_is_a_quick_stop_from_every_phase(phase: Phase) -> None:
    for name, item in walk(phases={phase}, drives=SHOWS_OPERATION, wishes={PowerWish.QUICK_STOP}):
        assert (item.phase, item.action) == (Phase.QUICK_STOP, Action.QUICK_STOP), name


def test_plc_loss_always_stops_and_no_command_counts() -> None:
    for name, item in walk(wishes=NO_PLC):
        assert item.phase not in FOLLOWS, name
        assert item.action in STOPS | {Action.RAMP, Action.RAMP_END}, name


@pytest.mark.parametrize("phase", list(FOLLOWS))
def test_plc_loss_in_operation_causes_the_configured_reaction(phase: Phase) -> None:
    answers = {
        PowerWish.NO_PLC_RAMP: (Phase.RAMP_STOP, Action.RAMP),
        PowerWish.NO_PLC_QUICK_STOP: (Phase.QUICK_STOP, Action.QUICK_STOP),
        PowerWish.NO_PLC_COAST: (Phase.COAST, Action.DISABLE_VOLTAGE),
    }
    for wish, answer in answers.items():
        item = cell(phase, Drive.OPERATING, wish)
        assert (item.phase, item.action) == answer
    for ramping in (Phase.RAMP_STOP, Phase.SHUTDOWN):
        for wish in (PowerWish.NO_PLC_QUICK_STOP, PowerWish.NO_PLC_COAST):
            item = cell(ramping, Drive.OPERATING, wish)
            assert (item.phase, item.action) == answers[wish], "it goes before a ramp that runs"
    item = cell(phase, Drive.STANDING, PowerWish.NO_PLC_RAMP)
    assert (item.phase, item.action) == (Phase.SHUTDOWN, Action.RAMP_END)


def test_off1_ramps_to_standstill_with_power_on_and_then_shuts_down() -> None:
    item = cell(Phase.FOLLOW, Drive.OPERATING, PowerWish.OFF)
    assert (item.phase, item.action, item.controlword) == (Phase.RAMP_STOP, Action.RAMP, 0xF)
    for wish in (PowerWish.OFF, PowerWish.ENABLE, PowerWish.NO_PLC_RAMP):
        item = cell(Phase.RAMP_STOP, Drive.OPERATING, wish)
        assert (item.phase, item.action) == (Phase.RAMP_STOP, Action.RAMP), wish
        for phase in (Phase.RAMP_STOP, Phase.SHUTDOWN):
            item = cell(phase, Drive.STANDING, wish)
            assert (item.phase, item.action, item.controlword) == (Phase.SHUTDOWN, Action.RAMP_END, 0x6), wish


def test_disable_operation_ends_a_ramp_stop_and_a_quick_stop() -> None:
    """State S5 of the profile: left at standstill, or with STW1.3 = 0."""
    for drive in SHOWS_OPERATION:
        for wish in (PowerWish.ON, PowerWish.OFF_DISABLED):
            item = cell(Phase.RAMP_STOP, drive, wish)
            assert (item.phase, item.action, item.controlword) == (Phase.SHUTDOWN, Action.RAMP_END, 0x6), wish
    for drive in (*SHOWS_OPERATION, *QUICK_STOPS):
        for wish in DISABLES:
            item = cell(Phase.QUICK_STOP, drive, wish)
            assert (item.phase, item.action) == (Phase.COAST, Action.DISABLE_VOLTAGE), wish


def test_started_shutdown_is_not_withdrawn() -> None:
    for name, item in walk(phases={Phase.SHUTDOWN}, drives=IN_OPERATION):
        assert item.phase in {Phase.SHUTDOWN, Phase.QUICK_STOP, Phase.COAST}, name
        assert item.action in STOPS | {Action.RAMP_END}, name


def test_quick_stop_runs_to_its_end_unless_a_command_ends_it() -> None:
    wishes = set(PowerWish) - set(COASTS) - set(DISABLES)
    for name, item in walk(phases={Phase.QUICK_STOP}, drives=(*SHOWS_OPERATION, *QUICK_STOPS), wishes=wishes):
        assert item.phase is Phase.QUICK_STOP, name
        assert item.action is (Action.DISABLE_VOLTAGE if "QUICK_STOPPED" in name else Action.QUICK_STOP), name


def test_running_quick_stop_never_gets_an_enable() -> None:
    for name, item in walk(drives=QUICK_STOPS):
        assert item.action in {Action.QUICK_STOP, Action.DISABLE_VOLTAGE}, name


def test_off_is_accepted_after_the_drive_left_operation_by_itself() -> None:
    for drive in (Drive.FELL_BACK, Drive.FELL_OFF):
        for wish in OFFS:
            item = cell(Phase.FOLLOW, drive, wish)
            assert (item.phase, item.action) == (Phase.FOLLOW, Action.SHUTDOWN)
            item = cell(Phase.PASS, drive, wish)
            assert (item.phase, item.action) == (Phase.PASS, Action.PASS)


def test_a_drive_that_left_operation_by_itself_needs_an_off() -> None:
    for phase in FOLLOWS:
        for name, item in walk(phases={phase}, drives={Drive.FELL_BACK}, wishes=(*ENABLES, PowerWish.ON)):
            assert (item.phase, item.action) == (Phase.UNCONFIRMED, Action.QUICK_STOP), name
    for name, item in walk(phases={Phase.FOLLOW}, drives={Drive.FELL_OFF}, wishes=(*ENABLES, PowerWish.ON)):
        assert (item.phase, item.action) == (Phase.LOCKED, Action.DISABLE_VOLTAGE), name


def test_power_up_uses_one_transition_at_a_time() -> None:
    steps = [
        (Drive.NOT_READY, 0x6),
        (Drive.DISABLED, 0x6),
        (Drive.READY, 0x7),
        (Drive.SWITCHED_ON, 0xF),
        (Drive.OPERATING, 0xF),
    ]
    assert [(drive, cell(Phase.FOLLOW, drive, PowerWish.ENABLE).controlword) for drive, _ in steps] == steps
    assert cell(Phase.FOLLOW, Drive.SWITCHED_ON, PowerWish.ON).controlword == 0x7
    assert cell(Phase.FOLLOW, Drive.OPERATING, PowerWish.ON).controlword == 0x7, "Disable Operation"


def test_without_an_off_no_sequence_of_events_leads_back_to_operation() -> None:
    reached = {cell(phase, drive, PowerWish.ENABLE).phase for phase in Phase for drive in (Drive.LOST, Drive.FAULT)}
    wishes = set(PowerWish) - set(OFFS) - {PowerWish.RESUME}
    while True:
        further = {item.phase for _, item in walk(phases=reached, wishes=wishes)} | reached
        if further == reached:
            break
        reached = further
    assert not reached & FOLLOWS


ORDERED = set(OFFS) | set(COASTS) - set(NO_PLC) | set(DISABLES) | {PowerWish.QUICK_STOP}
"""Wishes with which the PLC itself stops the drive."""


def test_each_stop_that_no_plc_orders_has_the_number_of_its_fault() -> None:
    for phase, drive, wish in EVERYTHING:
        item = cell(phase, drive, wish)
        stops = phase in FOLLOWS and item.phase not in {*FOLLOWS, Phase.INHIBITED}
        unasked = phase not in FOLLOWS and drive in SHOWS_OPERATION and "without a command" in ROWS[item.row].why
        stops = stops and not (drive is Drive.LOCAL and wish in ENABLES)  # an ON that is used up, as one of INHIBITED
        if stops and wish not in ORDERED or unasked and wish not in NO_PLC:
            assert item.fault, (phase.name, drive.name, wish.name)
            assert item.fault == INTERNAL_FAULT or item.fault in GATEWAY_FAULTS


# -- the interlock runs the table --------------------------------------------------------------------------------------

STATES = {drive: state for state, drive in DRIVE_OF_STATE.items() if state is not State.FAULT_REACTION_ACTIVE}
STATUSWORD = {drive: 0x2C if state is None else STATUS_OF[state] for drive, state in STATES.items()}
REACTIONS = {
    PowerWish.NO_PLC_RAMP: PlcLossReaction.RAMP,
    PowerWish.NO_PLC_QUICK_STOP: PlcLossReaction.QUICK_STOP,
    PowerWish.NO_PLC_COAST: PlcLossReaction.COAST,
}
ENABLING = {Phase.FOLLOW, Phase.PASS, Phase.RAMP_STOP}
SHOWN_AS = {
    Drive.STANDING: Drive.OPERATING,
    Drive.LEAVING: Drive.OPERATING,
    Drive.QUICK_STOPPED: Drive.QUICK_STOPPING,
    Drive.ENTERING: Drive.SWITCHED_ON,
}
LOOKED_AT = [
    (phase, drive, wish)
    for phase, drive, wish in EVERYTHING
    # These need a past of their own; they have tests of their own.
    if drive not in {Drive.FELL_BACK, Drive.FELL_OFF, Drive.RESTARTED, Drive.INHIBITED, Drive.LOCAL}
    and wish not in {PowerWish.RESUME, PowerWish.OFF_DISABLED, PowerWish.QUICK_STOP_DISABLED}
    # Only a phase that enables knows a last Controlword that did.
    and (drive not in {*IN_OPERATION, Drive.ENTERING} or phase in ENABLING)
]


def enable(interlock: Interlock, phase: Phase) -> None:
    """The last Controlword was Enable Operation."""
    raw = phase is Phase.PASS
    interlock.step(PowerWish.RAW_OFF if raw else PowerWish.OFF, False, None, STATUSWORD[Drive.READY], False, 0)
    interlock.step(PowerWish.ENABLE, False, None, STATUSWORD[Drive.SWITCHED_ON], False, 0)


@pytest.mark.parametrize("phase", list(Phase))
def test_interlock_follows_the_power_table_in_every_condition(phase: Phase) -> None:
    for _, drive, wish in (item for item in LOOKED_AT if item[0] is phase):
        interlock = Interlock(AxisSettings(on_plc_loss=REACTIONS.get(wish, PlcLossReaction.QUICK_STOP)))
        asked = None if wish in NO_PLC else wish
        shown = SHOWN_AS.get(drive, drive)
        condition = drive if drive in {Drive.LOST, Drive.NO_REFERENCES, Drive.POWERED_UNREAD} else None
        statusword = STATUSWORD.get(shown, 0x27)
        still = drive in {Drive.STANDING, Drive.QUICK_STOPPED}
        now = MS
        if drive in {*IN_OPERATION, Drive.ENTERING}:
            enable(interlock, phase)
        interlock.phase = phase
        if drive is Drive.QUICK_STOPPED:
            if phase is not Phase.QUICK_STOP:
                continue  # only a quick stop that is known can be over
            interlock.step(PowerWish.ENABLE, False, condition, statusword, still, now)
            now += QUICK_STOP_STANDING_NS
        interlock.step(asked, False, condition, statusword, still, now)
        expected = cell(phase, drive, wish)
        found = (interlock.phase, interlock.cell.action, interlock.controlword)
        assert found == (expected.phase, expected.action, expected.controlword), (phase, drive, wish)
