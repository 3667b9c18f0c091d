"""Each cause of a line has one budget in the log, whatever reports it; what it omits is counted."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.gateway.base.log_budget import AT_ONCE, REPORT_NS, LogBudget
from tests.support.gateways.daemon import ON, Plc, drive_of, operating

log = logging.getLogger("gateway")


@pytest.fixture
def loop() -> Iterator[VirtualLoop]:
    loop = VirtualLoop()
    budget = LogBudget(loop)
    budget.start()
    yield loop
    budget.stop()


@pytest.fixture(autouse=True)
def _level(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="gateway")


def fault(text: str, number: int = 101, do: int = 1) -> None:
    log.error("%s", text, extra={"event": "fault", "do": do, "fault": number})


def test_line_that_is_repeated_is_counted_every_ten_seconds(
    loop: VirtualLoop, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(600):
        log.info("again")
        loop.run_for(SECOND // 10)
    lines = caplog.messages
    assert lines[:AT_ONCE] == ["again"] * AT_ONCE
    assert len(lines) <= AT_ONCE + 7
    counted = sum(int(text.split("(")[1].split()[0]) for text in lines if "more since the last report" in text)
    assert 500 < counted + len(lines) <= 600


def test_storm_of_a_fault_hides_no_other_fault_and_no_other_axis(
    loop: VirtualLoop, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(6000):
        fault(f"EMCY {number}")
    fault("other drive", do=2)
    fault("other fault", number=106)
    loop.run_for(2 * REPORT_NS)
    assert caplog.messages == [
        *(f"EMCY {number}" for number in range(AT_ONCE)),
        "other drive",
        "other fault",
        f"EMCY 5999 ({5999 - AT_ONCE} more since the last report)",
    ]
    fault("later")
    assert caplog.messages[-1] == "later"


def test_reason_that_toggles_hides_no_other_reason(loop: VirtualLoop, caplog: pytest.LogCaptureFixture) -> None:
    for second in range(600):
        reason = "WAITS" if second % 2 else "OBEYS"
        log.info("axis 1: %s, since %d", reason, second, extra={"event": "reason", "do": 1, "reason": reason})
        loop.run_for(SECOND)
    assert len(caplog.messages) <= 2 * (AT_ONCE + 61)
    log.info("axis 1: lost", extra={"event": "reason", "do": 1, "reason": "LOST"})
    assert caplog.messages[-1] == "axis 1: lost"


def test_lines_without_an_event_are_limited_by_their_place_in_the_code(
    loop: VirtualLoop, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(1000):
        log.info("line %d", number)
    log.info("another place")
    assert len(caplog.messages) == AT_ONCE + 1


def test_end_of_the_gateway_reports_what_was_omitted(caplog: pytest.LogCaptureFixture) -> None:
    budget = LogBudget(VirtualLoop())
    budget.start()
    for _ in range(AT_ONCE + 5):
        log.info("again")
    budget.stop()
    assert caplog.messages[-1] == "again (4 more since the last report)"
    assert not log.filters


def toggles_stop(plc: Plc, cycle: int) -> None:
    plc.endpoint.run = bool(cycle & 1)


def toggles_enable(plc: Plc, cycle: int) -> None:
    plc.endpoint.set(0, {"STW1": ON if cycle & 1 else ON & ~0x40})


def toggles_control(plc: Plc, cycle: int) -> None:
    plc.endpoint.set(0, {"STW1": ON if cycle & 1 else ON & ~0x400})


def sends_emergencies(plc: Plc, cycle: int) -> None:
    drive_of(plc.daemon).do(lambda node: node.send_emcy(0x5000 + cycle, 1))


def loses_frames(plc: Plc, cycle: int) -> None:
    plc.silent = cycle % 100 < 90


def restarts_the_drive(plc: Plc, cycle: int) -> None:
    if cycle % 100 == 0:
        drive_of(plc.daemon).do(lambda node: node.restart())


@pytest.mark.parametrize(
    "repeats",
    [toggles_stop, toggles_enable, toggles_control, sends_emergencies, loses_frames, restarts_the_drive],
    ids=lambda function: function.__name__,
)
def test_each_source_that_repeats_for_six_seconds_writes_few_lines(
    repeats: Callable[[Plc, int], None], caplog: pytest.LogCaptureFixture
) -> None:
    with operating() as (_, plc):
        caplog.clear()
        for cycle in range(1500):
            repeats(plc, cycle)
            plc.exchange()
        assert len(caplog.messages) <= 8 * AT_ONCE, caplog.messages[-20:]
