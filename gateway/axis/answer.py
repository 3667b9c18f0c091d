"""Whether the drive shows something in answer to a command, or since before it.

A command and the word that answers it are under way for up to ``AxisSettings.latency_ns``. Until then, a word can be older than
the command. It is an answer earlier only if the drive has shown something else since the command.
"""

from __future__ import annotations


class Answer:
    """The answer of a drive to the newest command of one kind: a change of 6040h or 6060h, or a setpoint."""

    def __init__(self, latency_ns: int) -> None:
        self._latency = latency_ns
        self._since = 0
        """When the command was given, monotonic ns; 0: it is answered, or long ago."""
        self._changed = False
        """The drive has shown something else since, or shows the present."""
        self.given = False
        """The last word read was an answer: it showed what the command asks for."""

    def command(self, now: int, *, level: bool = False) -> None:
        """A new command.

        ``level``: the drive always shows its present state, such as a mode. If no other command is under way, it can be in the
        requested one already. An event, such as the end of a motion, must come after the command.
        """
        self._changed = level and (self.given or self.due(now))
        self._since, self.given = now, False

    def read(self, shown: bool, now: int) -> bool:
        """Take what one cycle shows. True if it is ``shown``, and answers the command."""
        if not shown:
            self._changed = True
        if (shown and self._changed) or self.due(now):
            self._since, self._changed, self.given = 0, False, shown
        return self.given

    def withdraw(self) -> None:
        """The command is not in force any more."""
        self._since, self._changed, self.given = 0, False, False

    def due(self, now: int) -> bool:
        """The drive has had the time to show the answer, or has shown it."""
        return now - self._since >= self._latency or not self._since
