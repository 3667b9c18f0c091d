"""The interlock of one axis: runs the power table (``power_table``) once per cycle.

It adds what one cycle does not show: that the drive left operation by itself, that it is at standstill in a quick stop, and that
an acknowledge is an edge of this connection.
"""

from __future__ import annotations

from typing import Final

from pdgw.dsp402.states import STATE_OF_STATUS, ControlBit
from pdgw.durations import MS
from pdgw.gateway.axis.answer import Answer
from pdgw.gateway.axis.demand_report import OFF1S, STATE_MASK, PowerWish
from pdgw.gateway.axis.power_states import CONTROLWORDS, DRIVE_OF_STATE, Action, Drive, Phase
from pdgw.gateway.axis.power_table import CELLS, DRIVES, LOCKS, NO_PLC, STOPPING, WISHES, Cell
from pdgw.gateway.axis.settings import AxisSettings, PlcLossReaction
from pdgw.gateway.reasons import Reason

QUICK_STOP_STANDING_NS: Final = 200 * MS
"""A drive that stays in Quick Stop Active at standstill for this time (option codes 5-8) gets Disable Voltage."""

_DRIVE_OF_STATUS: Final = tuple(DRIVE_OF_STATE[state] for state in STATE_OF_STATUS)
_ENABLING: Final = CONTROLWORDS[Action.ENABLE_OPERATION]
_ABOVE_DISABLED: Final = (Drive.READY, Drive.SWITCHED_ON, Drive.OPERATING, Drive.QUICK_STOPPING)
_BELOW_READY: Final = (Drive.NOT_READY, Drive.DISABLED)
_FELL: Final = (Drive.NOT_READY, Drive.DISABLED, Drive.READY, Drive.SWITCHED_ON)
_ACKNOWLEDGES: Final = (*LOCKS, Phase.UNCONFIRMED, Phase.COAST, Phase.FOLLOW)
"""Phases in which an acknowledge passes; a stop is not disturbed by it."""
_FOLLOW: Final = Phase.FOLLOW
_PASS: Final = Phase.PASS
_RAMP_STOP: Final = Phase.RAMP_STOP
_QUICK_STOP: Final = Phase.QUICK_STOP
_OPERATING: Final = Drive.OPERATING
_STANDING: Final = Drive.STANDING
_IN_OPERATION: Final = (_OPERATING, _STANDING)
_SWITCHED_ON: Final = Drive.SWITCHED_ON
_LEAVING: Final = Drive.LEAVING
_OFF1S: Final = OFF1S
_WITHOUT_DISABLE: Final = {
    PowerWish.OFF_DISABLED: PowerWish.OFF,
    PowerWish.QUICK_STOP_DISABLED: PowerWish.QUICK_STOP,
}
_ENABLED: Final = (PowerWish.ENABLE, PowerWish.OFF, PowerWish.QUICK_STOP)
"""STW1.3 = 1."""
_STOPPING: Final = STOPPING
_ENABLE: Final = PowerWish.ENABLE
_STOP: Final = PowerWish.STOP
_PASSES: Final = Action.PASS
_PLC_LOST: Final = Reason.PLC_LOST
_OPERATES: Final = (Action.ENABLE_OPERATION, Action.PASS)
_WITHOUT_PLC: Final = NO_PLC
_NO_PLC: Final = {
    PlcLossReaction.RAMP: PowerWish.NO_PLC_RAMP,
    PlcLossReaction.QUICK_STOP: PowerWish.NO_PLC_QUICK_STOP,
    PlcLossReaction.COAST: PowerWish.NO_PLC_COAST,
}


