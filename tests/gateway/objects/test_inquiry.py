"""What the answers of a drive show that does not follow."""

from __future__ import annotations

import pytest

from pdgw.gateway.objects.inquiry import SENDS_NOTHING, Answer, untaken

WORD = (0x6040, 0)


@pytest.mark.parametrize(
    ("answer", "contradicts"),
    [
        (Answer({WORD: 0x06}, silent=False), False),
        (Answer({WORD: 0x1806}, silent=False), False),
        (Answer({WORD: 0x00}, silent=False), True),
        (Answer({WORD: 0x0F}, silent=False), True),
        (Answer({}, silent=False), False),
        (Answer({}, silent=True), True),
    ],
    ids=["as sent", "other bits of its own", "nothing", "another command", "write-only", "no answer"],
)
def test_only_another_command_or_no_answer_contradicts_what_was_sent(answer: Answer, contradicts: bool) -> None:
    assert answer.contradicts(WORD, 0x06, 0x8F) is contradicts


def test_no_answer_means_an_interface_that_sends_nothing() -> None:
    assert untaken(0x06, None) == SENDS_NOTHING
    assert "6040h is 0000h, 0006h was sent" in untaken(0x06, 0).evidence
