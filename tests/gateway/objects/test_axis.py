"""The axis between machine and drive client: SDO work, faults, refusals, restarts. The drive is never started here."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future
from typing import Any

import pytest

from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.ds301.node.node import NodeNotice, Notice
from pdgw.dsp402.drive.client import DriveStatus
from pdgw.gateway.axis.supervision.drive_events import EMERGENCY_PATIENCE_NS
from pdgw.gateway.axis.values import News, SdoAnswer, SdoWrite
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.objects.axis import Axis
from pdgw.profidrive.errors import ProfidriveError
from tests.support import buses
from tests.support.drives.drive_types import engel

FIRST = (SdoWrite(0x6098, 0, 35),)
SECOND = (SdoWrite(0x6098, 0, 17),)


@pytest.fixture
def axis() -> Iterator[Axis]:
    network = buses.network(VirtualLoop(), buses.bus(buses.channel()))
    axis = Axis(AxisConfig(do_id=7, node_id=3, telegram=9), network, 4)
    yield axis
    network.close()


class Requests:
    """An axis with an online drive; the test answers its SDO jobs and acts as its machine."""

    def __init__(self, axis: Axis) -> None:
        axis.drive.status = DriveStatus.ONLINE
        self._axis = axis
        self.reported: list[SdoAnswer] = []
        """Answers passed to the machine."""

    @property
    def jobs(self) -> list[Future[Any]]:
        """Answers to the jobs, to be given."""
        return [future for future, _ in self._axis.drive._jobs._waiting]

    def cycle(self) -> None:
        """A step of the axis, with a machine that drops answered requests."""
        outputs = self._axis.outputs
        news: list[News] = []
        self._axis._deliver(news)
        for item in news:
            assert isinstance(item, SdoAnswer)
            self.reported.append(item)
            if item.writes is outputs.writes:
                outputs.writes = None
        self._axis._serve(outputs)


def test_an_sdo_request_is_performed_once_and_answered(axis: Axis) -> None:
    requests = Requests(axis)
    axis.outputs.writes = FIRST
    for _ in range(3):
        requests.cycle()
    assert (len(requests.jobs), requests.reported) == (1, [])
    requests.jobs[0].set_exception(GatewayError("not taken"))
    requests.cycle()
    requests.cycle()
    assert (len(requests.jobs), requests.reported) == (1, [SdoAnswer(FIRST, "not taken")])


def test_the_end_of_a_withdrawn_request_does_not_answer_the_next(axis: Axis) -> None:
    requests = Requests(axis)
    axis.outputs.writes = FIRST
    requests.cycle()
    axis.outputs.writes = SECOND
    requests.jobs[0].set_result(None)
    requests.cycle()
    assert [answer.writes for answer in requests.reported] == [FIRST]
    assert axis.outputs.writes is SECOND
    requests.cycle()
    assert len(requests.jobs) == 2
    requests.jobs[1].set_result(None)
    requests.cycle()
    assert requests.reported[1:] == [SdoAnswer(SECOND, None)]


def test_a_request_is_performed_also_if_the_step_reports_nothing_else(axis: Axis) -> None:
    requests = Requests(axis)
    axis.step(None, 1)
    assert not requests.jobs
    axis.machine.outputs.writes = FIRST
    axis.step(None, 2)
    assert len(requests.jobs) == 1


def test_a_request_waits_for_the_end_of_the_one_before(axis: Axis) -> None:
    """Both write the same objects: the later values have to be written later."""
    requests = Requests(axis)
    axis.outputs.writes = FIRST
    requests.cycle()
    requests.jobs[0].set_running_or_notify_cancel()
    axis.outputs.writes = SECOND
    requests.cycle()
    assert len(requests.jobs) == 1
    requests.jobs[0].set_result(None)
    requests.cycle()
    assert requests.reported == [SdoAnswer(FIRST, None)]
    assert len(requests.jobs) == 2


def test_a_request_that_is_withdrawn_before_its_first_write_is_not_performed(axis: Axis) -> None:
    requests = Requests(axis)
    axis.outputs.writes = FIRST
    requests.cycle()
    axis.outputs.writes = None
    requests.cycle()
    axis.outputs.writes = SECOND
    requests.cycle()
    assert [job.cancelled() for job in requests.jobs] == [True, False]
    requests.jobs[1].set_result(None)
    requests.cycle()
    assert requests.reported == [SdoAnswer(SECOND, None)]


def test_a_refusal_that_repeats_is_one_fault_until_the_drive_was_accepted(axis: Axis) -> None:
    def announce(notice: Notice, text: str) -> None:
        axis.on_node_event(NodeNotice(notice, text, 1))
        axis.step(None, 1)

    for _ in range(3):
        announce(Notice.PROGRESS, "checking identity")
        announce(Notice.REFUSED, "wrong vendor")
    assert [fault.number for fault in axis.faults] == [106]
    announce(Notice.REFUSED, "wrong product")
    announce(Notice.ONLINE, "operational")
    announce(Notice.REFUSED, "wrong product")
    assert [fault.number for fault in axis.faults] == [106, 106, 106]


@pytest.mark.parametrize(("notice", "number"), [(Notice.LOST, 101), (Notice.BUS_LOST, 102)])
def test_a_lost_drive_and_a_lost_bus_are_different_faults(axis: Axis, notice: Notice, number: int) -> None:
    axis.on_node_event(NodeNotice(notice, "lost", 1))
    axis.step(None, 1)
    assert [fault.number for fault in axis.faults] == [number]


@pytest.mark.parametrize(
    ("notice", "number"),
    [
        (Notice.BOOT, FaultNumber.NODE_RESTARTED),
        (Notice.LOST, FaultNumber.NODE_LOST),
        (Notice.BUS_LOST, FaultNumber.BUS_LOST),
    ],
    ids=["boot", "lost", "bus lost"],
)
def test_a_requested_restart_is_not_a_fault_and_the_next_one_is(
    axis: Axis, notice: Notice, number: FaultNumber
) -> None:
    def announce(notice: Notice) -> None:
        axis.on_node_event(NodeNotice(notice, "told", 1))
        axis.step(None, 1)

    axis.reset_node()
    announce(notice)
    announce(notice)
    assert not axis.faults
    announce(Notice.ONLINE)
    announce(notice)
    assert [fault.number for fault in axis.faults] == [number]


@pytest.mark.parametrize(("code", "number"), [(0x2310, 7), (0x1234, 10)])
def test_an_emergency_has_the_manufacturers_number(axis: Axis, code: int, number: int) -> None:
    axis.drive.drive_type = engel()
    axis.references_changed()
    axis.on_node_event(NodeNotice(Notice.EMERGENCY, "EMCY", 1, code, 1, b"\x01\x00\x00\x00\x00"))
    axis.step(None, 1)
    axis.step(None, 1 + EMERGENCY_PATIENCE_NS)
    fault = axis.faults[0]
    assert (fault.number, fault.code, fault.value) == (number, code, 1)


def test_the_end_of_an_emergency_is_not_a_fault(axis: Axis) -> None:
    axis.on_node_event(NodeNotice(Notice.EMERGENCY, "EMCY 0000h no error", 1, 0, 0, bytes(5)))
    axis.step(None, 1)
    assert not axis.faults


def test_without_a_drive_the_values_are_bad_and_nothing_is_sent(axis: Axis) -> None:
    word = axis.telegram.setpoints.from_dict(dict.fromkeys(axis.telegram.setpoints.names, 0) | {"STW1": 0x047F})
    axis.step(word, 1)
    assert not axis.good
    assert axis.network.sent == 0
    assert len(axis.actuals) == len(axis.telegram.actuals.signals)


@pytest.mark.parametrize(
    ("number", "error", "message"),
    [
        (113, ProfidriveError, "telegram: 113 is not allowed"),
        (81, GatewayError, "telegram: 81 is not supported for a drive"),
        (112, GatewayError, "lu_per_unit is missing: telegram 112 needs lu_per_unit and velocity_per"),
    ],
)
def test_an_unsupported_telegram_changes_nothing(axis: Axis, number: int, error: type[Exception], message: str) -> None:
    before = axis.machine
    with pytest.raises(error, match=message):
        axis.change_telegram(number)
    assert axis.machine is before
    assert axis.telegram.number == 9
