"""Whether the drive shows something in answer to a command, or since before it."""

from __future__ import annotations

import enum
from typing import Final


class _Shown(enum.Enum):
    """What the drive has shown since the newest command."""

    NOTHING = "nothing that counts"
    OTHER = "something else, or the present: what the command asks for is the answer as soon as it is shown"
    ANSWER = "the answer, in the last word"


_NOTHING: Final = _Shown.NOTHING
_OTHER: Final = _Shown.OTHER
_ANSWER: Final = _Shown.ANSWER


class Answer:
    """The answer of a drive to the newest command of one kind: a change of 6040h or 6060h, or a setpoint."""

    def __init__(self, latency_ns: int) -> None:
        self._latency = latency_ns
        self._since = 0
        """When the command was given, monotonic ns; 0: it is answered, or long ago."""
        self._shown = _NOTHING

    @property
    def given(self) -> bool:
        """The last word read was an answer: it showed what the command asks for."""
        return self._shown is _ANSWER

    def command(self, now: int, *, level: bool = False) -> None:
        """A new command.

        ``level``: the drive always shows its present state, such as a mode. If no other command is under way, it can be in the
        requested one already. An event, such as the end of a motion, must come after the command.
        """
        self._shown = _OTHER if level and self.due(now) else _NOTHING
        self._since = now

    def read(self, shown: bool, now: int) -> bool:
        """Take what one cycle shows. True if it is ``shown``, and answers the command."""
        since = self._since
        if since and now - since < self._latency and not (shown and self._shown is _OTHER):
            if not shown:
                self._shown = _OTHER
            return False
        self._since = 0
        self._shown = _ANSWER if shown else _NOTHING
        return shown

    @property
    def awaited(self) -> bool:
        """A command is in force that no ``read`` or ``withdraw`` has ended."""
        return self._since != 0

    def withdraw(self) -> None:
        """The command is not in force any more."""
        self._since, self._shown = 0, _NOTHING

    def due(self, now: int) -> bool:
        """The drive has had the time to show the answer, or has shown it."""
        return now - self._since >= self._latency or not self._since
