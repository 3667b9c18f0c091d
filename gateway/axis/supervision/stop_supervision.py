"""Detects that a drive does not do in time what is commanded, and selects the next brake.

``power_table.Limit`` names the state that must end, or the speed that must fall along the ramp of the drive. Otherwise the drive
gets Quick Stop, then NMT stop. If the node does not confirm that, the gateway's heartbeat is withheld, so that the abort option
6007h of the drive is the last brake. Source: docs/safety.md.
"""

from __future__ import annotations

import enum
from typing import Final

from pdgw.dsp402.states import State
from pdgw.gateway.axis.power_states import Limit

RAMP_MARGIN: Final = 2
"""Factor on the stop time of the drive."""
QUICK_STOPS: Final = (Limit.ENTER, Limit.LEAVE)
"""Limits with Quick Stop as their brake: it was not commanded yet."""
_BRAKES: Final = (Limit.BRAKE, Limit.STOP)
"""The speed must fall."""
_MUST_END: Final = {
    Limit.STOP: (State.OPERATION_ENABLED,),
    Limit.OFF: (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE),
}
"""States that must end in time."""
_SLOWER: Final = 0.95
"""A shaft that coasts loses this share of its speed in the time of a stop."""


def _longest_stop(reaction_ns: int, stop_time_ns: int) -> int:
    """Time in which a drive has stopped from 100 % speed, with margin."""
    return reaction_ns + RAMP_MARGIN * stop_time_ns


class Brake(enum.IntEnum):
    """Stops beside the Controlword."""

    NONE = 0
    NMT_STOP = 1
    WITHHOLD_HEARTBEAT = 2


class StopWatch:
    """One axis. Call ``step`` in each cycle with a limit, and ``coast`` after it while the drive shows power off."""

    def __init__(self, reaction_ns: int, stop_time_ns: int) -> None:
        self._reaction = reaction_ns
        self._stop_time = stop_time_ns
        self._stopped_within = _longest_stop(reaction_ns, stop_time_ns)
        self.set_drive(0)
        self.brake: Brake = Brake.NONE
        self.began = -1
        """When the stop was commanded first, or the speed of a drive without power fell last; -1 while no stop is watched."""
        self._speed = 0
        """The speed from which the drive brakes."""
        self._ignored: State | None = None
        self._ignored_since = -1
        """Since when the drive shows this state, which must end; -1 while it does not."""
        self._braked = 0
        """When the NMT stop was sent; -1: the node has reported NMT Stopped. The next bring-up ends this state."""
        self._nmt_tried = False
        """An NMT stop was of no use: the drive was not off when it was there again."""

    def set_drive(self, reference: int) -> None:
        """Set 100 % speed in the drive's units."""
        self.reference = reference

    def over(self) -> None:
        """The drive is off, or follows the PLC again."""
        self._restart()
        self._nmt_tried = False

    def _restart(self) -> None:
        self.began = self._ignored_since = -1
        self.brake = Brake.NONE

    def step(
        self, limit: Limit, state: State | None, seen: bool, node_stopped: bool, velocity: int, window: int, now: int
    ) -> bool:
        """One cycle of a state with a limit; True if the drive does not keep it.

        ``state``: what the drive shows. ``seen``: its values are fresh. ``node_stopped``: its heartbeat reports Stopped.
        ``velocity``: actual speed, standstill within ``window``. ``now``: monotonic nanoseconds.
        """
        if self.brake is Brake.NMT_STOP:
            if node_stopped:
                self._braked = -1
            elif self._braked >= 0:
                if now - self._braked >= self._reaction:
                    self.brake = Brake.WITHHOLD_HEARTBEAT
            elif seen:
                self._restart()
                self._nmt_tried = True
        if self.brake is not Brake.NONE or not seen:
            return False
        speed = abs(velocity)
        if self.began < 0:
            self.began = now
            self._speed = speed
        elif now - self.began <= self._reaction:
            self._speed = max(self._speed, speed)  # the drive may still accelerate to an earlier setpoint
        disobeys = limit in _BRAKES and speed > max(window, self._allowed(now))
        if state not in _MUST_END.get(limit, ()):
            self._ignored_since = -1
        elif self._ignored_since < 0 or state is not self._ignored:
            self._ignored, self._ignored_since = state, now
        elif now - self._ignored_since > self._reaction:
            disobeys = True
        if disobeys:
            self.brake = Brake.WITHHOLD_HEARTBEAT if self._nmt_tried else Brake.NMT_STOP
            self._braked = now
        return disobeys

    def coast(self, velocity: int, window: int, now: int) -> bool:
        """One cycle after a stop, with a drive that shows power off. True, once, if it turns and does not become slower."""
        self.brake = Brake.NONE
        self._nmt_tried = False
        speed = abs(velocity)
        if speed <= window:
            self.over()
        elif speed < _SLOWER * self._speed:
            self._speed, self.began = speed, now
        elif now - self.began > self._stopped_within:
            self.over()
            return True
        return False

    def _allowed(self, now: int) -> int:
        """The speed a drive on its ramp is below by now, with margin."""
        braking = now - self.began - self._reaction
        if braking <= 0:
            return self._speed
        return self._speed - self.reference * braking // (RAMP_MARGIN * self._stop_time)


class OperationWatch:
    """One axis: whether Operation Enabled is entered and left in time, else the drive gets Quick Stop."""

    def __init__(self, enter_ns: int, reaction_ns: int, stop_time_ns: int) -> None:
        self._enter = enter_ns
        self._leave = _longest_stop(reaction_ns, stop_time_ns)
        self.limit: Limit = Limit.NONE
        """The limit in force."""
        self._since = 0
        """When the limit began, monotonic ns."""

    def step(self, limit: Limit, now: int) -> bool:
        """One cycle; True if the drive does not keep the limit."""
        if limit is not self.limit:
            self.limit = limit
            self._since = now if limit in QUICK_STOPS else 0
        if limit is Limit.ENTER:
            return now - self._since > self._enter
        return limit is Limit.LEAVE and now - self._since > self._leave


class HaltWatch:
    """One axis: whether the speed falls while Halt (CW.8) is commanded in operation, else the drive gets Quick Stop.

    The deceleration may be the PLC's and slow, and a jerk limit may let the speed rise at first: the speed must only fall at all.
    """

    def __init__(self, reaction_ns: int, stop_time_ns: int, shortest_ns: int) -> None:
        self._time = max(_longest_stop(reaction_ns, stop_time_ns), shortest_ns)
        """``shortest_ns``: in less time, noise may hide a slow ramp."""
        self.began = self._since = -1
        """When Halt was commanded and when the speed fell last, monotonic ns; -1 while nothing must stop."""
        self._speed = 0
        """The speed that it must fall below."""

    def step(self, halts: bool, velocity: int, window: int, now: int) -> bool:
        """One cycle; True if the drive ignores Halt."""
        speed = abs(velocity)
        if not halts or speed <= window:
            self.began, self._since, self._speed = -1, -1, 0
            return False
        if self.began < 0:
            self.began = now
        if now - self.began <= self._time:
            self._speed, self._since = max(speed, self._speed), now
        elif speed < self._speed:
            self._speed, self._since = speed, now
        return now - self._since > self._time
