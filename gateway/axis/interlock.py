"""The interlock of one axis: runs the power table (``power_table``) once per cycle.

It adds what one cycle does not show: that the drive left operation by itself, that it does not follow Shutdown or an ON in time,
that it is at standstill in a quick stop, and that an acknowledge is an edge of this connection.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pdgw.base.durations import MS
from pdgw.dsp402.states import STATE_OF_STATUS, ControlBit, StatusBit
from pdgw.gateway.axis.answer import Answer
from pdgw.gateway.axis.demand_report import OFF1S, STATE_MASK, PowerWish
from pdgw.gateway.axis.power_cells import CELLS, DRIVES, WISHES, Cell
from pdgw.gateway.axis.power_states import CONTROLWORDS, DRIVE_OF_STATE, Action, Drive, Phase
from pdgw.gateway.axis.power_table import LOCKS, NO_PLC, ON_WISHES, STOPPING
from pdgw.gateway.axis.settings import AxisSettings, PlcLossReaction
from pdgw.gateway.base.reasons import Reason

QUICK_STOP_STANDING_NS: Final = 200 * MS
"""A drive that stays in Quick Stop Active at standstill for this time (option codes 5-8) gets Disable Voltage."""

_DRIVE_OF_STATUS: Final = tuple(DRIVE_OF_STATE[state] for state in STATE_OF_STATUS)
_ENABLING: Final = CONTROLWORDS[Action.ENABLE_OPERATION]
_ABOVE_DISABLED: Final = (Drive.READY, Drive.SWITCHED_ON, Drive.OPERATING, Drive.QUICK_STOPPING)
_BELOW_READY: Final = (Drive.NOT_READY, Drive.DISABLED)
_WITHOUT_POWER: Final = (Drive.NOT_READY, Drive.DISABLED, Drive.READY)
_UP_TO_SWITCHED_ON: Final = (*_WITHOUT_POWER, Drive.SWITCHED_ON)
_WAITS: Final = (Phase.FOLLOW, Phase.INHIBITED)
"""Phases in which an ON may wait for a drive in local mode."""
_ACKNOWLEDGES: Final = (*LOCKS, Phase.UNCONFIRMED, Phase.COAST, Phase.FOLLOW)
"""Phases in which an acknowledge passes; a stop is not disturbed by it."""
_FOLLOW: Final = Phase.FOLLOW
_PASS: Final = Phase.PASS
_OPERATING: Final = Drive.OPERATING
_SWITCHED_ON: Final = Drive.SWITCHED_ON
_LEAVING: Final = Drive.LEAVING
_WITHOUT_DISABLE: Final = {
    PowerWish.OFF_DISABLED: PowerWish.OFF,
    PowerWish.QUICK_STOP_DISABLED: PowerWish.QUICK_STOP,
}
_ENABLED: Final = (PowerWish.ENABLE, PowerWish.OFF, PowerWish.QUICK_STOP)
"""STW1.3 = 1."""
_ENABLE: Final = PowerWish.ENABLE
_NO_PLC: Final = {
    PlcLossReaction.RAMP: PowerWish.NO_PLC_RAMP,
    PlcLossReaction.QUICK_STOP: PowerWish.NO_PLC_QUICK_STOP,
    PlcLossReaction.COAST: PowerWish.NO_PLC_COAST,
}


def _limits(latency: int, enter: int) -> Mapping[Drive | None, Mapping[Drive, int]]:
    """How long a drive may show a state while another one is awaited: then it is inhibited, or a quick stop has ended."""
    enter = max(latency, enter)  # no ON ends before the drive could have shown that it follows
    below = dict.fromkeys(_BELOW_READY, latency)
    return MappingProxyType(
        {
            None: {},
            Drive.READY: below,
            Drive.SWITCHED_ON: {**below, Drive.READY: enter, Drive.SWITCHED_ON: enter},
            Drive.DISABLED: {Drive.QUICK_STOPPING: QUICK_STOP_STANDING_NS},
        }
    )


class Connection(enum.Enum):
    """The connection of the last request."""

    NONE = "no PLC"
    CONNECTED = "a PLC"
    ARMED = "a PLC; the bit of its acknowledge was 0 with the drive in sight, so the next 1 is an edge"


_UNCONNECTED, _CONNECTED, _ARMED = Connection


@dataclass(slots=True, eq=False)
class Request:
    """The requests of the PLC up to now: the reaction to one depends on those before it in this connection."""

    no_plc: PowerWish
    """Reaction to a loss of the PLC."""
    resume: bool
    """ENABLE after an OFF ends a ramp stop."""
    connection: Connection = Connection.NONE
    off_seen: bool = False
    """With ``resume``: an OFF of this connection came, and no loss of control since."""
    disable_armed: bool = False
    """STW1.3 was 1 during the present stop: its fall to 0 ends that."""

    def disarm(self) -> None:
        """A bit of the acknowledge that is 1 is not an edge."""
        if self.connection is _ARMED:
            self.connection = _CONNECTED

    def step(self, wish: PowerWish | None, acknowledge: bool, seen: Drive | None, phase: Phase) -> PowerWish:
        """The column of the power table. ``seen``: what the drive shows, None if it does not count."""
        if wish is None:
            wish = self.no_plc
        if wish in NO_PLC:
            self.connection = _UNCONNECTED
            self.off_seen = False
            return max(wish, self.no_plc)
        if self.connection is _UNCONNECTED:
            self.connection = _CONNECTED
        if seen is None:
            self.disarm()
        elif not acknowledge:
            self.connection = _ARMED
        if wish in _WITHOUT_DISABLE and not self.disable_armed:
            wish = _WITHOUT_DISABLE[wish]  # a stop that starts with STW1.3 = 0 brakes
        if wish in OFF1S:
            self.off_seen = self.resume
        elif wish is PowerWish.STOP:
            self.off_seen = False  # without control an OFF does not count, and an earlier one no longer counts
        elif phase is Phase.RAMP_STOP and wish is _ENABLE and self.off_seen:
            # After a loss, an ON that is already active in the new connection does not resume: it needs its own OFF first.
            return PowerWish.RESUME
        return wish


@dataclass(slots=True, eq=False)
class Remote:
    """Statusword.9. Its 0 is local mode only in a state in which the drive has shown 1: some show it with power alone."""

    latency: int
    """The bit can be ahead of a state below operation for this time."""
    known: int = 0
    """States in which it was 1, a bit each; one that shows it in Ready To Switch On also shows it in Switched On."""
    state: Drive | None = None
    """The last one without operation in which it was 1; None: it is 0."""
    since: int = 0
    """Since when."""

    def read(self, seen: Drive, statusword: int, now: int) -> None:
        """Take what one cycle shows."""
        if not statusword & StatusBit.REMOTE:
            self.state = None
        elif seen in _UP_TO_SWITCHED_ON and seen is not self.state:
            self.state, self.since = seen, now
        elif seen not in _UP_TO_SWITCHED_ON or now - self.since >= self.latency:
            self.known |= (3 if seen is Drive.READY else 1) << seen

    def is_local(self, seen: Drive, statusword: int) -> bool:
        """Whether the drive takes no commands from the bus."""
        return not statusword & StatusBit.REMOTE and self.known >> seen & 1 != 0


@dataclass(slots=True, eq=False)
class Commanded:
    """The commands to the drive and what it showed: a Statusword counts as an answer only with the command before it."""

    latency: int
    remote: Remote
    limits: Mapping[Drive | None, Mapping[Drive, int]]
    """By the awaited state and the one shown instead: the longest time, in ns."""
    enable: Answer
    """Operation Enabled, in answer to Enable Operation."""
    enabling: bool = False
    """The last Controlword was Enable Operation."""
    late_until: int = 0
    """Until then, Operation Enabled may be the answer to an Enable Operation that was withdrawn; 0: it was answered."""
    awaits: Drive | None = None
    """The state that Shutdown, an ON, or the end of a quick stop must lead to; None: no such command."""
    since: int = 0
    """Since when; 0: no such command."""
    local: bool = False
    """The drive is in local mode."""
    shown: Drive | None = None
    """The Statusword of the previous cycle, while the drive follows the PLC."""

    def drive(self, seen: Drive, statusword: int, phase: Phase, standstill: bool, now: int) -> Drive:
        """The row of the power table for a Statusword."""
        shown = self.shown
        self.remote.read(seen, statusword, now)
        drive = seen if shown is None or seen is shown else self._changed(seen, shown, phase, now)
        self.local = phase in _WAITS and drive in _UP_TO_SWITCHED_ON and self.remote.is_local(drive, statusword)
        if self.local:
            return Drive.LOCAL if drive is _SWITCHED_ON else Drive.INHIBITED
        if drive is _OPERATING:
            if not self.enabling:
                return _LEAVING
            return Drive.STANDING if standstill else _OPERATING
        if drive is _SWITCHED_ON and self.enabling:
            return Drive.ENTERING
        limits = self.limits[self.awaits]
        if drive not in limits or now - self.since < limits[drive]:
            return drive
        if drive is not Drive.QUICK_STOPPING:
            return Drive.INHIBITED
        return Drive.QUICK_STOPPED if standstill else drive

    def _changed(self, drive: Drive, shown: Drive, phase: Phase, now: int) -> Drive:
        """The drive shows another state while it follows the PLC: by itself, or as the answer to a command?"""
        if drive is _OPERATING:
            # The command of the previous step counts, at any cycle time.
            commanded = self.enabling or now < self.late_until
            return drive if commanded or phase is _PASS else Drive.UNKNOWN
        if drive is Drive.DISABLED:
            return Drive.FELL_OFF if shown in _ABOVE_DISABLED else drive
        if self.enabling and shown is _SWITCHED_ON and drive in _UP_TO_SWITCHED_ON:
            return Drive.FELL_BACK  # instead of reaching operation
        operated = self.enabling and self.enable.due(now)
        return Drive.FELL_BACK if operated and shown is _OPERATING and drive in _UP_TO_SWITCHED_ON else drive

    def withdraw(self, now: int) -> None:
        """Enable Operation is not commanded any more."""
        self.enabling = False
        self.late_until = 0 if self.enable.given else now + self.latency
        self.enable.withdraw()

    def done(
        self, cell: Cell, column: PowerWish, seen: Drive | None, before: Phase, standstill: bool, now: int
    ) -> None:
        """The table has led from the phase ``before`` to a command for a drive that shows ``seen``."""
        phase, action = cell.phase, cell.action
        self.shown = seen if phase is _FOLLOW or phase is _PASS else None
        awaits = None
        if before is Phase.QUICK_STOP and seen is Drive.QUICK_STOPPING:
            awaits = Drive.DISABLED if standstill else None
        elif phase is _FOLLOW and seen in _WITHOUT_POWER and column in ON_WISHES:
            awaits = _SWITCHED_ON
        elif action is Action.SHUTDOWN:
            awaits = Drive.READY
        if awaits is not self.awaits:
            self.awaits, self.since = awaits, now if awaits else 0
        enabling = cell.controlword == _ENABLING or (action is Action.PASS and column is _ENABLE)
        if enabling is not self.enabling:
            if enabling:
                self.enabling, self.late_until = True, 0
                self.enable.command(now)
            else:
                self.withdraw(now)
        elif self.late_until and now >= self.late_until:
            self.late_until = 0
        if enabling and not self.enable.given:
            self.enable.read(seen is _OPERATING, now)


class Interlock:
    """Call ``step`` once per cycle. ``phase``, ``cell``, ``controlword`` and ``reason`` show the result."""

    def __init__(self, settings: AxisSettings) -> None:
        self.phase: Phase = Phase.LOCKED
        self.cell: Cell = CELLS[0]
        """The last result of the table."""
        self.controlword = 0
        """Bits 0-3 and 7 of the Controlword; of ``Action.PASS`` they are the telegram's."""
        self.reason: Reason | None = Reason.NO_PLC
        self.plc_was_there = False
        """There was a PLC, also one without control: its absence is a loss, not a wait for the first frame."""
        self._steady = -1
        """Fast path: the state bits of the Statusword in operation as requested with nothing to report; else -1."""
        self._request = Request(_NO_PLC[settings.on_plc_loss], settings.ramp_stop_resume)
        latency = settings.latency_ns
        self._commanded = Commanded(latency, Remote(latency), _limits(latency, settings.enter_ns), Answer(latency))

    @property
    def operates(self) -> bool:
        """Operation was commanded in the last step."""
        return self.phase is _FOLLOW and self._commanded.enabling

    @property
    def released(self) -> bool:
        """The drive follows the PLC: an OFF only stops."""
        return self.phase is _FOLLOW or self.phase is _PASS

    def notice_plc(self) -> None:
        """There is a PLC, with or without control."""
        self.plc_was_there = True

    def restarted(self) -> None:
        """The drive booted or was configured again: a constant ON may not start it, a constant acknowledge is not an edge."""
        self.phase = CELLS[(self.phase * DRIVES + Drive.RESTARTED) * WISHES + PowerWish.OFF].phase
        self._request.disarm()
        self._steady = -1
        self._commanded.shown = None
        self._commanded.remote = Remote(self._commanded.latency)

    def is_local(self, statusword: int) -> bool:
        """Whether the drive takes no commands from the bus: local mode."""
        return self._commanded.remote.is_local(_DRIVE_OF_STATUS[statusword & STATE_MASK], statusword)

    def distrust(self, now: int) -> None:
        """Quick Stop replaced the last Controlword: stop until the drive shows that it is off, locked until an OFF."""
        self.phase = Phase.UNCONFIRMED
        self._steady = -1
        self._commanded.withdraw(now)
        self._commanded.shown = None

    def disable_voltage(self, now: int) -> None:
        """The last stop replaces Quick Stop: no power until the drive shows that it is off, locked until an OFF."""
        self.distrust(now)
        self.phase = Phase.COAST

    def expects_operation(self, now: int) -> bool:
        """Operation is commanded, or was so shortly ago that the drive may show it now for the first time."""
        return self._commanded.enabling or now < self._commanded.late_until or self.phase is _PASS

    def step(
        self,
        wish: PowerWish | None,
        acknowledge: bool,
        condition: Drive | None,
        statusword: int,
        standstill: bool,
        now: int,
    ) -> None:
        """One cycle.

        ``wish``: None while there is no PLC, or the stop of a frame that does not count otherwise (NO_PLC_QUICK_STOP,
        NO_PLC_COAST), which wins over a reaction of lower rank. ``acknowledge``: its bit, a level. ``condition``: LOST or
        NO_REFERENCES, which go before what the Statusword shows. ``standstill``: the actual speed is inside the standstill
        window. ``now``: monotonic nanoseconds.
        """
        status = statusword & STATE_MASK
        if wish is _ENABLE and status == self._steady and condition is None and not acknowledge:
            return
        request, commanded, phase = self._request, self._commanded, self.phase
        seen: Drive | None = None
        if condition is not None:
            drive = condition
        else:
            seen = _DRIVE_OF_STATUS[status]
            drive = commanded.drive(seen, statusword, phase, standstill, now)
        column = request.step(wish, acknowledge, seen, phase)
        self.cell = cell = CELLS[(phase * DRIVES + drive) * WISHES + column]
        self.phase = cell.phase
        request.disable_armed = cell.phase in STOPPING and (
            wish in _ENABLED or (request.disable_armed and cell.phase is phase)
        )
        commanded.done(cell, column, seen, phase, standstill, now)
        if request.connection is not _UNCONNECTED:
            self.plc_was_there = True
        self.reason = cell.reason
        if cell.reason is Reason.PLC_LOST and not self.plc_was_there:
            self.reason = Reason.NO_PLC
        elif cell.reason is Reason.INHIBITED and commanded.local:
            self.reason = Reason.LOCAL_MODE
        # Operation continues: the next equal cycle has the same result.
        self._steady = status if cell.operating and column is _ENABLE and not acknowledge else -1
        resets = acknowledge and request.connection is _ARMED and cell.phase in _ACKNOWLEDGES
        self.controlword = cell.controlword | ControlBit.FAULT_RESET if resets else cell.controlword
