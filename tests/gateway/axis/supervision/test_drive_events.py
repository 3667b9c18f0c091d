"""When a fault counts as acknowledged, an axis as standing, and which states of a drive as with power and without."""

from __future__ import annotations

from fractions import Fraction

import pytest

from pdgw.ds301.emcy import GENERIC_ERROR
from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import ChannelErrorType, DriveFault
from pdgw.dsp402.states import STATUS_OF, Command, State, StatusBit
from pdgw.gateway.axis.orders import Brake
from pdgw.gateway.axis.supervision.drive_events import ACKNOWLEDGE_NS, Acknowledgement, DriveWatch, NodeWatch
from pdgw.gateway.axis.values import FaultRead, Outputs
from tests.gateway.axis.supervision.test_stop_supervision import CYCLE, QUICK_STOP, REACTION, turning, without_reaction
from tests.gateway.axis.test_velocity import CONTROL
from tests.support.axis.hand import OFF, ON, Hand
from tests.support.drives.drive_types import engel

_ACKNOWLEDGE = 0x80
WITH_POWER = {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}


def test_acknowledge_without_a_fault_counts_once_per_edge() -> None:
    item = Acknowledgement()
    assert [item.step(asked, True, False, 1) for asked in (True, True, False, True)] == [True, False, False, True]


def test_acknowledge_counts_when_the_fault_ends_after_the_falling_edge() -> None:
    item = Acknowledgement()
    assert not item.step(True, True, True, 1)
    assert not item.step(False, True, True, 2)
    assert item.waits
    assert item.pending
    assert item.step(False, True, False, ACKNOWLEDGE_NS)
    assert not item.pending
    assert not item.step(False, True, False, ACKNOWLEDGE_NS + 1)
    assert not item.waits


@pytest.mark.parametrize(
    ("number", "read", "shown"), [(7, 0x2310, 0x2310), (7, 0, 0x5441), (8, 0, GENERIC_ERROR), (0, 0, GENERIC_ERROR)]
)
def test_fault_without_emcy_has_a_code_because_0_is_an_empty_entry(number: int, read: int, shown: int) -> None:
    outputs = Outputs(2, None)
    faults = {n: DriveFault(n, "", code, 1, ChannelErrorType.ERROR) for n, code in ((7, 0x5441), (8, 0))}
    DriveWatch(outputs).fault_read(FaultRead(number, read), DriveFeedback(), faults, 1)
    (record,) = outputs.happened().faults
    assert (record.code, record.is_explained) == (shown, bool(number or read))


def test_a_fault_that_stays_for_a_second_needs_another_edge() -> None:
    item = Acknowledgement()
    assert not item.step(True, True, True, 1)
    assert not item.step(True, True, True, ACKNOWLEDGE_NS + 1)
    assert item.pending
    assert not item.step(True, True, True, ACKNOWLEDGE_NS + 2)
    assert not item.pending
    assert not item.step(True, True, False, ACKNOWLEDGE_NS + 3), "the bit that stands is no edge"
    assert item.waits, "for its fall"
    assert not item.step(False, True, False, ACKNOWLEDGE_NS + 4)
    assert item.step(True, True, False, ACKNOWLEDGE_NS + 5)


def test_no_fault_is_acknowledged_while_the_drive_is_lost() -> None:
    item = Acknowledgement()
    assert not item.step(True, False, False, 1)
    assert item.step(True, True, False, 2)


@pytest.mark.parametrize("state", State, ids=lambda state: state.name)
def test_without_references_a_powered_drive_stops_and_no_other_gets_power(state: State) -> None:
    hand = Hand(1, engel(), 3, {})
    hand.stepper.set_drive(None)
    hand(OFF, State.SWITCH_ON_DISABLED)
    for _ in range(3):
        assert hand(ON, state) == (Command.QUICK_STOP.word if state in WITH_POWER else 0)


@pytest.mark.parametrize("lost", [True, False], ids=["lost", "without references"])
@pytest.mark.parametrize(("off", "bit"), [(OFF & ~2, 0x10), (OFF & ~4, 0x20)], ids=["OFF2", "OFF3"])
def test_a_stop_is_shown_also_where_the_drive_is_lost_or_has_no_references(off: int, bit: int, *, lost: bool) -> None:
    hand = Hand(1, engel(), 3, {}).enable()
    if lost:
        hand.online = False
    else:
        hand.stepper.set_drive(None)
    hand(off, STATUS_OF[State.OPERATION_ENABLED] | StatusBit.VOLTAGE_ENABLED)
    assert not hand.actuals["ZSW1"] & bit, "ZSW1.4 and ZSW1.5 are 0 during OFF2 and OFF3"


