"""Faults that come again and again: a number in the status, and one line among the happenings."""

from __future__ import annotations

from pdgw.base.durations import SECOND
from pdgw.gateway.axis.values import FaultRecord, gateway_fault
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.finding_text import DAY_NS
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.objects.totals import FLAPS, Totals
from pdgw.gateway.service.status import explanation, snapshot
from pdgw.tools.output.status_text import status_lines
from tests.support.documents.origin_situations import lose
from tests.support.documents.situations import in_operation, run_out, words
from tests.support.gateways.daemon import OFF, ON, Plc, axis, drive_of


def test_a_total_counts_from_its_first_time_until_it_did_not_come_for_a_day() -> None:
    totals = Totals()
    for number in range(3):
        totals.enter(gateway_fault(FaultNumber.NODE_LOST, f"for another reason {number}", number * SECOND))
    totals.enter(gateway_fault(FaultNumber.PLC_LOST, "", 4 * SECOND))
    newest, oldest = totals.present(5 * SECOND)
    assert (newest.evidence, newest.times) == ("PLC lost", 1)
    assert (oldest.evidence, oldest.times, oldest.since_ns, oldest.last_ns) == ("node lost", 3, 0, 2 * SECOND)
    assert len(totals.present(DAY_NS + 3 * SECOND)) == 1
    totals.enter(gateway_fault(FaultNumber.NODE_LOST, "", 2 * DAY_NS))
    assert [total.times for total in totals.present(2 * DAY_NS)] == [1]


def test_the_fault_that_came_last_is_first() -> None:
    totals = Totals()
    for second, number in enumerate((FaultNumber.NODE_LOST, FaultNumber.PLC_LOST, FaultNumber.NODE_LOST)):
        totals.enter(gateway_fault(number, "", second * SECOND))
    assert [total.evidence for total in totals.present(3 * SECOND)] == ["node lost", "PLC lost"]


def test_different_faults_of_a_device_have_a_limit() -> None:
    totals = Totals()
    for number in range(1000):
        totals.enter(FaultRecord(12, number, 0, "EMCY", number))
    assert len(totals.present(1000)) == 64


def flap(plc: Plc, daemon: Daemon, times: int) -> None:
    """The drive is lost, and the program of the PLC acknowledges and switches on again."""
    for _ in range(times):
        lose(plc, daemon)
        words((OFF, {}), (OFF | 0x80, {}), (OFF, {}))(plc, daemon)
        plc.enable()
        run_out(plc, 40 * SECOND)


def test_losses_that_were_acknowledged_stay_in_the_status() -> None:
    with in_operation() as (daemon, plc):
        flap(plc, daemon, 3)
        document = snapshot(daemon)
        assert document["axes"][0]["state"] == "In operation"
        (total,) = document["axes"][0]["totals"]
        assert (total["name"], total["count"]) == ("node lost", 3)
        assert any(line.startswith("  node lost: 3 times since 22:13:") for line in status_lines(document, 200))


def test_one_flapping_device_does_not_hide_the_stop_of_another_axis() -> None:
    with in_operation(axis(1) + axis(2)) as (daemon, plc):
        plc.endpoint.set(1, {"STW1": OFF})
        run_out(plc)
        plc.endpoint.set(1, {"STW1": ON})
        run_out(plc)
        drive_of(daemon, 2).inject(7)
        run_out(plc)
        flap(plc, daemon, FLAPS)
        lines = explanation(daemon, daemon.objects)
        of_the_first = [line["text"] for line in lines if line["who"] == "axis 1"]
        assert len(of_the_first) == 1
        assert of_the_first[0].startswith(f"node lost: {FLAPS} times since 22:13:")
        assert any(line["who"] == "axis 2" and "EMCY 2310h" in line["text"] for line in lines)
        own = explanation(daemon, daemon.objects[:1])
        assert len(own) > 1, "alone it has its lines"
        assert any(f"{FLAPS} times since" in line["text"] for line in own)
