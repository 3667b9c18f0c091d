"""The age of a value that is read by SDO: from its request, by polls and by the slowest answer."""

from __future__ import annotations

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.node.polling import OLDEST_NS, Polling
from pdgw.ds301.objects import CanType, Entry

SPEED = Entry(0x606C, 0, "Velocity Actual Value", CanType.I32, attribute="velocity_actual")
TORQUE = Entry(0x6077, 0, "Torque Actual Value", CanType.I16, attribute="current_actual")


def _polling(*entries: Entry) -> Polling:
    polling = Polling()
    polling.begin(entries, 0)
    return polling


def _read(polling: Polling, asked: int, answered: int) -> int:
    """Read the next object; when its value becomes old."""
    item = polling.next(asked)
    polling.answered(item, asked, answered)
    return item.until_ns


def test_a_value_is_as_old_as_its_request_and_old_after_three_polls() -> None:
    polling = _polling(SPEED)
    assert _read(polling, SECOND, SECOND + 5 * MS) == SECOND + 300 * MS
    speed = polling.find("velocity_actual")
    assert speed is not None
    assert speed.asked_ns == SECOND
    assert polling.due == SECOND + 100 * MS


def test_slow_answers_make_longer_polls_up_to_a_second() -> None:
    polling = _polling(SPEED)
    assert _read(polling, SECOND, SECOND + 150 * MS) == SECOND + 450 * MS
    assert _read(polling, 2 * SECOND, 2 * SECOND + 400 * MS) == 2 * SECOND + OLDEST_NS


def test_the_slowest_answer_counts_for_a_minute() -> None:
    polling = _polling(SPEED)
    _read(polling, SECOND, SECOND + 200 * MS)
    _read(polling, 2 * SECOND, 2 * SECOND + 150 * MS)
    assert _read(polling, 61 * SECOND, 61 * SECOND + 1) == 61 * SECOND + 600 * MS
    assert _read(polling, 62 * SECOND, 62 * SECOND + 1) == 62 * SECOND + 450 * MS
    assert _read(polling, 63 * SECOND, 63 * SECOND + 1) == 63 * SECOND + 300 * MS


def test_objects_take_turns_and_one_that_fails_does_not_keep_the_others_from_being_read() -> None:
    polling = _polling(SPEED, TORQUE)
    failed = polling.next(SECOND)
    failed.miss(SECOND)
    other = polling.next(SECOND + 500 * MS)
    assert {failed.entry, other.entry} == {SPEED, TORQUE}
    assert polling.next(SECOND + 600 * MS) is failed


def test_an_answer_after_a_lost_one_may_be_that_to_the_lost_request() -> None:
    """Both are for the same object: no frame shows which request it answers."""
    polling = _polling(SPEED)
    item = polling.next(SECOND)
    item.miss(SECOND)
    assert _read(polling, SECOND + 500 * MS, SECOND + 550 * MS) == SECOND + 300 * MS
    assert _read(polling, SECOND + 600 * MS, SECOND + 605 * MS) == SECOND + 800 * MS
    assert _read(polling, 4 * SECOND, 4 * SECOND + 1) == 4 * SECOND + 300 * MS


def test_an_object_that_fails_three_times_or_is_not_read_for_long_is_reported() -> None:
    polling = _polling(SPEED, TORQUE)
    polling.resume(SECOND)
    assert polling.unread(3, SECOND, 2 * SECOND) == ""
    assert polling.unread(3, SECOND, 2 * SECOND + 1) == "objects without PDO were not read for 1000 ms"
    for _ in range(3):
        polling.next(SECOND)
    assert polling.unread(3, SECOND, SECOND) == "objects without PDO could not be read 3 times"
