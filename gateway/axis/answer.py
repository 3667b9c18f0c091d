"""Whether the drive shows something in answer to a command, or since before it.

A command and the word that answers it are under way for up to ``AxisSettings.latency_ns``. Until then, a word can be older than
the command. It is an answer earlier only if the drive has shown something else since the command.
"""

from __future__ import annotations

from collections.abc import Mapping


class Answer:
    """The answer of a drive to the newest command of one kind: a change of 6040h or 6060h, or a setpoint."""

    __slots__ = ("_latency", "changed", "given", "since")

    def __init__(self, latency_ns: int) -> None:
        self._latency = latency_ns
        self.since = -latency_ns
        """When the command was given, monotonic ns."""
        self.changed = False
        """The drive has shown something else since."""
        self.given = False
        """The last word read was an answer: it showed what the command asks for."""

    @property
    def INSTANTS(self) -> Mapping[str, int]:  # noqa: N802 (as in classes with the same ages for every axis)
        """See ``gateway.axis.checkpoint``."""
        return {"since": self._latency}

    def command(self, now: int, *, level: bool = False) -> None:
        """A new command.

        ``level``: the drive always shows its present state, such as a mode. If no other command is under way, it can be in the
        wanted one already. An event, such as the end of a motion, must come after the command.
        """
        self.changed = level and (self.given or self.due(now))
        self.since, self.given = now, False

    def read(self, shown: bool, now: int) -> bool:
        """Take what one cycle shows. True if it is ``shown``, and answers the command."""
        self.changed = self.changed or not shown
        self.given = shown and (self.changed or self.due(now))
        return self.given

    def due(self, now: int) -> bool:
        """The drive has had the time to show the answer."""
        return now - self.since >= self._latency
