"""By cause, not by axis: many objects with one cause are one line, on every surface."""

from __future__ import annotations

from datetime import datetime
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import AxisState, Enable, Finding, Reason
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.enable_status import ChainLink, EnableStatus
from pdgw.gateway.service.causes import causes
from pdgw.gateway.service.status import snapshot
from pdgw.tools.output.status_text import check_line, object_lines, status_lines
from pdgw.tools.web.status.events import EventLog
from tests.support.documents.situations import run_out
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, drive_of, running


def at(second: float) -> int:
    """A monotonic time in a minute of the day."""
    return int(second * SECOND)


LOOP = SimpleNamespace(now=lambda: 0, wall=lambda: datetime(2026, 3, 1, 14, 2).timestamp())


def stopped(
    do_id: int,
    reason: Reason,
    evidence: str = "",
    *,
    name: str = "",
    bus: str = "can",
    kind: str = "axis",
    **fields: Any,
) -> DriveObject:
    """An object with a broken link. ``fields``: of its finding; ``heard_ns``: when its device was heard last."""
    heard_ns = fields.pop("heard_ns", 0)
    found = Finding.of(reason, evidence)._replace(**fields)
    link = ChainLink(reason.enable, False, reason, found, cast(Loop, LOOP))
    item = SimpleNamespace(
        do_id=do_id,
        kind=kind,
        label=f'{kind} {do_id} "{name}"' if name else f"{kind} {do_id}",
        node_id=do_id,
        network=SimpleNamespace(name=bus, loop=LOOP),
        client=SimpleNamespace(received_ns=heard_ns),
        cause=None,
        shown=EnableStatus(reason.state, (link,)),
    )
    return cast(DriveObject, item)


ENCODER_FAULT = "EMCY 7305h incremental sensor 1"


def test_sixty_four_objects_with_four_causes_are_four_lines() -> None:
    items = [stopped(number, Reason.NO_PLC) for number in range(1, 61)]
    fault = {"number": 10, "code": 0x7305, "since_ns": at(11)}
    items += [
        stopped(61, Reason.DRIVE_FAULT, ENCODER_FAULT, name="slide", **fault),
        stopped(62, Reason.DRIVE_FAULT, "EMCY 3220h DC link under-voltage", **fault | {"code": 0x3220}),
        stopped(63, Reason.DRIVE_OFFLINE, "no answer", node=63),
        stopped(64, Reason.DRIVE_OFFLINE, "no answer", node=64),
    ]
    found = causes(items)
    assert [(cause["who"], cause["reason"]) for cause in found] == [
        ("axes 63-64", "2 of 64 nodes on bus can have not answered since the start: CAN cable or supply"),
        ('axis 61 "slide"', "EMCY 7305h incremental sensor 1, since 14:02:11"),
        ("axis 62", "EMCY 3220h DC link under-voltage, since 14:02:11"),
        ("axes 1-60", Reason.NO_PLC.value),
    ]
    assert found[3]["objects"] == list(range(1, 61))


def test_axes_with_the_same_fault_at_different_times_are_one_cause() -> None:
    items = [
        stopped(number, Reason.DRIVE_FAULT, ENCODER_FAULT, code=0x7305, since_ns=at(10 + number))
        for number in (1, 2, 4, 5)
    ]
    (cause,) = causes(items)
    assert (cause["who"], cause["reason"]) == (
        "axes 1-2, 4-5",
        "EMCY 7305h incremental sensor 1, since 14:02:11 to 14:02:15",
    )
    (cause,) = causes(items[:3])
    assert cause["reason"] == (
        "EMCY 7305h incremental sensor 1, since 14:02:11 (axis 1), 14:02:12 (axis 2), 14:02:14 (axis 4)"
    )


@pytest.mark.parametrize("evidence", ["motor 1 is too hot", "EMCY 7305h, register 21h"])
def test_digits_do_not_part_and_equal_words_do_not_join(evidence: str) -> None:
    """A cause is what the fields say, not how its text is spelled."""
    items = [
        stopped(1, Reason.DRIVE_FAULT, evidence, code=1, since_ns=at(11)),
        stopped(2, Reason.DRIVE_FAULT, evidence.replace("1", "2"), code=1, since_ns=at(12)),
        stopped(3, Reason.DRIVE_FAULT, evidence, code=3, since_ns=at(13)),
    ]
    assert [cause["who"] for cause in causes(items)] == ["axes 1-2", "axis 3"]


