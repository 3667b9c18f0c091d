"""Happenings around the last fault or stop, and the first line of the causes of device and PLC."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.reasons import AxisState, Enable, Reason
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.objects.happenings import LINES, Happening, around_the_last_stop
from pdgw.gateway.service import status_client
from pdgw.gateway.service.status import explanation, snapshot
from pdgw.gateway.service.status_port import answered
from pdgw.profidrive.words import unswapped
from pdgw.tools.commands.gateway import status as command
from pdgw.tools.output.status_text import Health, cause_sentence, check_line, object_lines, status_lines
from tests.conformance.rig import COMPLETE
from tests.support.documents.plc_situations import CONTROLLER_SITUATIONS, PLC_SITUATIONS
from tests.support.documents.situation_table import BY_LINK, WRITTEN, situation_row, written_rows
from tests.support.documents.situations import (
    BREAKERS,
    SITUATIONS,
    SLOW_PLC,
    Situation,
    at_situation,
    in_operation,
    run_out,
)
from tests.support.gateways.daemon import (
    OFF,
    ON,
    POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    running,
    until,
)

# -- few lines, the cause among them, on command and page ---------------------------------------------------------


def happening(time_ns: int, text: str, do_id: int = 1, *, stops: bool = False) -> Happening:
    return Happening(time_ns, do_id, text, stops)


def test_without_a_fault_or_stop_there_is_nothing_to_explain() -> None:
    assert around_the_last_stop([happening(1, "In operation")]) == []


def test_lines_begin_before_the_first_of_the_faults_that_belong_together() -> None:
    long_ago = [happening(number, f"old fault {number}", stops=True) for number in range(3)]
    calm = [happening(60 * SECOND + number, f"calm {number}") for number in range(5)]
    series = [happening(90 * SECOND + number * SECOND, f"fault {number}", stops=True) for number in range(3)]
    after = [happening(100 * SECOND + number, f"after {number}") for number in range(20)]
    texts = [line.text for line in around_the_last_stop([*after, *series, *calm, *long_ago])]
    assert texts[:6] == ["calm 2", "calm 3", "calm 4", "fault 0", "fault 1", "fault 2"]
    assert len(texts) == LINES


def test_last_fault_of_a_long_series_is_among_the_lines() -> None:
    series = [happening(number * SECOND, f"fault {number}", stops=True) for number in range(40)]
    texts = [line.text for line in around_the_last_stop([*series, happening(99 * SECOND, "after")])]
    assert texts[-2:] == ["fault 39", "after"]
    assert len(texts) <= LINES


def test_one_thing_of_many_axes_is_one_line() -> None:
    found = around_the_last_stop(happening(number * MS, "PLC lost", number, stops=True) for number in range(1, 33))
    assert len(found) == 1
    assert found[0].objects == set(range(1, 33))


def test_what_is_repeated_is_counted() -> None:
    series = [happening(number * 2 * SECOND, "contactor open", stops=True) for number in range(21)]
    (line,) = around_the_last_stop(series)
    assert line.shown == "contactor open (21 times in 40 s)"
    later = around_the_last_stop([series[0], happening(60 * SECOND, "contactor open", stops=True)])
    assert [line.shown for line in later] == ["contactor open"] * 2


def test_repetition_of_several_axes_is_counted_once_and_stays_in_order() -> None:
    series = [
        happening(number * 4 * SECOND + place * MS, text, do_id, stops=bool(place))
        for number in range(10)
        for do_id in (1, 2, 3)
        for place, text in enumerate(("In operation", "contactor open", "fault"))
    ]
    found = around_the_last_stop(series)
    assert [line.shown for line in found] == [
        f"{text} (10 times in 36 s)" for text in ("In operation", "contactor open", "fault")
    ]
    assert all(len(line.objects) == 3 for line in found)


def test_a_fault_that_returns_is_one_line_with_its_count() -> None:
    with running(configuration(axis(1) + axis(2), transport=SLOW_PLC)) as daemon:
        plc = Plc(daemon, [1, 1])
        plc.endpoint.set(1, {"STW1": OFF})
        plc.enable()
        for _ in range(6):
            drive_of(daemon).inject(7)
            run_out(plc)
            drive_of(daemon).clear()
            plc.endpoint.set(0, {"STW1": OFF | 0x80})
            run_out(plc)
            plc.enable()
        texts = [line["text"] for line in explanation(daemon, daemon.objects)]
    assert len(texts) <= LINES
    for text in ("fault 7: EMCY 2310h over-current", "Fault: EMCY 2310h over-current"):
        (line,) = (item for item in texts if item.startswith(text))
        assert re.fullmatch(re.escape(text) + r" \(6 times in \d\d s\)", line)


def test_the_axis_that_stopped_the_machine_is_shown_among_16_objects() -> None:
    with running(
        configuration("".join(axis(number) for number in range(1, 17)), transport="cycle_time_ms = 50")
    ) as daemon:
        plc = Plc(daemon, [1] * 16)
        until(daemon, lambda: all(item.drive.generation for item in daemon.axes), "online", 100 * SECOND)
        for word in (OFF, ON):
            for place in range(16):
                plc.endpoint.set(place, {"STW1": word})
            run_out(plc)
        drive_of(daemon, 10).inject(7)
        plc.exchange()
        plc.exchange()
        for place in range(16):
            plc.endpoint.set(place, {"STW1": 0x047B})
        run_out(plc)
        lines = [f"{line['who']}: {line['text']}" for line in explanation(daemon, daemon.objects)]
    assert len(lines) <= LINES
    assert "axis 10: fault 7: EMCY 2310h over-current" in lines
    assert any(line.startswith("axes 1-9, 11-16: Stopping: quick stop") for line in lines)


@pytest.mark.parametrize("frames", [1, 20])
@pytest.mark.parametrize(
    ("attribute", "value", "text"),
    [
        ("run", False, "the PLC is in STOP: its frames come"),
        ("bad", {0}, "the PLC marks its data for this drive object as bad"),
    ],
)
def test_frames_without_setpoints_are_the_cause_of_a_stop(
    attribute: str, value: object, text: str, frames: int
) -> None:
    with in_operation() as (daemon, plc):
        run_out(plc)
        before = getattr(plc.endpoint, attribute)
        setattr(plc.endpoint, attribute, value)
        plc.exchange(frames)
        setattr(plc.endpoint, attribute, before)
        run_out(plc)
        texts = [line["text"] for line in explanation(daemon, daemon.objects)]
        cause = next(place for place, line in enumerate(texts) if line.startswith(text))
        assert texts[cause - 1] == "In operation"
        assert texts[cause + 1].startswith("Stopping: ")


def test_cause_comes_before_what_follows_from_it() -> None:
    with running(configuration(axis(1) + axis(2), transport=SLOW_PLC)) as daemon:
        plc = Plc(daemon, [1, 1])
        plc.endpoint.set(1, {"STW1": OFF})
        plc.enable()
        run_out(plc)
        drive_of(daemon).inject(7)
        run_out(plc)
        plc.silent = True
        run_out(plc)
        texts = [f"{line['who']}: {line['text']}" for line in explanation(daemon, daemon.objects)]
        cause = next(place for place, text in enumerate(texts) if text.startswith("axis 1: fault 7: EMCY"))
        loss = next(place for place, text in enumerate(texts) if "PLC lost" in text)
        assert cause < loss
        assert any(text.startswith("axis 1: Fault: ") for text in texts)
        assert "axis 1: In operation" in texts
        assert len(texts) <= LINES
        answer = json.loads(b"".join(answered(daemon, b"explain 1\n")))
        assert answer["lines"] == explanation(daemon, [daemon.axes[0]])
        assert json.loads(b"".join(answered(daemon, b"explain 9\n")))["field"] == "do_id"


def test_command_prints_the_lines_and_writes_the_support_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with in_operation() as (daemon, plc):
        drive_of(daemon).inject(7)
        run_out(plc)
        lines, document = explanation(daemon, daemon.objects), snapshot(daemon)
    monkeypatch.setattr(status_client, "fetch_explanation", lambda *_: lines)
    monkeypatch.setattr(status_client, "fetch", lambda *_: document)
    file = tmp_path / "support.zip"
    command.explain(None, 1, file)
    out = capsys.readouterr().out.splitlines()
    assert len(out) == len(lines) + 1
    assert any("  axis 1: fault 7: EMCY" in line for line in out)
    with zipfile.ZipFile(file) as archive:
        assert {"explain.txt", "status.json"} <= set(archive.namelist())
        assert archive.read("explain.txt").decode().splitlines() == out[:-1]


# -- a cause in the device or its use by the PLC, and its remedy --------------------------------------------------


_ATTEMPTS = 4
"""Several attempts to bring a node up, at different times within one."""
_ASKED = 5
"""Calls of ``--check`` that have the same result."""
_OF_THE_PLC = {title: situation for title, situation in SITUATIONS.items() if "PLC" in title}
IN_SUITE = {"udp": BY_LINK["udp"], "profinet": _OF_THE_PLC | CONTROLLER_SITUATIONS}
"""Over PROFINET only those of the PLC; of the others, where only the link differs, ``make conformance`` has both."""


def test_the_document_has_every_situation_once() -> None:
    assert list(written_rows()) == [title for situations in WRITTEN.values() for title in situations]


@pytest.mark.parametrize(
    ("link", "title"),
    [(link, title) for link, found in (BY_LINK if COMPLETE else IN_SUITE).items() for title in found],
)
def test_first_line_names_the_cause_and_its_remedy_cures_it(link: str, title: str) -> None:
    situation = BY_LINK[link][title]
    with at_situation(situation, link) as (daemon, plc):
        item = daemon.objects[0]
        if title in WRITTEN[link]:
            assert written_rows()[title] == situation_row(title, daemon), "the document has what the gateway reports"
        for _ in range(_ATTEMPTS if "rejected" in situation.says else 1):
            for _ in range(_ASKED):
                plc.exchange()
                judge(situation, daemon)
            run_out(plc)
        situation.cure(plc, daemon)
        plc.until(lambda: item.enable_status.state is AxisState.OBEYS, item.enable_status.sentence)


def judge(situation: Situation, daemon: Daemon) -> None:
    """The first line has the words of a situation, and ``--check`` its exit status."""
    document = snapshot(daemon)
    item = (*document["axes"], *document["encoders"])[0]
    line = cause_sentence(document["causes"][0]) if document["causes"] else item["sentence"]
    assert [text for text in situation.says if text.lower() not in line.lower()] == [], line
    assert [text for text in situation.lacks if text.lower() in line.lower()] == [], line
    assert line.count("is not allowed") <= 1, line
    health, checked = check_line(document)
    assert health is situation.health
    assert line in checked or not document["causes"], checked


@pytest.mark.parametrize(
    ("number", "more", "word", "others", "note"),
    [
        (1, "", ON | 1 << 11, {}, "without effect in telegram 1: STW1.11 = 1; a negative setpoint turns backwards"),
        (1, "", ON | 1 << 13 | 1 << 15, {}, "sent to the drive as the same bits of the Controlword: STW1.13, STW1.15"),
        (1, "", ON, {"NSOLL_A": 0x7FFF}, "NSOLL_A is 199.994 %: above 100 %"),
        (9, "", 0x053F, {"SATZANW": 0x8000}, "without effect in telegram 9: STW1.8 = 1"),
        (111, POSITIONER, 0x543F, {"OVERRIDE": 0x4000}, "without effect in telegram 111: STW1.12 = 1, STW1.14 = 1"),
        (1, "", ON, {"NSOLL_A": 0x4000}, ""),
        (111, POSITIONER, 0x043F, {"OVERRIDE": 0x4000}, ""),
    ],
)
def test_words_without_effect_are_a_note_of_an_axis_in_operation(
    number: int, more: str, word: int, others: dict[str, int], note: str
) -> None:
    with in_operation(axis(1, telegram_number=number, more=f"simulate = true\n{more}")) as (daemon, plc):
        plc.endpoint.set(0, {"STW1": word, **others})
        run_out(plc)
        document = snapshot(daemon)
        assert document["axes"][0]["state_id"] == AxisState.OBEYS.name
        assert [text for text in document["axes"][0]["notes"] if not text.startswith(note)] == []
        assert bool(document["axes"][0]["notes"]) is bool(note)
        assert (f"note: {note}" in " ".join(object_lines(document, 1, 400))) is bool(note)


@pytest.mark.parametrize(
    "word", [0x047E, 0x047F, 0x04FE, 0x043F, 0x0C3F, 0x0C7F, 0x047B, 0x0000, 0x0400, 0xF47F, 0x0604]
)
def test_word_of_a_healthy_program_does_not_count_as_one_with_swapped_bytes(word: int) -> None:
    assert unswapped(word) is None


@pytest.mark.parametrize("word", [0x047E, 0x047F, 0x04FE, 0x043F, 0x0C3F])
def test_swapped_bytes_are_found(word: int) -> None:
    assert unswapped((word & 0xFF) << 8 | word >> 8) == word


# -- causes beside each other: the first line names the physical one ----------------------------------------------


_SLOW_PLC = "the PLC sends every 20 ms, and the watchdog time is 12 ms"
_SHORT_NS = 400 * MS
"""By then a node is found to be lost."""


@pytest.mark.parametrize(
    ("link", "title"),
    [
        *(("udp", title) for title in (BY_LINK["udp"] if COMPLETE else PLC_SITUATIONS)),
        *(("profinet", title) for title in CONTROLLER_SITUATIONS),
    ],
)
def test_a_physical_cause_is_named_before_each_other_one(link: str, title: str) -> None:
    """Each one comes beside all before it: the sentence names the first link of the chain.

    A cause of the PLC is behind all of them; ``make conformance`` has the other causes too.
    """
    with at_situation(BY_LINK[link][title], link) as (daemon, plc):
        item = daemon.objects[0]
        own = item.enable_status.broken
        assert own is not None
        chain = [known.enable for known in item.enable_status.chain]
        first = chain.index(own.enable)
        for enable in (Enable.NO_FAULT, Enable.SUPPLY, Enable.NODE, Enable.BUS):
            if enable in chain:
                BREAKERS[enable](plc, daemon)
                run_out(plc, _SHORT_NS)
                first = min(first, chain.index(enable))
                broken = item.enable_status.broken
                assert broken is not None
                assert broken.enable is chain[first], item.enable_status.sentence
        if own.enable is Enable.PLC:
            assert own in item.enable_status.chain, "the page shows it beside the first one"


def test_repeated_losses_of_the_plc_do_not_fill_the_log(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "gateway"), at_situation(PLC_SITUATIONS[_SLOW_PLC]) as (daemon, plc):
        run_out(plc, 10 * SECOND)
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
        assert [text for text in caplog.messages if text.startswith("frames")] == [f"{broken.evidence}; {broken.todo}"]


def test_a_second_plc_is_a_warning_beside_the_first_one() -> None:
    with in_operation() as (daemon, plc):
        second = Plc(daemon, [1], "other")
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
