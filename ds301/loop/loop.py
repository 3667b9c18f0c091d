"""One loop, any clock: readiness, timers and tasks of one thread.

Everything of the gateway runs on one ``Loop``: cyclic exchange, CAN reception, SDO work, parameter requests. A ``SystemLoop``
has the machine's clock and file descriptors, a ``VirtualLoop`` a clock of its own that jumps to the next
timer, so that the same code simulates a day in minutes and the same run twice. Times are monotonic nanoseconds.

A ``Task`` is a greenlet: straight code that waits for events. Priority is explicit: file descriptors in the order of their
priority, then due timers, then one slice of one task; see ``Loop.pace``.
"""

from __future__ import annotations

import abc
import heapq
import logging
import traceback
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Final, Generic, TypeVar

import greenlet

from pdgw.ds301.counters import Counters

log = logging.getLogger("gateway")

T = TypeVar("T")
_CLEAN_UP: Final = 512
"""Number of new timers after which the cancelled ones are removed."""


class TaskKilled(BaseException):
    """Raised inside a task that is ended from outside, where it waits."""


class Timer:
    """A call at a time; ``cancel`` takes it back, ``postpone`` moves it."""

    def __init__(self, when: int, action: Callable[[], None]) -> None:
        self.when = when
        self.action: Callable[[], None] | None = action

    def postpone(self, when: int) -> None:
        """Delay the call to a later time, without waking the loop at the earlier one."""
        self.when = when

    def cancel(self) -> None:
        """Cancel the call; cancelling twice or afterwards is allowed."""
        self.action = None


class Task:
    """Straight code on a loop, made by ``Loop.spawn``. ``error`` is the exception it ended with, None for a normal end."""

    def __init__(self, loop: Loop, function: Callable[[], None], name: str) -> None:
        self.name = name
        self.done = Event(loop)
        self.error: BaseException | None = None
        self._loop = loop
        self._kill = False
        self._parked = True
        self._greenlet = greenlet.greenlet(lambda: self._run(function))

    def kill(self) -> None:
        """End the task at its wait; a task that has ended or not begun is allowed."""
        if not self.done.is_set():
            self._kill = True
            self.resume()

    def resume(self) -> None:
        """Continue the task in a later slice; only one that waits, and only once."""
        if self._parked:
            self._parked = False
            self._loop.add_slice(self._resume)

    def park(self) -> None:
        """Wait, inside the task, until it is resumed."""
        self._parked = True
        self._loop.hub.switch()
        if self._kill:
            raise TaskKilled(self.name)

    def _resume(self) -> None:
        loop = self._loop
        loop.hub = greenlet.getcurrent()
        self._greenlet.parent = loop.hub
        loop.running = self
        try:
            self._greenlet.switch()
        finally:
            loop.running = None

    def _run(self, function: Callable[[], None]) -> None:
        try:
            if not self._kill:
                function()
        except TaskKilled:
            pass
        except Exception as error:
            # An error in one task must not end the exchange of all. It is logged, and a caller that waits for the task gets
            # it.
            self.error = error
            self._loop.unexpected(f"task {self.name} ended", error)
        finally:
            self._loop.tasks.discard(self)
            self.done.set()