@pytest.mark.parametrize(("word", "controlword"), [(ON, Command.QUICK_STOP.word), (OFF & ~2, 0)], ids=["ON", "OFF2"])
def test_a_powered_drive_that_is_lost_with_its_references_brakes(word: int, controlword: int) -> None:
    hand = Hand(1, engel(), 3, {}).enable()
    hand.stepper.set_drive(None)
    hand.online = False
    assert [hand(word) for _ in range(3)] == [controlword] * 3


@pytest.mark.parametrize("online", [True, False], ids=["online", "lost"])
@pytest.mark.parametrize("enabled", [True, False], ids=["operation not shown yet", "unknown state"])
def test_a_drive_that_may_have_power_brakes_when_its_references_are_lost(*, enabled: bool, online: bool) -> None:
    hand = Hand(1, engel(), 3, {})
    if enabled:
        hand(OFF, State.SWITCH_ON_DISABLED)
        hand(ON, State.READY_TO_SWITCH_ON)
        assert Command.ENABLE_OPERATION.matches(hand(ON, State.SWITCHED_ON))
    else:
        hand.enable()
    hand.stepper.set_drive(None)
    hand.online = online
    status = STATUS_OF[State.SWITCHED_ON] if enabled else 0x2C
    assert [hand(ON, status) for _ in range(3)] == [Command.QUICK_STOP.word] * 3


@pytest.mark.parametrize("state", State, ids=lambda state: state.name)
def test_the_brakes_are_released_by_each_state_without_power_and_by_no_other(state: State) -> None:
    bench = turning()
    assert without_reaction(bench, QUICK_STOP, REACTION // CYCLE + 20) is Brake.NMT_STOP
    bench.drive.feedback.statusword = STATUS_OF[state]
    assert without_reaction(bench, QUICK_STOP, 1) is (Brake.NMT_STOP if state in WITH_POWER else Brake.NONE)


@pytest.mark.parametrize(("share", "window"), [(Fraction(1, 100), 60), (Fraction(1, 20), 300), (Fraction(0), 1)])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_ramp_of_an_off1_ends_within_the_standstill_window_and_not_above_it(
    share: Fraction, window: int, sign: int
) -> None:
    hand = Hand(1, engel(), 3, {}, standstill_window=share)
    hand.feedback.velocity_actual = sign * 3000
    hand(OFF, State.SWITCH_ON_DISABLED)
    hand(ON | 0x40, State.READY_TO_SWITCH_ON)
    hand(ON | 0x40, State.SWITCHED_ON)
    assert hand(ON | 0x40) == Command.ENABLE_OPERATION.word
    hand(OFF)
    hand.feedback.velocity_actual = sign * (window + 1)
    assert hand(OFF) == Command.ENABLE_OPERATION.word
    hand.feedback.velocity_actual = sign * window
    assert hand(OFF) == Command.SHUTDOWN.word


def test_loss_of_control_needs_control_before() -> None:
    hand = Hand(1, engel(), 3, {})
    for status in (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON):
        hand(OFF & ~CONTROL, status)
        hand(ON & ~CONTROL, status)
        hand(OFF, status)
    assert not hand.stepper.events
    assert not hand.stepper.machine.outputs.warning


def test_what_a_node_reports_is_logged_but_for_faults_and_what_follows_them() -> None:
    outputs = Outputs(2, None)
    watch = NodeWatch(outputs, proven=True)
    for what, text, code, register in (
        (Notice.PROGRESS, "answers", 0, 0),
        (Notice.REFUSED, "refused", 0, 0),
        (Notice.PROGRESS, "refused, answers", 0, 0),
        (Notice.ONLINE, "online", 0, 0),
        (Notice.ABSENT, "absent", 0, 0),
        (Notice.PROGRESS, "absent, answers", 0, 0),
        (Notice.ONLINE, "online again", 0, 0),
        (Notice.EMERGENCY, "one error ended", 0, 1),
        (Notice.EMERGENCY, "no error", 0, 0),
    ):
        watch.process(NodeNotice(what, text, 1, code, register))
    watch.restart_asked = True
    watch.process(NodeNotice(Notice.BOOT, "boot-up", 1))
    logged = ("answers", "online", "online again", "one error ended", "no error", "restarts, as commanded: boot-up")
    assert outputs.happened().log_lines == [f"node {text}" for text in logged]


def test_emcy_that_comes_again_after_the_acknowledge_is_a_new_fault() -> None:
    """Within a second it is else a repetition of the one that has left the buffer."""
    hand = Hand(1, engel(), 3, {}).enable()

    def emcy() -> None:
        hand.stepper.machine.inputs.news.append(NodeNotice(Notice.EMERGENCY, "EMCY", 1, 0x8130, 0x11))

    emcy()
    hand(ON, State.FAULT)
    emcy()
    hand(OFF, State.FAULT)
    assert len(hand.stepper.events) == 1
    hand(OFF | _ACKNOWLEDGE, State.SWITCH_ON_DISABLED)
    emcy()
    hand(OFF, State.FAULT)
    assert len(hand.stepper.events) == 2
