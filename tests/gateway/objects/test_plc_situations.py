"""Causes beside each other: the first line names the physical one, and a second PLC is a warning."""

from __future__ import annotations

import pytest

from pdgw.durations import MS, SECOND
from pdgw.gateway.reasons import AxisState, Enable, Reason
from pdgw.gateway.service.status import snapshot
from pdgw.tools.output.status_text import Health, check_line, status_lines
from tests.support.documents.plc_situations import CONTROLLER_SITUATIONS, PLC_SITUATIONS
from tests.support.documents.situation_table import BY_LINK
from tests.support.documents.situations import BREAKERS, at_situation, settle
from tests.support.gateways.daemon import Plc, axis, configuration, running

_SLOW_PLC = "the PLC sends every 20 ms, and the watchdog time is 12 ms"
_SHORT_NS = 400 * MS
"""By then a node is found to be lost."""


@pytest.mark.parametrize(
    ("link", "title"),
    [*(("udp", title) for title in BY_LINK["udp"]), *(("profinet", title) for title in CONTROLLER_SITUATIONS)],
)
def test_a_physical_cause_is_named_before_each_other_one(link: str, title: str) -> None:
    """Each one comes beside all before it: the sentence names the first link of the chain."""
    with at_situation(BY_LINK[link][title], link) as (daemon, plc):
        item = daemon.objects[0]
        own = item.enable_status.broken
        assert own is not None
        chain = [known.enable for known in item.enable_status.chain]
        first = chain.index(own.enable)
        for enable in (Enable.NO_FAULT, Enable.SUPPLY, Enable.NODE, Enable.BUS):
            if enable in chain:
                BREAKERS[enable](plc, daemon)
                settle(plc, _SHORT_NS)
                first = min(first, chain.index(enable))
                broken = item.enable_status.broken
                assert broken is not None
                assert broken.enable is chain[first], item.enable_status.sentence
        if own.enable is Enable.PLC:
            assert own in item.enable_status.chain, "the page shows it beside the first one"


def test_repeated_losses_of_the_plc_do_not_fill_the_log(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "gateway"), at_situation(PLC_SITUATIONS[_SLOW_PLC]) as (daemon, plc):
        settle(plc, 10 * SECOND)
        assert "watchdog_expiries: 5" in " ".join(status_lines(snapshot(daemon), 400, counters=True))
        assert len([text for text in caplog.messages if "fault 103" in text]) <= 4
        lines = [text for text in caplog.messages if text.startswith("PLC")]
        assert len(lines) <= 8, lines
        assert "20 ms apart, the limit is 12 ms; raise" in lines[-1]
        assert lines[-1].endswith("times in 1 s)")


def test_log_of_frames_that_do_not_count_has_the_words_of_the_first_line(caplog: pytest.LogCaptureFixture) -> None:
    with (
        caplog.at_level("INFO", "gateway"),
        at_situation(PLC_SITUATIONS["the PLC sends another FrameID"]) as (daemon, _),
    ):
        broken = daemon.objects[0].enable_status.broken
        assert broken is not None
        assert [text for text in caplog.messages if text.startswith("frames")] == [
            f"{broken.evidence}; {broken.remedy}"
        ]


def test_a_second_plc_is_a_warning_beside_the_first_one() -> None:
    with running(configuration(axis(1))) as daemon:
        plc, second = Plc(daemon, [1]), Plc(daemon, [1], "other")
        plc.enable()
        for _ in range(100):
            plc.exchange()
            second.send()
        document = snapshot(daemon)
        assert document["axes"][0]["state_id"] == AxisState.OBEYS.name
        assert document["plc"]["refused_id"] == Reason.OTHER_SENDER.name
        health, line = check_line(document)
        assert health is Health.WARNING
        assert document["plc"]["refused"] in line
        assert "switch the other sender off" in " ".join(status_lines(document, 400))
