"""What must hold for one axis, seen from the drive, the wires and what the PLC really sent; not from the gateway.

* No start without an OFF that was sent after the last doubt.
* Standstill or power off within a bound after the PLC, or the way to the drive, is lost; a drive that coasts takes its time.
* No task more often than the PLC gave one.
* ZSW1 says operation or fault only of a drive that is in it, once nothing changes any more.
"""

from __future__ import annotations

from pdgw.dsp402.states import State
from pdgw.durations import MS
from pdgw.gateway.axis.telegrams import POSITIONER_TELEGRAM_NUMBERS
from pdgw.gateway.axis.watch import POWERED
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.world import Member
from pdgw.tools.soak.words import OFF_BIT, Words

STOP_BOUND_NS = 1000 * MS
"""The drive's own watch over the gateway (300 ms), a quick stop from full speed (300 ms), and the cycles until it is known."""
SETTLED_NS = 400 * MS
"""So long nothing must have changed before what is shown is compared."""
_STANDS_RPM = 1.0
_OPERATION, _FAULT = 0x0004, 0x0008
_ENABLING = 0x000F


class ViolationError(Exception):
    """Something happened that must never happen."""


class SoakAxis:
    """The drive of one axis and what the PLC asks of it."""

    def __init__(self, index: int, drive: SimulatedDrive, member: Member, words: Words, in_force_ns: int) -> None:
        self.index = index
        self.drive = drive
        self.member = member
        """The drive's controller on the bus."""
        self.words = words
        self.starts = 0
        """How often operation was entered."""
        self._in_force_ns = in_force_ns
        """An order holds so long without another: an OFF in force when the doubt ends is one after it."""
        self._off_sent = -1
        self._enabled = -1
        self._doubt = (0, "power on")
        self._previous = drive.model.state
        self._changed = drive.loop.now()
        self._lost_since: int | None = None
        self._disturbed_until = 0
        drive.model.watchers.append(self._entered)

    @property
    def name(self) -> str:
        return f"axis {self.index + 1}"

    # -- what happens -------------------------------------------------------------------------------------------------

    def doubt(self, why: str, since: int | None = None) -> None:
        """From now on, or from a moment before, a start needs another OFF."""
        when = self.drive.loop.now() if since is None else since
        if when > self._doubt[0]:
            self._doubt = (when, why)

    def disturbed(self) -> None:
        """The drive itself is out of order just now."""
        self._disturbed_until = self.drive.loop.now()

    def sent(self, now: int) -> None:
        """A frame with the present word leaves the PLC; ``now``: with the delay that all frames have."""
        if not self.words.word & OFF_BIT:
            self._off_sent = now

    def enabled(self, now: int) -> None:
        """The gateway gave its controller an Enable Operation for the drive."""
        self._enabled = now

    def _entered(self, state: State) -> None:
        now = self.drive.loop.now()
        if state is State.OPERATION_ENABLED and self._previous is not State.OPERATION_ENABLED:
            self.starts += 1
            since, why = self._doubt
            # What it was told before the doubt a drive may still do: it waited for its enable input, or a controller that was cut
            # off held the frame, with the stop behind it.
            if self._enabled > since and self._off_sent < since - self._in_force_ns:
                before = (
                    "none was sent"
                    if self._off_sent < 0
                    else f"the last was sent {(now - self._off_sent) / MS:.0f} ms ago"
                )
                raise ViolationError(
                    f"{self.name}: started without OFF after a doubt ({why}, {(now - since) / MS:.0f} ms ago; {before})"
                )
        elif state in {State.FAULT_REACTION_ACTIVE, State.FAULT}:
            self.doubt("fault of the drive")
        self._previous = state
        self._changed = now

    # -- what holds at any time ---------------------------------------------------------------------------------------

    def check(self, now: int, *, reached: bool, zsw1: int | None) -> None:
        """``reached``: PLC, gateway and drive are joined. ``zsw1``: what the PLC is shown, None while that may change."""
        self.drive.node.catch_up(now)
        self._check_standstill(now, reached)
        model = self.drive.model
        # A positioner goes from block to block, and jogs.
        if self.words.telegram.number not in POSITIONER_TELEGRAM_NUMBERS and model.started > self.words.commands:
            raise ViolationError(f"{self.name}: {model.started} tasks begun, {self.words.commands} given by the PLC")
        if zsw1 is not None and now - max(self._changed, self._disturbed_until) > SETTLED_NS:
            self._check_shown(model.state, zsw1)

    def _check_standstill(self, now: int, reached: bool) -> None:
        if reached:
            self._lost_since = None
            return
        if self._lost_since is None:
            self._lost_since = now
        since = max(self._lost_since, self._disturbed_until)
        model = self.drive.model
        if now - since > STOP_BOUND_NS and model.state in POWERED and abs(model.ramp.speed) > _STANDS_RPM:
            raise ViolationError(
                f"{self.name}: turns with {model.ramp.speed:.0f} rpm under power {(now - since) / MS:.0f} ms after a loss"
            )

    def _check_shown(self, state: State, zsw1: int) -> None:
        if zsw1 & _OPERATION and state is not State.OPERATION_ENABLED:
            raise ViolationError(f"{self.name}: ZSW1 {zsw1:04X}h shows operation, the drive is in {state.value}")
        if state is State.FAULT and not zsw1 & _FAULT:
            raise ViolationError(f"{self.name}: ZSW1 {zsw1:04X}h shows no fault, the drive is in {state.value}")
