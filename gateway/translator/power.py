"""Power control: from STW1 bits 0-3 and 7 to the Controlword's, with everything the telegrams demand beyond DSP402.

Source: docs/translation.md "States", "Standard telegrams" 3-4 and "Loss and doubt"; the manufacturer's guide 5.1.
PROFIdrive's OFF1 ramps down before power goes off, DSP402's Shutdown does not: the ramp stop lives here. So does the
interlock: after start, PLC loss, drive fault, drive restart or an enable the drive took back, nothing but an OFF
followed by an ON puts the power stage on again. Left out: setpoints and modes, which the telegram translators own.

| phase | meaning | Controlword |
| --- | --- | --- |
| LOCKED | ON is not obeyed until an OFF is seen | 0, Quick Stop while in doubt; only an acknowledge passes |
| FOLLOW | STW1 is obeyed, one transition at a time | by STW1 and state |
| RAMP_STOP | OFF1: ramping down with power on, Shutdown at standstill | Enable Operation, then Shutdown |
| QUICK_STOP | quick stop until the drive has left it | Quick Stop |
"""

from __future__ import annotations

import enum

from pdgw.dsp402.states import STATE_OF_STATUS, ControlBit, State, StatusBit
from pdgw.gateway.reasons import Reason
from pdgw.gateway.translator.base import PlcLossReaction, TranslatorSettings
from pdgw.profidrive.signals import signal

_STW1 = signal("STW1")
ON = _STW1.bit("ON").mask
NO_COAST_STOP = _STW1.bit("NO_COAST_STOP").mask
NO_QUICK_STOP = _STW1.bit("NO_QUICK_STOP").mask
ENABLE_OPERATION = _STW1.bit("ENABLE_OPERATION").mask
FAULT_ACKNOWLEDGE = _STW1.bit("FAULT_ACKNOWLEDGE").mask
CONTROL_BY_PLC = _STW1.bit("CONTROL_BY_PLC").mask

_OFF_MASK = ON | NO_COAST_STOP | NO_QUICK_STOP
_OFF = NO_COAST_STOP | NO_QUICK_STOP
_COMMAND = _OFF_MASK | ENABLE_OPERATION
_DISABLE_OPERATION = _OFF_MASK

CW_SHUTDOWN = ControlBit.ENABLE_VOLTAGE | ControlBit.QUICK_STOP
CW_SWITCH_ON = CW_SHUTDOWN | ControlBit.SWITCH_ON
CW_ENABLE_OPERATION = CW_SWITCH_ON | ControlBit.ENABLE_OPERATION
CW_QUICK_STOP = ControlBit.ENABLE_VOLTAGE
CW_DISABLE_VOLTAGE = 0

QUICK_STOP_STANDING_NS = 200_000_000
"""A drive that stays in Quick Stop Active at standstill for so long (option codes 5-8) gets Disable Voltage."""
DISABLE_SHOWN_NS = 200_000_000
"""So long after a Disable Operation the drive's leaving of Operation Enabled is the PLC's doing, not its own."""


class Phase(enum.Enum):
    """See the module's table."""

    LOCKED = "locked"
    FOLLOW = "follow"
    RAMP_STOP = "ramp stop"
    QUICK_STOP = "quick stop"


