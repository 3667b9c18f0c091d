"""Turns: a limited number of tasks at a time, in the order of their requests."""

from __future__ import annotations

from collections import deque

from pdgw.ds301.loop.loop import Event, Loop


class Turns:
    """``with turns:`` inside a task waits until fewer than ``limit`` tasks have a turn."""

    def __init__(self, loop: Loop, limit: int) -> None:
        self.limit = limit
        self._loop = loop
        self._taken = 0
        self._waiting: deque[Event] = deque()

    def __enter__(self) -> None:
        if self._taken < self.limit:
            self._taken += 1
            return
        turn = Event(self._loop)
        self._waiting.append(turn)
        try:
            turn.wait()
        except BaseException:
            # The task is killed: its present and following work passes to the next task.
            if turn.is_set():
                self._pass_on()
            else:
                self._waiting.remove(turn)
            raise

    def __exit__(self, *_: object) -> None:
        self._pass_on()

    def _pass_on(self) -> None:
        if self._waiting:
            self._waiting.popleft().set()
        else:
            self._taken -= 1
