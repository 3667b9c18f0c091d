"""What the first line reports when the device, or its use by the PLC's program, is the cause; the remedy cures it."""

from __future__ import annotations

import pytest

from pdgw.gateway.daemon import Daemon
from pdgw.gateway.reasons import AxisState
from pdgw.gateway.service.status import snapshot
from pdgw.profidrive.words import unswapped
from pdgw.tools.output.status_text import cause_sentence, check_line, object_lines
from tests.support.documents.situation_table import BY_LINK
from tests.support.documents.situations import Situation, at_situation, settle
from tests.support.gateways.daemon import ON, POSITIONER, Plc, axis, configuration, running

_ATTEMPTS = 12
"""Several attempts to bring a node up, at different times within one."""
_ASKED = 10
"""Calls of ``--check`` that have the same result."""


@pytest.mark.parametrize(("link", "title"), [(link, title) for link, found in BY_LINK.items() for title in found])
def test_first_line_names_the_cause_and_its_remedy_cures_it(link: str, title: str) -> None:
    situation = BY_LINK[link][title]
    with at_situation(situation, link) as (daemon, plc):
        item = daemon.objects[0]
        for _ in range(_ATTEMPTS if "rejected" in situation.says else 1):
            for _ in range(_ASKED):
                plc.exchange()
                judge(situation, daemon)
            settle(plc)
        situation.cure(plc, daemon)
        settle(plc)
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
    with running(configuration(axis(1, telegram_number=number, more=f"simulate = true\n{more}"))) as daemon:
        plc = Plc(daemon, [number])
        plc.enable()
        plc.endpoint.set(0, {"STW1": word, **others})
        settle(plc)
        document = snapshot(daemon)
        assert document["axes"][0]["state_id"] == AxisState.OBEYS.name
        assert [text for text in document["axes"][0]["notes"] if not text.startswith(note)] == []
        assert bool(document["axes"][0]["notes"]) is bool(note)
        assert (f"note: {note}" in " ".join(object_lines(document, 1, 400))) is bool(note)


@pytest.mark.parametrize(
    "word", [0x047E, 0x047F, 0x04FE, 0x043F, 0x0C3F, 0x0C7F, 0x047B, 0x0000, 0x0400, 0xF47F, 0x0604]
)
def test_word_of_a_healthy_program_is_not_taken_for_one_with_swapped_bytes(word: int) -> None:
    assert unswapped(word) is None


@pytest.mark.parametrize("word", [0x047E, 0x047F, 0x04FE, 0x043F, 0x0C3F])
def test_swapped_bytes_are_found(word: int) -> None:
    assert unswapped((word & 0xFF) << 8 | word >> 8) == word
