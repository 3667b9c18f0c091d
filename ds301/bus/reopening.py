"""Open a CAN interface again that was lost, with a growing pause between two tries."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.port import CanPort, Opener
from pdgw.ds301.loop.loop import Loop, Timer

_log = logging.getLogger("gateway")

_FIRST_PAUSE_NS: Final = 100 * MS
_LONGEST_PAUSE_NS: Final = 2_000 * MS
"""Between two tries."""
_WORKING_NS: Final = 50 * MS
"""An interface that is down can be opened and is lost in the next turn: minimum time for a successful opening."""


class Reopening:
    """Of one interface. ``take`` is called with each new port."""

    def __init__(self, loop: Loop, name: str, opener: Opener, take: Callable[[CanPort], None]) -> None:
        self._loop = loop
        self._name = name
        self.log_fields = {"event": "bus", "bus": name}
        """Of each message about the bus, for who collects the log."""
        self._opener = opener
        self._take = take
        self._pause = _FIRST_PAUSE_NS
        self._timer: Timer | None = None
        """Time of the next try, or of the confirmation of the last one."""
        self._working = True

    def lost(self, text: str) -> bool:
        """Log that the interface is lost. False if it was lost again before it has worked."""
        worked, self._working = self._working, False
        if worked:
            text = f"interface lost ({text}); the gateway opens it again when it is back"
            _log.error("CAN bus %s: %s", self._name, text, extra=self.log_fields)
        else:
            _log.debug("CAN bus %s: %s", self._name, text)
        return worked

    def begin(self) -> None:
        """Try after the next pause."""
        self.cancel()
        self._timer = self._loop.call_later(self._pause, self._try)
        self._pause = min(2 * self._pause, _LONGEST_PAUSE_NS)

    def cancel(self) -> None:
        """Do not try any more."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _try(self) -> None:
        try:
            port = self._opener()
        except CanopenError as error:
            _log.debug("CAN bus %s: %s", self._name, error)
            self.begin()
            return
        self._timer = self._loop.call_later(_WORKING_NS, self._is_back)
        self._take(port)

    def _is_back(self) -> None:
        self._working = True
        self._pause = _FIRST_PAUSE_NS
        _log.info("CAN bus %s: interface opened again", self._name, extra=self.log_fields)
