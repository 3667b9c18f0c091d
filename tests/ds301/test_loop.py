"""The loop: order of events, tasks that wait, and the same code on both clocks."""

from __future__ import annotations

import functools
import gc
import os
import socket
import threading
import weakref
from collections.abc import Callable, Iterator

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.loop.loop import Event, Loop, Mailbox
from pdgw.ds301.loop.readiness import Readiness, SelectReadiness, best_readiness
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.ds301.loop.virtual_loop import VirtualLoop


@pytest.fixture(params=["virtual", "system"])
def loop(request: pytest.FixtureRequest) -> Iterator[Loop]:
    if request.param == "virtual":
        yield VirtualLoop()
        return
    system = SystemLoop()
    yield system
    system.close()


def run_task(loop: Loop, function) -> None:  # type: ignore[no-untyped-def]
    """Run a task on either loop until it has ended."""

    def run() -> None:
        try:
            function()
        finally:
            loop.stop()

    task = loop.spawn(run, "test")
    loop.run()
    if task.error is not None:
        raise task.error


def test_timers_fire_in_order_of_time_and_of_their_making() -> None:
    loop = VirtualLoop()
    seen: list[tuple[str, int]] = []
    begin = loop.now()
    for name, delay in (("late", 5), ("early", 2), ("early too", 2)):
        loop.call_later(delay * MS, lambda name=name: seen.append((name, loop.now() - begin)))
    loop.call_later(3 * MS, lambda: seen.append(("never", 0))).cancel()
    loop.run()
    assert seen == [("early", 2 * MS), ("early too", 2 * MS), ("late", 5 * MS)]


def test_a_postponed_timer_fires_once_at_its_later_time(loop: Loop) -> None:
    seen: list[str] = []
    begin = loop.now()
    timer = loop.call_later(MS, lambda: seen.append("postponed"))
    timer.postpone(begin + 3 * MS)
    timer.postpone(begin + 5 * MS)
    loop.call_at(begin + 4 * MS, lambda: seen.append("between"))
    loop.call_at(begin + 5 * MS, lambda: seen.append("same time"))
    loop.call_at(begin + 6 * MS, loop.stop)
    loop.run()
    # Where it was put last is what counts among timers of the same time, as if it had been made then.
    assert seen == ["between", "same time", "postponed"]


def test_cancelled_timers_do_not_stay_until_their_time() -> None:
    loop = VirtualLoop()
    seen: list[int] = []
    for number in range(10_000):
        loop.call_later(SECOND, lambda: seen.append(-1)).cancel()
        if number % 1000 == 0:
            loop.call_later(SECOND, lambda number=number: seen.append(number))
    assert loop.waiting < 600
    loop.run()
    assert seen == list(range(0, 10_000, 1000))


def test_the_loop_does_not_wake_for_the_time_before_a_timer_was_postponed() -> None:
    waits: list[float] = []

    class Watching:
        def watch(self, descriptor: int, *, read: bool, write: bool) -> None:
            """Nothing is ever ready."""

        def close(self) -> None:
            """Nothing to release."""

        def wait(self, seconds: float) -> list[tuple[int, int]]:
            waits.append(seconds)
            loop.stop()
            return []

    loop = SystemLoop(Watching())
    loop.call_at(loop.now(), lambda: None).postpone(loop.now() + 1_000 * SECOND)
    loop.run()
    loop.close()
    assert waits[0] > 900


@pytest.mark.parametrize("delay", [300_000, MS, 2_500_000])
def test_no_timer_is_called_before_its_time_whatever_the_wait_is_made_of(delay: int) -> None:
    loop = SystemLoop()
    due = loop.now() + delay
    called: list[int] = []
    loop.call_at(due, lambda: (called.append(loop.now()), loop.stop()))
    loop.run()
    loop.close()
    assert called[0] >= due


def test_a_timer_added_by_a_timer_at_the_same_time_is_for_the_next_turn() -> None:
    loop = VirtualLoop()
    seen = []
    loop.call_at(0, lambda: (seen.append(1), loop.call_at(0, lambda: seen.append(3))))
    loop.call_at(0, lambda: seen.append(2))
    loop.run()
    assert seen == [1, 2, 3]