class Interlock:
    """Call ``step`` once per cycle. ``phase``, ``action``, ``controlword`` and ``reason`` show the result."""

    def __init__(self, settings: AxisSettings) -> None:
        self.phase: Phase = Phase.LOCKED
        self.action: Action = Action.DISABLE_VOLTAGE
        self.controlword = 0
        """Bits 0-3 and 7 of the Controlword; of ``Action.PASS`` they are the telegram's."""
        self.reason: Reason | None = Reason.NO_PLC
        self.cell: Cell = CELLS[0]
        """The last result of the table."""
        self._no_plc = _NO_PLC[settings.on_plc_loss]
        self._resume = settings.ramp_stop_resume
        self._connected = False
        self.plc_was_there = False
        """There was a PLC, also one without control: its absence is a loss, not a wait for the first frame."""
        self._acknowledge_armed = False
        self._disable_armed = False
        """STW1.3 was 1 during the present stop: its fall to 0 ends that."""
        self._enable = Answer(settings.latency_ns)
        """Operation Enabled, in answer to Enable Operation."""
        self._shutdown_since = -1
        """Since when Shutdown is commanded to a drive without power; -1 while it is not."""
        self._latency = settings.latency_ns
        self._late_until = 0
        """Until then, Operation Enabled may be the answer to an Enable Operation that was withdrawn; 0: it was answered."""
        self._enabling = False
        """The last Controlword was Enable Operation."""
        self._off_seen = False
        self._standing_since = -1
        self._shown: Drive | None = None
        """The Statusword of the previous cycle, while the drive follows the PLC."""
        self._steady = False
        """Fast path: in operation as requested, nothing to report."""
        self._steady_status = 0

    @property
    def operates(self) -> bool:
        """Operation was commanded in the last step."""
        return self.phase is _FOLLOW and self._enabling

    @property
    def released(self) -> bool:
        """The drive follows the PLC: an OFF only stops."""
        return self.phase is _FOLLOW or self.phase is _PASS

    def restarted(self) -> None:
        """The drive booted or was configured again: a constant ON may not start it, a constant acknowledge is not an edge."""
        self.phase = CELLS[(self.phase * DRIVES + Drive.RESTARTED) * WISHES + PowerWish.OFF].phase
        self._acknowledge_armed = self._steady = False
        self._shown = None

    def distrust(self) -> None:
        """Quick Stop replaced the last Controlword: stop until the drive shows that it is off, locked until an OFF."""
        self.phase = Phase.UNCONFIRMED
        self._enabling = self._steady = False
        self._shown = None

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
        if (
            wish is _ENABLE
            and self._steady
            and statusword & STATE_MASK == self._steady_status
            and condition is None
            and not acknowledge
        ):
            return
        if wish is None:
            wish = self._no_plc
        connected = wish not in _WITHOUT_PLC
        if connected is not self._connected:
            self._connected = connected
            self._off_seen = self._acknowledge_armed = False
            if connected:
                self.plc_was_there = True
        phase = self.phase
        if not connected:
            wish = max(wish, self._no_plc)
            armed = enables = False
        else:
            enables = wish in _ENABLED
            if wish in _WITHOUT_DISABLE and not self._disable_armed:
                # A stop that starts with STW1.3 = 0 brakes.
                wish = _WITHOUT_DISABLE[wish]
            if wish in _OFF1S:
                self._off_seen = self._resume
            elif wish is _STOP:
                self._off_seen = False  # without control an OFF does not count, and an earlier one no longer counts
            elif phase is _RAMP_STOP and wish is _ENABLE and self._off_seen:
                # After a loss, an ON that is already active in the new connection does not resume: it needs its own OFF
                # first.
                wish = PowerWish.RESUME
            armed = self._acknowledge_armed
        seen: Drive | None = None
        if condition is not None:
            drive = condition
            self._acknowledge_armed = armed = False
        else:
            drive = seen = _DRIVE_OF_STATUS[statusword & STATE_MASK]
            shown = self._shown
            if shown is not None and drive is not shown:
                drive = self._changed(drive, shown, now)
            if drive is _OPERATING:
                self._standing_since = -1
                if not self._enabling:
                    drive = _LEAVING
                elif standstill:
                    drive = _STANDING
            elif drive is _SWITCHED_ON:
                if self._enabling:
                    drive = Drive.ENTERING
            elif drive in _BELOW_READY:
                if 0 <= self._shutdown_since <= now - self._latency:
                    drive = Drive.INHIBITED
            elif phase is _QUICK_STOP and drive is Drive.QUICK_STOPPING:
                drive = self._quick_stopping(standstill, now)
            if connected and not acknowledge:
                self._acknowledge_armed = True
        cell = CELLS[(phase * DRIVES + drive) * WISHES + wish]
        self.cell = cell
        after = cell.phase
        if after is not phase:
            self.phase = after
            self._standing_since = -1
        self._shown = seen if after is _FOLLOW or after is _PASS else None
        self._disable_armed = after in _STOPPING and (enables or (self._disable_armed and after is phase))
        self.action = action = cell.action
        if action is not Action.SHUTDOWN:
            self._shutdown_since = -1
        elif self._shutdown_since < 0:
            self._shutdown_since = now
        enabling = cell.controlword == _ENABLING or (action is _PASSES and wish is _ENABLE)
        if enabling is not self._enabling:
            self._enabling = enabling
            self._late_until = 0
            if enabling:
                self._enable.command(now)
            else:
                if not self._enable.given:
                    self._late_until = now + self._latency
                self._enable.withdraw()
        elif self._late_until and now >= self._late_until:
            self._late_until = 0
        if enabling and not self._enable.given:
            self._enable.read(seen is _OPERATING, now)
        self._steady = False
        reason = cell.reason
        if reason is _PLC_LOST and not self.plc_was_there:
            reason = Reason.NO_PLC
        self.reason = reason
        if enabling and wish is _ENABLE and drive in _IN_OPERATION and action in _OPERATES and not acknowledge:
            # Operation continues; the next equal cycle has the same result.
            self._steady = True
            self._steady_status = statusword & STATE_MASK
        resets = acknowledge and armed and after in _ACKNOWLEDGES
        self.controlword = cell.controlword | ControlBit.FAULT_RESET if resets else cell.controlword

    def _changed(self, drive: Drive, shown: Drive | None, now: int) -> Drive:
        """The drive shows another state while it follows the PLC: by itself, or as the answer to a command?"""
        if drive is Drive.OPERATING:
            # The command of the previous step counts, at any cycle time.
            commanded = self._enabling or now < self._late_until
            return drive if commanded or self.phase is _PASS else Drive.UNKNOWN
        if drive is Drive.DISABLED:
            return Drive.FELL_OFF if shown in _ABOVE_DISABLED else drive
        if self._enabling and shown is _SWITCHED_ON and drive in _FELL:
            return Drive.FELL_BACK  # instead of reaching operation
        operated = self._enabling and (self._enable.given or self._enable.due(now))
        return Drive.FELL_BACK if operated and shown is Drive.OPERATING and drive in _FELL else drive

    def _quick_stopping(self, standstill: bool, now: int) -> Drive:
        if not standstill:
            self._standing_since = -1
        elif self._standing_since < 0:
            self._standing_since = now
        elif now - self._standing_since >= QUICK_STOP_STANDING_NS:
            return Drive.QUICK_STOPPED
        return Drive.QUICK_STOPPING