def latch(do_id: int, second: int, *, times: int = 1, ended: str = "", before: str = "") -> DriveObject:
    """An axis whose ON is ignored."""
    evidence = "the gateway has started" if ended else "node lost: silent"
    fields = {"since_ns": at(second), "times": times, "ended": ended, "before": before}
    return stopped(do_id, Reason.NEEDS_OFF, f"ON ignored: {evidence}", **fields)


def test_a_latch_of_several_axes_keeps_since_and_count_of_each() -> None:
    (cause,) = causes([latch(1, 11), latch(2, 11), latch(3, 15, times=3)])
    assert cause["reason"] == "ON ignored: node lost: silent, since 14:02:11 (axes 1-2), 14:02:15, 3 times (axis 3)"
    (cause,) = causes([latch(1, 11), latch(2, 11)])
    assert cause["reason"] == "ON ignored: node lost: silent, since 14:02:11"


def test_a_latch_of_an_earlier_day_has_its_date(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LOOP, "now", lambda: at(86_415))
    (cause,) = causes([latch(1, 11), latch(2, 11), latch(3, 15, times=3)])
    assert cause["reason"] == (
        "ON ignored: node lost: silent, since 14:01:56 on 2026-02-28 (axes 1-2), "
        "14:02:00 on 2026-02-28, 3 times (axis 3)"
    )


def test_a_stop_that_began_at_the_first_nanosecond_of_the_clock_has_its_time() -> None:
    (cause,) = causes([stopped(1, Reason.DRIVE_FAULT, ENCODER_FAULT, since_ns=0)])
    assert cause["reason"] == f"{ENCODER_FAULT}, since 14:02:00"


def test_a_start_of_several_axes_keeps_how_the_last_gateway_ended_and_what_was_before() -> None:
    ended = "the last one ended on 2026-03-01 at 04:11:02: stopped as commanded"
    lost = "node lost: silent, since 04:10:00"
    items = [latch(1, 11, ended=ended, before=lost), latch(2, 11, ended=ended, before=lost), latch(3, 11, ended=ended)]
    (cause,) = causes(items)
    assert cause["who"] == "axes 1-3"
    assert cause["reason"] == (
        f"ON ignored: the gateway has started, since 14:02:11; {ended}; before: axes 1-2: {lost}"
    )


def test_nodes_that_were_lost_at_one_moment_have_the_cause_that_explains_all_first() -> None:
    items = [
        stopped(1, Reason.DRIVE_OFFLINE, "has no TPDO1", node=1, heard_ns=at(1)),
        stopped(2, Reason.DRIVE_OFFLINE, "has no TPDO1", node=2, heard_ns=at(52)),
        stopped(3, Reason.DRIVE_OFFLINE, "has no TPDO2", node=3, heard_ns=at(51.8896)),
        stopped(4, Reason.NO_CONTROL),
        stopped(5, Reason.ENCODER_OFFLINE, "has no heartbeat", node=5, heard_ns=at(51.6), kind="encoder"),
        stopped(6, Reason.DRIVE_OFFLINE, "has no TPDO1", node=6, heard_ns=at(52), bus="can2"),
    ]
    found = [(cause["who"], cause["reason"]) for cause in causes(items)]
    assert found[0] == ("axes 2-3; encoder 5", "3 of 5 nodes on bus can lost within 400 ms: CAN cable or supply")
    assert found[1:] == [("axes 1, 6", "each node has no TPDO1"), ("axis 4", Reason.NO_CONTROL.value)]


