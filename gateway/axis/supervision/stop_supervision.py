"""Detects that a drive does not stop, and selects the next brake.

After a stop command, the Statusword must leave Operation Enabled, or the speed must fall along the ramp of the drive, within a
time that follows from the latencies. Otherwise the node is stopped by NMT. If it does not confirm that, the gateway's heartbeat
is withheld, so that the abort option 6007h of the drive is the last brake. Source: docs/safety.md.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from typing import ClassVar, Final

from pdgw.gateway.axis.power_table import Action

RAMP_MARGIN: Final = 2
"""Factor on the stop time of the drive."""
_HOLDS_POWER: Final = (Action.RAMP, Action.QUICK_STOP)
"""Commands during which the drive brakes with power on."""


class Brake(enum.IntEnum):
    """Stops beside the Controlword."""

    NONE = 0
    NMT_STOP = 1
    WITHHOLD_HEARTBEAT = 2


class StopWatch:
    """One axis. Call ``step`` in each cycle in which the drive does not follow the PLC and may have power."""

    __slots__ = (
        "_began",
        "_braked",
        "_ignored_since",
        "_nmt_stopped",
        "_nmt_tried",
        "_reaction",
        "_speed",
        "_stop_time",
        "brake",
        "reference",
        "runs",
    )

    SUPERVISION: ClassVar[frozenset[str]] = frozenset({"*"})

    def __init__(self, reaction_ns: int, stop_time_ns: int) -> None:
        self._reaction = reaction_ns
        self._stop_time = stop_time_ns
        self.reference = 0
        """100 % speed in the drive's units."""
        self.brake: Brake = Brake.NONE
        self.runs = False
        """A stop is being watched."""
        self._began = 0
        """When the stop was commanded first."""
        self._speed = 0
        """The speed from which the drive brakes."""
        self._ignored_since = -1
        """Since when the drive shows operation although power off, or the quick stop, is commanded; -1 while it does not."""
        self._braked = 0
        self._nmt_stopped = False
        """The node has reported NMT Stopped. The next bring-up ends this state."""
        self._nmt_tried = False
        """That was of no use: the drive was not off when it was there again."""

    @property
    def INSTANTS(self) -> Mapping[str, int]:  # noqa: N802 (as in classes with the same ages for every axis)
        """See ``gateway.axis.checkpoint``."""
        stopped = self._reaction + RAMP_MARGIN * self._stop_time
        return {"_began": stopped, "_ignored_since": self._reaction + 1, "_braked": self._reaction}

    def over(self) -> None:
        """The drive is off, or follows the PLC again."""
        self._restart()
        self._nmt_tried = False

    def _restart(self) -> None:
        self.runs = False
        self._ignored_since = -1
        self.brake = Brake.NONE

    def step(
        self, action: Action, operating: bool, seen: bool, node_stopped: bool, velocity: int, window: int, now: int
    ) -> bool:
        """One cycle of a stop; True if the drive does not follow it.

        ``operating``: it shows Operation Enabled. ``seen``: its values are fresh. ``node_stopped``: its heartbeat reports
        Stopped. ``velocity``: actual speed, standstill within ``window``. ``now``: monotonic nanoseconds.
        """
        if self.brake is Brake.NMT_STOP:
            if node_stopped:
                self._nmt_stopped = True
            elif not self._nmt_stopped:
                if now - self._braked >= self._reaction:
                    self.brake = Brake.WITHHOLD_HEARTBEAT
            elif seen:
                self._restart()
                self._nmt_tried = True
        if self.brake is not Brake.NONE or not seen:
            return False
        speed = abs(velocity)
        if not self.runs:
            self.runs = True
            self._began = now
            self._speed = speed
        elif now - self._began <= self._reaction:
            self._speed = max(self._speed, speed)  # the drive may still accelerate to an earlier setpoint
        disobeys = action in _HOLDS_POWER and speed > max(window, self._allowed(now))
        if not operating or action is Action.RAMP:
            self._ignored_since = -1
        elif self._ignored_since < 0:
            self._ignored_since = now
        elif now - self._ignored_since > self._reaction:
            disobeys = True
        if disobeys:
            self.brake = Brake.WITHHOLD_HEARTBEAT if self._nmt_tried else Brake.NMT_STOP
            self._braked = now
            self._nmt_stopped = False
        return disobeys

    def _allowed(self, now: int) -> int:
        """The speed a drive on its ramp is below by now, with margin."""
        braking = now - self._began - self._reaction
        if braking <= 0:
            return self._speed
        return self._speed - self.reference * braking // (RAMP_MARGIN * self._stop_time)
