"""A gap between two cycles of the gateway is the cause of what is found at its end, and of nothing else."""

from __future__ import annotations

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.emcy import HEARTBEAT_ERROR
from pdgw.dsp402.states import State
from pdgw.gateway.axis.values import FaultRecord, gateway_fault
from pdgw.gateway.base.fault_numbers import By, FaultNumber
from pdgw.gateway.daemon.pause import Pause
from tests.support.gateways.daemon import ON, drive_of, operating, world_of

LIMIT = 40 * MS
FOLLOWS = [
    gateway_fault(FaultNumber.NODE_LOST, "silent", SECOND),
    gateway_fault(FaultNumber.PLC_LOST, "no valid frame", SECOND),
    gateway_fault(FaultNumber.LEFT_OPERATION, "left operation", SECOND),
    FaultRecord(12, HEARTBEAT_ERROR, 0, "EMCY 8130h", SECOND),
]
DOES_NOT_FOLLOW = [
    gateway_fault(FaultNumber.NODE_LOST, "another master", SECOND, By.OTHER_MASTER),
    gateway_fault(FaultNumber.STOP_IGNORED, "750 rpm", SECOND),
    FaultRecord(7, 0x2310, 0, "EMCY 2310h", SECOND),
]


def paused(gap: int, end: int = SECOND) -> tuple[Pause, list[str]]:
    lines: list[str] = []
    found = Pause(LIMIT, lines.append)
    found.cycle(end - gap, end)
    return found, lines


@pytest.mark.parametrize("record", FOLLOWS, ids=lambda record: str(int(record.number)))
def test_a_loss_at_the_end_of_a_gap_has_the_gap_as_its_cause(record: FaultRecord) -> None:
    found, lines = paused(4 * SECOND)
    explained = found.explain(record)
    assert lines == ["the gateway did not run for 4 s"]
    assert explained is not None
    assert (explained.number, explained.code, explained.by) == (record.number, record.code, By.GATEWAY)
    assert "the gateway did not run for 4 s" in explained.text
    assert "machine of the gateway" in explained.remedy


@pytest.mark.parametrize("record", DOES_NOT_FOLLOW, ids=lambda record: str(int(record.number)))
def test_a_fault_with_a_cause_of_its_own_keeps_it(record: FaultRecord) -> None:
    assert paused(4 * SECOND)[0].explain(record) is None


@pytest.mark.parametrize(("gap", "end"), [(LIMIT, SECOND), (4 * SECOND, SECOND // 3)], ids=["short", "long ago"])
def test_a_short_gap_or_one_that_is_over_explains_nothing(gap: int, end: int) -> None:
    assert paused(gap, end)[0].explain(FOLLOWS[0]) is None


def test_a_paused_gateway_stops_the_axis_and_names_itself() -> None:
    with operating() as (daemon, plc):
        world_of(daemon).loop.pause(4 * SECOND)
        plc.endpoint.set(0, {"STW1": ON})
        plc.until(lambda: drive_of(daemon).model.state is not State.OPERATION_ENABLED, "the stop")
        origin = daemon.axes[0].origins.present
        assert origin is not None
        assert (origin.by, "did not run for 4 s" in origin.evidence) == (By.GATEWAY, True)
        assert [event.text for event in daemon.events.after(0) if event.kind == "gateway"][-1] == (
            "the gateway did not run for 4 s"
        )
