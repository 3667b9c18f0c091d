"""Reports of the axis about its drive: once, with the right number, and without losing the first cause."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.dsp402.drive.client import DriveStatus
from pdgw.dsp402.drive.rpdos import SetPoint
from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from pdgw.gateway.axis.supervision.drive_events import EMERGENCY_PATIENCE_NS
from pdgw.gateway.base.fault_numbers import EMCY_WARNING, FIRST_WARNING, FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.axis_chain import axis_enable_status
from pdgw.gateway.service.status import axis_status
from tests.support import buses
from tests.support.drives.drive_types import engel

OFF, ON = 0x047E, 0x047F


@pytest.fixture
def axis(monkeypatch: pytest.MonkeyPatch) -> Iterator[Axis]:
    """An axis whose drive is online; the test writes its feedback."""
    network = buses.network(VirtualLoop(), buses.bus(buses.channel()))
    axis = Axis(AxisConfig(do_id=7, node_id=3, telegram=1), network, 4)
    axis.check_chain = partial(axis_enable_status, axis)
    monkeypatch.setattr(axis.drive, "refresh", lambda now: axis.drive.status is DriveStatus.ONLINE)
    axis.drive.status = DriveStatus.ONLINE
    axis.drive.drive_type = engel()
    axis.drive.generation = 1
    yield axis
    network.close()


class Steps:
    """Cycles of 4 ms with a Statusword each."""

    def __init__(self, axis: Axis) -> None:
        self.axis = axis
        self.speed = self.now = 0

    def __call__(self, word: int, *shown: State | int) -> None:
        for item in shown:
            self.now += 4 * MS
            status = STATUS_OF[item] if isinstance(item, State) else item
            self.axis.drive.feedback.statusword = status
            self.axis.step((word, self.speed), self.now)

    def enable(self) -> None:
        self(0x400, State.SWITCH_ON_DISABLED)
        self(OFF, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON)
        self(ON, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED)

    @property
    def numbers(self) -> list[int]:
        return [fault.number for fault in self.axis.faults]


@pytest.fixture
def steps(axis: Axis) -> Steps:
    return Steps(axis)


def test_normal_operation_reports_nothing(steps: Steps) -> None:
    steps.enable()
    steps(0x047D, State.OPERATION_ENABLED, State.SWITCH_ON_DISABLED)
    assert steps.numbers == []


def test_a_statusword_of_no_state_is_fault_107_with_the_word(steps: Steps) -> None:
    steps.enable()
    steps(ON, 0x022C, 0x022C)
    assert steps.numbers == [107]
    assert "022Ch" in steps.axis.faults[0].text
    assert steps.axis.reason is Reason.DRIVE_UNKNOWN_STATE


def test_a_bouncing_statusword_is_reported_once_a_second(steps: Steps) -> None:
    steps.enable()
    for _ in range(300):
        steps(ON, 0x022C, State.SWITCHED_ON)
    assert steps.numbers == [107] * 3
    assert 2400 * MS < steps.now < 3000 * MS


def test_a_drive_that_leaves_operation_by_itself_is_fault_122(steps: Steps) -> None:
    steps.enable()
    steps(ON, State.SWITCHED_ON)
    assert steps.numbers == [122]
    assert steps.axis.fault_log.entries()[0].number == 122, "P947"
    assert axis_status(steps.axis)["faults"][0]["is_warning"] is False


def test_a_disable_by_the_plc_is_not_a_warning(steps: Steps) -> None:
    steps.enable()
    steps(ON & ~0x8, State.OPERATION_ENABLED, State.SWITCHED_ON)
    steps(ON, State.SWITCHED_ON, State.OPERATION_ENABLED)
    assert steps.numbers == []


LIMITED = STATUS_OF[State.OPERATION_ENABLED] | StatusBit.INTERNAL_LIMIT
HALF_SECOND = 126
"""Cycles."""


def test_an_internal_limit_that_slows_the_axis_is_logged_and_is_the_reason(steps: Steps) -> None:
    steps.enable()
    steps(ON, *[LIMITED] * HALF_SECOND)
    assert not steps.numbers, "it follows its setpoint of 0"
    steps.speed = 0x1000
    steps.axis.drive.feedback.velocity_actual = 300
    steps(ON, *[LIMITED] * 2 * HALF_SECOND)
    assert steps.numbers == [112]
    assert steps.axis.outputs.warning == 1 << 112 - FIRST_WARNING, "P953"
    assert steps.axis.reason is Reason.INTERNAL_LIMIT
    steps(ON, State.OPERATION_ENABLED)
    assert steps.axis.reason is None
    assert not steps.axis.outputs.warning


def show_fault(axis: Axis) -> None:
    """The drive shows a fault: an EMCY with an error is one."""
    axis.drive.feedback.statusword = STATUS_OF[State.FAULT]
    axis.step(None, 1)


def emcy(axis: Axis, code: int, register: int = 1, now: int = 1) -> None:
    axis.on_node_event(NodeNotice(Notice.EMERGENCY, f"EMCY {code:04X}h", now, code, register, bytes(5)))
    axis.step(None, now)


@pytest.mark.parametrize(("register", "is_warning"), [(0x01, False), (0x11, False), (0x00, True)])
def test_emergency_in_a_fault_is_a_fault_if_its_register_has_a_bit_set(
    axis: Axis, register: int, is_warning: bool
) -> None:
    show_fault(axis)
    emcy(axis, 0x2310, register)
    assert [(fault.number, fault.is_warning) for fault in axis.faults] == [(7, is_warning)]


@pytest.mark.parametrize("code", [0x8110, 0x8120, 0x8140, 0x8210])
def test_an_emergency_of_the_communication_is_fault_12(axis: Axis, code: int) -> None:
    show_fault(axis)
    emcy(axis, code)
    assert axis.faults[0].number == 12


def test_a_burst_of_emergencies_does_not_push_the_first_cause_out(axis: Axis) -> None:
    show_fault(axis)
    emcy(axis, 0x2310, now=MS)
    for count in range(1, 1001):
        emcy(axis, 0x5000, now=count * 2 * MS)
    assert [fault.code for fault in axis.faults] == [0x2310, 0x5000, 0x5000]


def test_emergencies_with_a_counter_in_their_data_are_counted_once_a_second(axis: Axis) -> None:
    """The first cause stays, also the one that arrives meanwhile."""
    show_fault(axis)
    for count in range(3000):
        counter = count.to_bytes(5, "little")
        axis.on_node_event(NodeNotice(Notice.EMERGENCY, "EMCY FF00h", (1 + count) * MS, 0xFF00, 1, counter))
        if count == 1500:
            emcy(axis, 0x2310, now=(1 + count) * MS)
        axis.step(None, (1 + count) * MS)
    assert [(fault.code, fault.value) for fault in axis.faults] == [
        (0xFF00, 0),
        (0xFF00, 1000),
        (0x2310, 0),
        (0xFF00, 2000),
    ]
    assert [fault.text for fault in axis.faults if fault.code == 0xFF00] == [
        "EMCY FF00h",
        "EMCY FF00h (999 more since the last report)",
        "EMCY FF00h (999 more since the last report)",
    ]


def test_number_of_emergencies_is_complete_when_they_end(axis: Axis, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="gateway")
    for now in range(1, 4):
        emcy(axis, 0x2310, now=now)
    emcy(axis, 0, 0, now=4)
    assert "EMCY 0000h (EMCY 2310h: 2 more since the last report)" in caplog.text


def test_a_fault_after_warnings_of_the_same_code_is_reported_at_once(axis: Axis) -> None:
    show_fault(axis)
    emcy(axis, 0x2310, register=0, now=1)
    emcy(axis, 0x2310, register=1, now=2)
    assert [fault.is_warning for fault in axis.faults] == [True, False]


def test_an_emergency_that_ended_is_a_new_one_when_it_comes_again(axis: Axis) -> None:
    show_fault(axis)
    for now in range(1, 4):
        emcy(axis, 0x2310, now=now)
    emcy(axis, 0, 0, now=4)
    emcy(axis, 0x2310, now=5)
    assert len(axis.faults) == 2


def test_an_emergency_without_an_error_is_a_warning_until_its_end(axis: Axis) -> None:
    emcy(axis, 0x2310, register=0, now=1)
    axis.step(None, 1 + EMERGENCY_PATIENCE_NS)
    assert axis.outputs.warning == EMCY_WARNING, "P953"
    axis.on_node_event(NodeNotice(Notice.PROGRESS, "mapping PDOs", SECOND))
    axis.step(None, SECOND)
    assert axis.outputs.warning == EMCY_WARNING
    emcy(axis, 0, register=0, now=SECOND)
    assert not axis.outputs.warning


def test_the_log_has_each_reason_fault_and_message_of_the_node_once(
    steps: Steps, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", logger="gateway")
    steps.enable()
    steps(ON, *[State.OPERATION_ENABLED] * 5)
    steps.axis.on_node_event(NodeNotice(Notice.ONLINE, "operational, configuration 1", 1))
    steps(ON, *[State.OPERATION_ENABLED] * 2)
    steps.speed = 0x1000
    steps.axis.drive.feedback.velocity_actual = 300
    steps(ON, *[LIMITED] * HALF_SECOND)
    steps(ON, *[State.SWITCHED_ON] * 3)
    told = [(record.levelname, getattr(record, "event", ""), record.getMessage()) for record in caplog.records]
    first = told.index(("INFO", "reason", "axis 7: In operation"))
    assert [(level, event) for level, event, _ in told[first:]] == [
        ("INFO", "reason"),
        ("INFO", "node"),
        ("WARNING", "warning"),
        ("INFO", "reason"),
        ("ERROR", "fault"),
        ("INFO", "reason"),
    ]
    assert told[first + 1][2] == "axis 7: node operational, configuration 1"
    assert told[first + 3][2].startswith(f"axis 7: In operation: {Reason.INTERNAL_LIMIT.value}. Check limit switches")
    assert "fault 122" in told[first + 4][2]


def test_a_drive_that_does_not_answer_is_fault_121_once(axis: Axis) -> None:
    def announce(notice: Notice, text: str) -> None:
        axis.on_node_event(NodeNotice(notice, text, 1))
        axis.step(None, 1)

    for count in range(3):
        announce(Notice.PROGRESS, "checking identity")
        announce(Notice.ABSENT, f"no answer {count}")
    assert [fault.number for fault in axis.faults] == [121]
    announce(Notice.ONLINE, "operational")
    announce(Notice.ABSENT, "no answer")
    assert [fault.number for fault in axis.faults] == [121, 121]


def test_a_setpoint_the_drive_does_not_accept_is_warning_119_and_the_reason(steps: Steps) -> None:
    steps.enable()
    set_point = steps.axis.drive.rpdos.set_point = SetPoint()
    set_point.refused = True
    steps.axis.on_node_event(NodeNotice(Notice.SET_POINT_REFUSED, "not started: 6083h", 1))
    steps(ON, State.OPERATION_ENABLED)
    assert steps.numbers == [119]
    assert steps.axis.outputs.warning == 1 << 119 - FIRST_WARNING, "P953"
    assert steps.axis.reason is Reason.SET_POINT_REFUSED
    steps.speed = 0x1000
    steps.axis.drive.feedback.velocity_actual = 300
    steps(ON, *[LIMITED] * HALF_SECOND)
    assert steps.axis.outputs.warning == warning_bits(FaultNumber.SET_POINT, FaultNumber.INTERNAL_LIMIT)
    steps(ON, State.OPERATION_ENABLED)
    assert steps.axis.outputs.warning == warning_bits(FaultNumber.SET_POINT), "each ends by itself"
    steps.axis.drive.rpdos.set_point = None
    steps(ON, State.OPERATION_ENABLED)
    assert steps.axis.reason is None
    assert steps.axis.outputs.warning == 0
