"""Whether the drive shows something in answer to a command, or since before it.

A command and the word that answers it are under way for up to ``AxisSettings.latency_ns``. Until then, a word can be older than
the command. It is an answer earlier only if the drive has shown something else since the command.
"""

from __future__ import annotations

from collections.abc import Mapping


class Answer:
    """The answer of a drive to the newest command of one kind: a change of 6040h or 6060h, or a setpoint."""

    __slots__ = ("_latency", "_other", "given", "since")

    def __init__(self, latency_ns: int) -> None:
        self._latency = latency_ns
        self.since = -latency_ns
        """When the command was given, monotonic ns."""
        self._other = False
        """The drive has shown something else since."""
        self.given = False
        """The last word read was an answer: it showed what the command asks for."""

    @property
    def INSTANTS(self) -> Mapping[str, int]:  # noqa: N802 (as in classes with the same ages for every axis)
        """See ``gateway.axis.checkpoint``."""
        return {"since": self._latency}

    def command(self, now: int) -> None:
        """A new command: what is shown now answers an older one."""
        self.since, self._other, self.given = now, False, False

    def read(self, shown: bool, now: int) -> bool:
        """Take what one cycle shows. True if it is ``shown``, and answers the command."""
        self._other |= not shown
        self.given = shown and (self._other or self.due(now))
        return self.given

    def due(self, now: int) -> bool:
        """The drive has had the time to show the answer."""
        return now - self.since >= self._latency