def test_task_waits_for_an_event_until_its_timeout(loop: Loop) -> None:
    event = Event(loop)
    seen: list[object] = []

    def wait() -> None:
        begin = loop.now()
        seen.append(event.wait(2 * MS))
        seen.append(loop.now() - begin >= 2 * MS)
        loop.call_later(MS, event.set)
        seen.append(event.wait(60 * SECOND))
        seen.append(event.wait())

    run_task(loop, wait)
    assert seen == [False, True, True, True]


def test_an_event_set_at_its_timeout_resumes_its_task_once() -> None:
    loop = VirtualLoop()
    event = Event(loop)
    seen = []

    def wait() -> None:
        loop.call_later(MS, event.set)
        seen.append(event.wait(MS))
        loop.sleep(5 * MS)
        seen.append(loop.now() - begin)

    begin = loop.now()
    loop.complete(wait)
    assert seen == [True, 6 * MS]


def test_a_mailbox_gives_its_items_to_a_task_that_waits(loop: Loop) -> None:
    box: Mailbox[int] = Mailbox(loop)
    seen: list[int] = []

    def read() -> None:
        loop.call_later(MS, lambda: box.put(7))
        seen.append(box.get())

    run_task(loop, read)
    assert seen == [7]


def test_unread_mailbox_keeps_a_bounded_number_of_items() -> None:
    box: Mailbox[int] = Mailbox(VirtualLoop(), limit=3)
    for item in range(1000):
        box.put(item)
    assert [box.get(), box.get(), box.get()] == [997, 998, 999]


def test_a_killed_task_ends_where_it_waits_and_runs_its_clean_up() -> None:
    loop = VirtualLoop()
    seen = []

    def work() -> None:
        try:
            loop.sleep(60 * SECOND)
            seen.append("never")
        finally:
            seen.append("cleaned up")

    task = loop.spawn(work, "work")
    loop.run_for(MS)
    task.kill()
    loop.run_for(MS)
    assert seen == ["cleaned up"]
    assert task.done.is_set()
    task.kill()
    loop.run_for(MS)


def test_closed_loop_has_no_tasks_and_releases_their_objects() -> None:
    class Known:
        """What a task knows."""

    loop = VirtualLoop()
    known = Known()
    gone = weakref.ref(known)

    def wait(held: Known) -> None:
        try:
            Event(loop).wait()
        finally:
            del held

    loop.spawn(functools.partial(wait, known), "waits for ever")
    loop.spawn(lambda: loop.sleep(60 * SECOND), "sleeps")
    loop.run_for(MS)
    del known
    loop.close()
    assert not loop.tasks
    del wait
    loop = VirtualLoop()
    gc.collect()
    assert gone() is None


def test_a_task_killed_before_its_first_slice_does_nothing() -> None:
    loop = VirtualLoop()
    seen = []
    loop.spawn(lambda: seen.append("never"), "work").kill()
    loop.run_for(MS)
    assert not seen


def test_error_of_a_task_is_logged_and_ends_no_other_task(caplog: pytest.LogCaptureFixture) -> None:
    loop = VirtualLoop()
    seen = []

    def fail() -> None:
        raise ValueError("a mistake")

    task = loop.spawn(fail, "faulty")
    loop.spawn(lambda: seen.append("alive"), "other")
    loop.run_for(MS)
    assert isinstance(task.error, ValueError)
    assert loop.task_errors == 1
    assert "faulty" in caplog.text
    assert seen == ["alive"]


def test_work_outside_the_loop_ends_on_it_with_result_or_error(loop: Loop) -> None:
    seen: list[object] = []

    def work() -> None:
        seen.append(loop.result(loop.offload(lambda: 42)))
        with pytest.raises(OSError, match="disk"):
            loop.result(loop.offload(lambda: (_ for _ in ()).throw(OSError("disk"))))
        from concurrent.futures import Future  # noqa: PLC0415

        never: Future[None] = Future()
        with pytest.raises(TimeoutError):
            loop.result(never, MS)

    run_task(loop, work)
    assert seen == [42]