class PowerControl:
    """One axis' power control. ``step`` once per cycle; ``phase`` and ``reason`` tell what it does and why."""

    __slots__ = (
        "_acknowledge_armed",
        "_connected",
        "_disabled_at",
        "_doubt",
        "_ever_connected",
        "_off_seen",
        "_previous",
        "_reaction",
        "_resume",
        "_shutting_down",
        "_standing_since",
        "phase",
        "reason",
    )

    def __init__(self, settings: TranslatorSettings) -> None:
        self.phase = Phase.LOCKED
        self.reason: Reason | None = Reason.NO_PLC
        self._reaction = settings.on_plc_loss
        self._resume = settings.ramp_stop_resume
        self._connected = False
        self._ever_connected = False
        self._acknowledge_armed = False
        self._disabled_at = -DISABLE_SHOWN_NS
        self._doubt = False
        self._off_seen = False
        self._shutting_down = False
        self._standing_since = -1
        self._previous: State | None = None

    @property
    def ramping(self) -> bool:
        """An OFF1 ramp stop holds the power on: the translator has to bring the axis to standstill."""
        return self.phase is Phase.RAMP_STOP

    def lock(self) -> None:
        """The drive restarted, is lost or must not run: no standing ON may start it, no standing acknowledge is an edge."""
        self.phase = Phase.LOCKED
        self._acknowledge_armed = False
        self._previous = None
        self._standing_since = -1
        self._shutting_down = False

    def step(self, word: int, connected: bool, drive_ok: bool, statusword: int, standstill: bool, now: int) -> int:
        """Bits 0-3 and 7 of the Controlword.

        ``word``: the STW1 in force. ``connected``: a valid PLC is there. ``standstill``: the actual speed is inside the
        standstill window. ``now``: monotonic nanoseconds.
        """
        state = STATE_OF_STATUS[statusword & 0x7F]
        previous = self._previous
        self._previous = state
        if connected is not self._connected:
            self._connection_changed(connected, state)
        if not drive_ok:
            self.lock()
            self._doubt = True
            self.reason = Reason.DRIVE_OFFLINE
            return CW_QUICK_STOP
        if state is State.FAULT or state is State.FAULT_REACTION_ACTIVE:
            self.phase = Phase.LOCKED
            self._doubt = False
            self.reason = Reason.DRIVE_FAULT
            return self._acknowledge(word, connected)
        if state is None:
            self.phase = Phase.LOCKED
            self._doubt = True
            self.reason = Reason.DRIVE_UNKNOWN_STATE
            return CW_QUICK_STOP
        phase = self.phase
        if phase is Phase.FOLLOW:
            return self._follow(word, state, previous, now)
        if phase is Phase.RAMP_STOP:
            return self._ramp_stop(word, state, standstill, now)
        if phase is Phase.QUICK_STOP:
            return self._quick_stop(word, state, standstill, now)
        return self._locked(word, state, now)

    def _connection_changed(self, connected: bool, state: State | None) -> None:
        self._connected = connected
        self._off_seen = False
        if connected:
            self._ever_connected = True
            self._acknowledge_armed = False
            return
        if self.phase is Phase.QUICK_STOP or state is State.QUICK_STOP_ACTIVE:
            self.phase = Phase.QUICK_STOP
        elif state is State.OPERATION_ENABLED and self._reaction is not PlcLossReaction.COAST:
            if self._reaction is PlcLossReaction.QUICK_STOP:
                self._enter_quick_stop()
            elif self.phase is not Phase.RAMP_STOP:
                self._enter_ramp_stop()
        else:
            self.phase = Phase.LOCKED

    def _acknowledge(self, word: int, connected: bool) -> int:
        """The acknowledge passes only after it was seen 0 in this connection: a standing one is no edge."""
        if not connected:
            return 0
        if not word & FAULT_ACKNOWLEDGE:
            self._acknowledge_armed = True
            return 0
        return ControlBit.FAULT_RESET if self._acknowledge_armed else 0

    def _locked(self, word: int, state: State, now: int) -> int:
        if self._connected and word & _OFF_MASK == _OFF and state not in _POWERED:
            self.phase = Phase.FOLLOW
            self._doubt = False
            return self._follow(word, state, state, now)
        if not self._connected:
            self.reason = Reason.PLC_LOST if self._ever_connected else Reason.NO_PLC
        else:
            self.reason = Reason.NEEDS_OFF
        if state is State.QUICK_STOP_ACTIVE:
            self._enter_quick_stop()
            return CW_QUICK_STOP
        if state is State.SWITCH_ON_DISABLED:
            self._doubt = False
        stop = CW_QUICK_STOP if self._doubt and not self._coast_asked(word) else CW_DISABLE_VOLTAGE
        return stop | self._acknowledge(word, self._connected)

    def _coast_asked(self, word: int) -> bool:
        """Whether the drive has to coast: by the PLC's word, without a PLC by the user's choice."""
        return not word & NO_COAST_STOP if self._connected else self._reaction is PlcLossReaction.COAST

    def _follow(self, word: int, state: State, previous: State | None, now: int) -> int:
        acknowledge = self._acknowledge(word, True)
        if state is State.OPERATION_ENABLED:
            if previous is not state:
                self._disabled_at = now - DISABLE_SHOWN_NS
            if word & _COMMAND == _COMMAND:
                self.reason = None
                return CW_ENABLE_OPERATION | acknowledge
            if not word & NO_COAST_STOP:
                self.reason = Reason.COAST_STOP
                return CW_DISABLE_VOLTAGE
            if not word & NO_QUICK_STOP:
                self._enter_quick_stop()
                return CW_QUICK_STOP
            if not word & ON:
                self._enter_ramp_stop()
                self._off_seen = True
                return CW_ENABLE_OPERATION
            self.reason = Reason.NOT_OPERATING
            self._disabled_at = now
            return CW_SWITCH_ON
        if state is State.QUICK_STOP_ACTIVE:
            self._enter_quick_stop()
            return CW_QUICK_STOP if word & NO_COAST_STOP else CW_DISABLE_VOLTAGE
        self.reason = Reason.NOT_OPERATING
        fell_back = (previous is State.OPERATION_ENABLED and now - self._disabled_at >= DISABLE_SHOWN_NS) or (
            state is State.SWITCH_ON_DISABLED and previous is not state and previous in _ABOVE_DISABLED
        )
        if fell_back:
            # The drive took the enable back by itself (enable input, coast, its own doubt): no standing ON restarts it.
            # Its Statusword may be wrong about that: a quick stop changes nothing when it is right.
            self.phase = Phase.LOCKED
            self._doubt = True
            return self._locked(word, state, now)
        if not word & NO_COAST_STOP:
            self.reason = Reason.COAST_STOP
            return CW_DISABLE_VOLTAGE | acknowledge
        if not word & NO_QUICK_STOP:
            self.reason = Reason.QUICK_STOP
            return CW_QUICK_STOP | acknowledge
        if not word & ON or state is State.SWITCH_ON_DISABLED or state is State.NOT_READY_TO_SWITCH_ON:
            return CW_SHUTDOWN | acknowledge
        if state is State.SWITCHED_ON and word & ENABLE_OPERATION:
            return CW_ENABLE_OPERATION | acknowledge
        return CW_SWITCH_ON | acknowledge

    def _enter_ramp_stop(self) -> None:
        self.phase = Phase.RAMP_STOP
        self.reason = Reason.RAMP_STOP
        self._shutting_down = False

    def _enter_quick_stop(self) -> None:
        self.phase = Phase.QUICK_STOP
        self.reason = Reason.QUICK_STOP
        self._standing_since = -1

    def _ramp_stop(self, word: int, state: State, standstill: bool, now: int) -> int:
        self.reason = Reason.RAMP_STOP if self._connected else Reason.PLC_LOST
        if state is State.QUICK_STOP_ACTIVE:
            self._enter_quick_stop()
            return self._quick_stop(word, state, standstill, now)
        if state is not State.OPERATION_ENABLED:
            self.phase = Phase.LOCKED
            return self._locked(word, state, now)
        if self._connected:
            if not word & NO_COAST_STOP:
                self.phase = Phase.LOCKED
                self.reason = Reason.COAST_STOP
                return CW_DISABLE_VOLTAGE
            if not word & NO_QUICK_STOP:
                self._enter_quick_stop()
                return CW_QUICK_STOP
            if word & _OFF_MASK == _OFF:
                self._off_seen = True
            # After a loss the ON that stands in the new connection does not resume: it needs its own OFF first.
            if self._resume and self._off_seen and word & _COMMAND == _COMMAND and not self._shutting_down:
                self.phase = Phase.FOLLOW
                self.reason = None
                return CW_ENABLE_OPERATION
        if standstill or self._shutting_down:
            self._shutting_down = True
            return CW_SHUTDOWN
        return CW_ENABLE_OPERATION

    def _quick_stop(self, word: int, state: State, standstill: bool, now: int) -> int:
        self.reason = Reason.QUICK_STOP if self._connected else Reason.PLC_LOST
        if state is not State.QUICK_STOP_ACTIVE and state is not State.OPERATION_ENABLED:
            self.phase = Phase.LOCKED
            return self._locked(word, state, now)
        if self._connected:
            if not word & NO_COAST_STOP:
                return CW_DISABLE_VOLTAGE
            if state is State.QUICK_STOP_ACTIVE and word & _COMMAND == _DISABLE_OPERATION:
                return CW_DISABLE_VOLTAGE
        if not standstill or state is not State.QUICK_STOP_ACTIVE:
            self._standing_since = -1
        elif self._standing_since < 0:
            self._standing_since = now
        elif now - self._standing_since >= QUICK_STOP_STANDING_NS:
            return CW_DISABLE_VOLTAGE
        return CW_QUICK_STOP


_POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
_ABOVE_DISABLED = (
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.OPERATION_ENABLED,
    State.QUICK_STOP_ACTIVE,
)

ZSW1_TRANSPARENT = StatusBit.VOLTAGE_ENABLED | StatusBit.NO_QUICK_STOP | StatusBit.WARNING | StatusBit.REMOTE | 0xC000
"""Statusword bits 4, 5, 7, 9, 14 and 15 pass to ZSW1 unchanged (docs/telegrams.md, ZSW1)."""

_ZSW1_OF_STATE: dict[State | None, int] = {
    State.NOT_READY_TO_SWITCH_ON: 0x00,
    State.SWITCH_ON_DISABLED: 0x40,
    State.READY_TO_SWITCH_ON: 0x01,
    State.SWITCHED_ON: 0x03,
    State.OPERATION_ENABLED: 0x07,
    # Quick stop: bit 2 is 0 in ZSW1 although it is 1 in the Statusword.
    State.QUICK_STOP_ACTIVE: 0x03,
    State.FAULT_REACTION_ACTIVE: 0x0F,
    State.FAULT: 0x08,
    # A Statusword no state has: reported as a fault, the axis is being stopped.
    None: 0x08,
}
ZSW1_STATE = tuple(_ZSW1_OF_STATE[state] for state in STATE_OF_STATUS)
"""ZSW1 bits 0-3 and 6 by Statusword & 7Fh."""
ZSW1_STOPPING = _ZSW1_OF_STATE[State.QUICK_STOP_ACTIVE]
"""The state bits of a ramp stop."""
ZSW1_FAULT = _ZSW1_OF_STATE[State.FAULT]
