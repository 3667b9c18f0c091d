"""By cause, not by axis: many objects with one cause are one line, on every surface."""

from __future__ import annotations

from typing import Any

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import AxisState, Reason
from pdgw.gateway.base.step_text import remedy_text
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.service.causes import causes
from pdgw.gateway.service.status import snapshot
from pdgw.tools.output.status_text import check_line, object_lines, status_lines
from pdgw.tools.web.status.events import EventLog
from tests.support.documents.situations import run_out
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, drive_of, running


def status(
    do_id: int,
    reason: Reason,
    *,
    fault: int = 0,
    text: str = "",
    name: str = "",
    bus: str = "can",
    heard_age_ms: float | None = None,
    time: str = "2026-03-01T14:02:11+00:00",
    origin: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """What ``causes`` reads of the status of an axis."""
    label = f'axis {do_id} "{name}"' if name else f"axis {do_id}"
    return {
        "do_id": do_id,
        "label": label,
        "state": reason.state.value,
        "state_id": reason.state.name,
        "reason": text or reason.value,
        "reason_id": reason.name,
        "remedy": remedy_text(reason.remedy),
        "cause": {"code": fault, "time": time} if fault else None,
        "origin": origin,
        "bus": bus,
        "node_id": do_id,
        "heard_age_ms": heard_age_ms,
    }


def test_sixty_four_objects_with_four_causes_are_four_lines() -> None:
    items = [status(number, Reason.NO_PLC) for number in range(1, 61)]
    items += [
        status(
            61, Reason.DRIVE_FAULT, fault=0x7305, text="EMCY 7305h incremental sensor 1, since 14:02:11", name="slide"
        ),
        status(62, Reason.DRIVE_FAULT, fault=0x3220, text="EMCY 3220h DC link under-voltage, since 14:02:12"),
        status(63, Reason.DRIVE_OFFLINE, text="node 63: no answer"),
        status(64, Reason.DRIVE_OFFLINE, text="node 64: no answer"),
    ]
    found = causes(items)
    assert [(cause["who"], cause["reason"]) for cause in found] == [
        ("axes 63-64", "2 of 64 nodes on bus can have not answered since the start: CAN cable or supply"),
        ('axis 61 "slide"', "EMCY 7305h incremental sensor 1, since 14:02:11"),
        ("axis 62", "EMCY 3220h DC link under-voltage, since 14:02:12"),
        ("axes 1-60", Reason.NO_PLC.value),
    ]
    assert found[3]["objects"] == list(range(1, 61))


def test_axes_with_the_same_fault_at_different_times_are_one_cause() -> None:
    items = [
        status(
            number,
            Reason.DRIVE_FAULT,
            fault=0x7305,
            text=f"EMCY 7305h incremental sensor 1, since 14:02:1{number}",
            time=f"2026-03-01T14:02:1{number}+00:00",
        )
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


def latch(do_id: int, second: int, *, count: int = 1, ended: str = "", before: str = "") -> dict[str, Any]:
    """The status of an axis whose ON is ignored."""
    evidence = "the gateway has started" if ended else "node lost: silent"
    times = f" ({count} times)" if count > 1 else ""
    tail = (f"; {ended}" if ended else "") + (f"; before: {before}" if before else "")
    first = f"2026-03-01T14:02:{second}+00:00"
    origin = {"text": evidence, "first": first, "count": count, "ended": ended, "before": before}
    text = f"ON ignored: {evidence}, since 14:02:{second}{times}{tail}"
    return status(do_id, Reason.NEEDS_OFF, text=text, origin=origin)


def test_a_latch_of_several_axes_keeps_since_and_count_of_each() -> None:
    (cause,) = causes([latch(1, 11), latch(2, 11), latch(3, 15, count=3)])
    assert cause["reason"] == "ON ignored: node lost: silent, since 14:02:11 (axes 1-2), 14:02:15, 3 times (axis 3)"
    (cause,) = causes([latch(1, 11), latch(2, 11)])
    assert cause["reason"] == "ON ignored: node lost: silent, since 14:02:11"


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
        status(1, Reason.DRIVE_OFFLINE, text="node 1: no TPDO1", heard_age_ms=60_000.0),
        status(2, Reason.DRIVE_OFFLINE, text="node 2: no TPDO1", heard_age_ms=9000.0),
        status(3, Reason.DRIVE_OFFLINE, text="node 3: no TPDO2", heard_age_ms=9110.4),
        status(4, Reason.NO_CONTROL),
        status(5, Reason.ENCODER_OFFLINE, text="node 5: no heartbeat", heard_age_ms=9400.0) | {"label": "encoder 5"},
        status(6, Reason.DRIVE_OFFLINE, text="node 6: no TPDO1", heard_age_ms=9000.0, bus="can2"),
    ]
    found = [(cause["who"], cause["reason"]) for cause in causes(items)]
    assert found[0] == ("axes 2-3; encoder 5", "3 of 5 nodes on bus can lost within 400 ms: CAN cable or supply")
    assert found[1:] == [("axes 1, 6", "each node: no TPDO1"), ("axis 4", Reason.NO_CONTROL.value)]


def test_texts_that_differ_in_more_than_the_own_node_are_all_kept() -> None:
    items = [
        status(1, Reason.NODE_REFUSED, text="node 1 is rejected: profile '406' is not allowed, expected 402"),
        status(3, Reason.NODE_REFUSED, text="node 3 is rejected: profile '402' is not allowed, expected 406"),
        status(4, Reason.NODE_REFUSED, text="node 4 is rejected: profile '406' is not allowed, expected 402"),
        status(5, Reason.NODE_REFUSED, text="node 5 is rejected: vendor-ID '0000ABCEh' is not allowed"),
    ]
    assert [(cause["who"], cause["reason"]) for cause in causes(items)] == [
        (
            "axes 1, 3-4",
            "axes 1, 4: each node is rejected: profile '406' is not allowed, expected 402; "
            "axis 3: each node is rejected: profile '402' is not allowed, expected 406",
        ),
        ("axis 5", "node 5 is rejected: vendor-ID '0000ABCEh' is not allowed"),
    ]


def test_objects_in_operation_or_off_as_asked_have_no_cause() -> None:
    fine = status(1, Reason.NO_PLC) | {"state_id": AxisState.OBEYS.name, "reason_id": ""}
    assert causes([fine, status(2, Reason.SWITCHED_OFF)]) == []


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