def test_texts_that_differ_in_more_than_the_own_node_are_all_kept() -> None:
    wrong = ["profile '406'", "profile '402'", "profile '406'", "vendor-ID '0000ABCEh'", "EDS"]
    items = [
        stopped(number, Reason.NODE_REFUSED, f"is rejected: {what} is not allowed", node=number)
        for number, what in enumerate(wrong, 1)
    ]
    (cause,) = causes(items)
    assert (cause["who"], cause["reason"]) == (
        "axes 1-5",
        "axes 1, 3: each node is rejected: profile '406' is not allowed; "
        "axis 2: node 2 is rejected: profile '402' is not allowed; "
        "axis 4: node 4 is rejected: vendor-ID '0000ABCEh' is not allowed; and 1 more of the kind",
    )


def test_objects_in_operation_or_off_as_asked_have_no_cause() -> None:
    fine = stopped(1, Reason.NO_PLC)
    fine.shown = EnableStatus(AxisState.OBEYS, (ChainLink(Enable.PLC, True),))
    assert causes([fine, stopped(2, Reason.SWITCHED_OFF)]) == []


def named() -> GatewayConfig:
    tables = [axis(number, more=f'simulate = true\nname = "slide {number}"') for number in (1, 2)]
    return configuration("".join(tables), name="press")


def test_names_are_shown_beside_the_numbers(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "gateway"), running(named()) as daemon:
        plc = Plc(daemon, [1, 1])
        plc.endpoint.set(0, {"STW1": OFF})
        plc.endpoint.set(1, {"STW1": OFF})
        run_out(plc)
        drive_of(daemon).inject(7)
        run_out(plc)
        document = snapshot(daemon)
        assert document["name"] == "press"
        assert document["axes"][0]["name"] == "slide 1"
        lines = list(status_lines(document, 400))
        assert any(line.startswith('-> axis 1 "slide 1" Fault: ') for line in lines)
        assert any(line.startswith('axis 2 "slide 2": Off (node 2 online, telegram 1') for line in lines)
        assert len([line for line in lines if line.startswith("axis ")]) == 2, "one line for each axis"
        assert check_line(document)[1].startswith('CRITICAL - press: axis 1 "slide 1" Fault: ')
        assert 'axis 1 "slide 1": fault 7' in caplog.text
        text = "\n".join(object_lines(document, 2))
        assert text.startswith('axis 2 "slide 2", node 2 online')
        assert "slide 1" not in text
        with pytest.raises(GatewayError, match="axis 9: unknown drive object, allowed: 1, 2"):
            list(object_lines(document, 9))


@pytest.mark.parametrize("name", ["", " slide", "a/b", "a+b", "a#b", "x" * 41])
def test_names_that_topics_cannot_have_are_refused(name: str) -> None:
    with pytest.raises(GatewayError, match="name"):
        configuration(axis(1, more=f'simulate = true\nname = "{name}"'))


def test_no_name_is_given_twice() -> None:
    table = 'simulate = true\nname = "slide"'
    with pytest.raises(GatewayError, match="name"):
        configuration(axis(1, more=table) + axis(2, more=table))


def test_repeated_event_is_one_line_with_a_count() -> None:
    log = EventLog(1)
    for number in range(178):
        log.add(f"t{number}", "node", 7, "node 7: offline")
        log.add(f"t{number}", "node", 7, "node 7: configuring")
    log.add("t", "node", 8, "node 7: offline")
    found = [(event.text, event.do_id, event.count, event.since, event.time) for event in log.after(0)]
    assert found == [
        ("node 7: offline", 7, 178, "t0", "t177"),
        ("node 7: configuring", 7, 178, "t0", "t177"),
        ("node 7: offline", 8, 1, "t", "t"),
    ]
    assert [event.count for event in log.after(log.after(0)[0].id)] == [178, 1], "a repetition has a number of its own"


def test_abnormal_counters_of_many_parts_are_one_line_and_a_connect_has_none() -> None:
    with running(configuration(axis(1))) as daemon:
        document = snapshot(daemon)
    counter = {"value": 2, "unit": "times", "name": "timeouts", "meaning": "no answer"}
    counters = [counter | {"part": f"node {number} on can"} for number in range(1, 65)]
    counters.append(counter | {"part": "link", "name": "no_tick"})
    lines = [line for line in status_lines(document | {"counters": counters}) if "time" in line or "no_tick" in line]
    assert lines == ["  64 parts, timeouts: 128 times (no answer)"]