class Loop(abc.ABC):
    """Common part of both clocks. All methods but ``call_threadsafe`` belong to the loop's own thread."""

    def __init__(self) -> None:
        self.hub = greenlet.getcurrent()
        self.running: Task | None = None
        self.tasks: set[Task] = set()
        """Those that have not ended."""
        self.counters = Counters()
        """Counters of everything that runs on the loop."""
        self.task_errors = 0
        self._logged: set[tuple[str, type[Exception], str]] = set()
        """Unexpected errors: what they ended, their kind and the place they came from."""
        self.counters.add(
            "loop",
            "task_errors",
            "errors",
            "an unexpected error of a task or of one request, see the log",
            lambda: self.task_errors,
        )
        self._timers: list[tuple[int, int, Timer]] = []
        self._number = self._added = 0
        self._slices: deque[Callable[[], None]] = deque()
        self._slice_due = True
        self.expected = 0
        """When the cyclic exchange expects its next cycle; 0: nothing is expected."""
        self._stopping = False

    @abc.abstractmethod
    def now(self) -> int:
        """Monotonic nanoseconds."""

    @abc.abstractmethod
    def wall(self) -> float:
        """Seconds since 1970, for logs and recordings."""

    @abc.abstractmethod
    def run(self) -> None:
        """Until ``stop``. An exception of a timer or reader ends the run and is raised here."""

    @abc.abstractmethod
    def run_for(self, duration: int) -> None:
        """Run for this number of nanoseconds, unless ``stop`` ends it before."""

    @abc.abstractmethod
    def call_threadsafe(self, action: Callable[[], None]) -> None:
        """Call soon on the loop's thread; from any thread, and from a signal handler."""

    @abc.abstractmethod
    def offload(self, function: Callable[[], T]) -> Future[T]:
        """Run what may block (the disk) outside the loop, one after the other; the future is completed on the loop."""

    @abc.abstractmethod
    def add_reader(self, descriptor: int, action: Callable[[], None], *, urgent: bool = False) -> None:
        """Call ``action`` whenever the descriptor can be read; urgent ones first."""

    @abc.abstractmethod
    def remove_reader(self, descriptor: int) -> None:
        """End the watch; one that is not watched is allowed."""

    @abc.abstractmethod
    def add_writer(self, descriptor: int, action: Callable[[], None]) -> None:
        """Call ``action`` whenever the descriptor can be written."""

    @abc.abstractmethod
    def remove_writer(self, descriptor: int) -> None:
        """End the watch; one that is not watched is allowed."""

    @abc.abstractmethod
    def close(self) -> None:
        """End the tasks, wait for offloaded work, and release the loop's own resources."""

    def stop(self) -> None:
        """End ``run`` after the present turn."""
        self._stopping = True

    def call_at(self, when: int, action: Callable[[], None]) -> Timer:
        """Call at a time; one that is past is called in the next turn. Timers of the same time keep their order."""
        timer = Timer(when, action)
        self._add(timer)
        return timer

    def _add(self, timer: Timer) -> None:
        timers = self._timers
        self._number += 1
        self._added += 1
        if not self._added % _CLEAN_UP:
            timers[:] = [item for item in timers if item[2].action is not None]
            heapq.heapify(timers)
        heapq.heappush(timers, (timer.when, self._number, timer))

    def call_later(self, delay: int, action: Callable[[], None]) -> Timer:
        """Call after this number of nanoseconds."""
        return self.call_at(self.now() + delay, action)

    def spawn(self, function: Callable[[], None], name: str) -> Task:
        """Begin a task in a later slice."""
        task = Task(self, function, name)
        self.tasks.add(task)
        task.resume()
        return task

    def unexpected(self, what: str, error: Exception) -> None:
        """An internal error ended ``what``, and nothing else: counted, and logged with its traceback the first time, so that a
        repeated request does not fill the log."""
        self.task_errors += 1
        place = (what, type(error), str(traceback.extract_tb(error.__traceback__, -1)))
        if place not in self._logged:
            self._logged.add(place)
            log.error(
                "%s caused by an unexpected error; repetitions are only counted from now on", what, exc_info=error
            )

    def end_tasks(self) -> None:
        """End every task at its wait: a task that waits permanently keeps all its objects, and the collector cannot free them."""
        for task in tuple(self.tasks):
            task.kill()
        while self._slices:
            self._slices.popleft()()

    def add_slice(self, action: Callable[[], None]) -> None:
        """Something that can wait for a gap in the exchange; in the order they were added."""
        self._slices.append(action)

    def pace(self, expected: int) -> None:
        """The cyclic exchange has finished its part of a cycle and expects the next at ``expected``.

        One slice may follow at once, others while they end before that time. The caller must repeat it, or end it with 0:
        nothing is expected.
        """
        self.expected = expected
        self._slice_due = True

    def current(self) -> Task:
        """The task that is running; RuntimeError outside of one."""
        if self.running is None:
            raise RuntimeError("only a task of the loop can wait")
        return self.running

    def sleep(self, delay: int) -> None:
        """Wait this number of nanoseconds inside a task."""
        task = self.current()
        timer = self.call_later(delay, task.resume)
        try:
            task.park()
        finally:
            timer.cancel()

    def result(self, future: Future[T], timeout: int | None = None) -> T:
        """Wait inside a task for a future that this loop completes; TimeoutError after ``timeout`` nanoseconds."""
        if not future.done():
            answered = Event(self)
            future.add_done_callback(lambda _: answered.set())
            if not answered.wait(timeout):
                raise TimeoutError
        return future.result(0)

    def _next(self) -> int | None:
        """When the next timer is due."""
        timers = self._timers
        while timers:
            when, _, timer = timers[0]
            if timer.action is None:
                heapq.heappop(timers)
            elif timer.when > when:
                self._number += 1
                heapq.heapreplace(timers, (timer.when, self._number, timer))
            else:
                return when
        return None

    def _fire(self, now: int) -> None:
        """Call the timers that were due when this turn began: what they add is for the next one."""
        timers = self._timers
        last = self._number
        while timers and timers[0][0] <= now and timers[0][1] <= last:
            timer = heapq.heappop(timers)[2]
            if timer.when > now:
                self._add(timer)
                continue
            action, timer.action = timer.action, None
            if action is not None:
                action()


class Event:
    """An event that tasks wait for. Any code on the loop's thread may call ``set`` and ``clear``."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._set = False
        self._waiting: list[Task] = []

    def is_set(self) -> bool:
        return self._set

    @property
    def awaited(self) -> bool:
        """A task waits for it."""
        return bool(self._waiting)

    def set(self) -> None:
        self._set = True
        for task in self._waiting:
            task.resume()

    def clear(self) -> None:
        self._set = False

    def wait(self, timeout: int | None = None) -> bool:
        """Wait until it is set (True) or this number of nanoseconds is over, inside a task."""
        if self._set:
            return True
        task = self._loop.current()
        self._waiting.append(task)
        timer = None if timeout is None else self._loop.call_later(timeout, task.resume)
        try:
            task.park()
        finally:
            self._waiting.remove(task)
            if timer is not None:
                timer.cancel()
        return self._set


class Mailbox(Generic[T]):
    """A queue between the loop and a task."""

    def __init__(self, loop: Loop, limit: int = 64) -> None:
        self._items: deque[T] = deque(maxlen=limit)
        """Limit the memory for unread items; the oldest are discarded."""
        self._filled = Event(loop)

    def put(self, item: T) -> bool:
        """Add an item; True when the oldest had to go for it."""
        full = len(self._items) == self._items.maxlen
        self._items.append(item)
        self._filled.set()
        return full

    def get(self) -> T:
        """The oldest item; waits for one, inside a task."""
        if not self._items:
            self._filled.clear()
            self._filled.wait()
        return self._items.popleft()