def test_only_a_task_can_wait() -> None:
    loop = VirtualLoop()
    with pytest.raises(RuntimeError, match="task"):
        loop.sleep(1)


def test_until_names_the_missing_event() -> None:
    loop = VirtualLoop()
    with pytest.raises(TimeoutError, match="the drive moves"):
        loop.until(lambda: False, "the drive moves", 10 * MS)


def test_other_threads_wake_a_loop_that_waits() -> None:
    loop = SystemLoop()
    thread = threading.Thread(target=lambda: loop.call_threadsafe(loop.stop))
    loop.call_later(0, thread.start)
    loop.run()
    thread.join()
    loop.close()


@pytest.mark.parametrize("readiness", [SelectReadiness, best_readiness])
def test_urgent_descriptors_come_first_and_slices_last(readiness: Callable[[], Readiness]) -> None:
    loop = SystemLoop(readiness())
    seen = []
    pipes = [os.pipe() for _ in range(2)]

    def reader(name: str, descriptor: int):  # type: ignore[no-untyped-def]
        def read() -> None:
            os.read(descriptor, 1)
            seen.append(name)

        return read

    loop.add_reader(pipes[0][0], reader("can", pipes[0][0]))
    loop.add_reader(pipes[1][0], reader("plc", pipes[1][0]), urgent=True)
    loop.add_slice(lambda: (seen.append("slice"), loop.stop()))
    for _, writing in pipes:
        os.write(writing, b"x")
    loop.run()
    loop.close()
    for pair in pipes:
        for descriptor in pair:
            os.close(descriptor)
    assert seen == ["plc", "can", "slice"]


@pytest.mark.parametrize("readiness", [SelectReadiness, best_readiness])
def test_readers_and_writers_of_one_descriptor_are_added_and_removed(readiness: Callable[[], Readiness]) -> None:
    loop = SystemLoop(readiness())
    ours, theirs = socket.socketpair()
    seen: list[str] = []

    def read() -> None:
        seen.append(ours.recv(8).decode())
        loop.remove_reader(ours.fileno())
        loop.call_later(0, loop.stop)

    def write() -> None:
        seen.append("writable")
        loop.remove_writer(ours.fileno())
        theirs.send(b"answer")

    loop.add_reader(ours.fileno(), read)
    loop.add_writer(ours.fileno(), write)
    loop.run()
    assert seen == ["writable", "answer"]
    theirs.send(b"more")
    loop.call_later(0, loop.stop)
    loop.run()
    assert len(seen) == 2, "nobody watches any more"
    loop.remove_reader(ours.fileno())  # a second removal raises no error
    loop.close()
    ours.close()
    theirs.close()


@pytest.mark.parametrize("readiness", [SelectReadiness, best_readiness])
def test_closed_descriptor_can_still_be_removed(readiness: Callable[[], Readiness]) -> None:
    loop = SystemLoop(readiness())
    ours, theirs = socket.socketpair()
    descriptor = ours.fileno()
    loop.add_reader(descriptor, loop.stop)
    ours.close()
    loop.remove_reader(descriptor)
    loop.call_later(0, loop.stop)
    loop.run()
    loop.close()
    theirs.close()


def test_one_slice_follows_a_cycle_and_the_next_waits_for_the_gap() -> None:
    loop = SystemLoop()
    seen = []
    far = loop.now() + 3600 * SECOND

    def cycle() -> None:
        loop.pace(1)  # the next frame is expected at once: there is no gap
        seen.append("cycle")
        if seen.count("cycle") < 3:
            loop.call_later(0, cycle)
        else:
            loop.pace(far)
            loop.add_slice(loop.stop)

    for name in ("a", "b", "c", "d"):
        loop.add_slice(lambda name=name: seen.append(name))
    loop.call_later(0, cycle)
    loop.run()
    loop.close()
    assert seen == ["cycle", "a", "cycle", "b", "cycle", "c", "d"]
