"""What must never happen to an axis, checked on every step. Imports nothing of the power table or the interlock.

Source: PROFIdrive profile 4.1 (state machine of the drive, OFF1 to OFF3), docs/translation.md "States", "Standard telegrams" and
"Loss and doubt", docs/safety.md.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import NamedTuple

from pdgw.dsp402.states import State, StatusBit, state_of
from pdgw.workshop.walk.plc import ACKNOWLEDGE, CONTROL, ENABLES_SETPOINT
from pdgw.workshop.walk.values import Output, Plc, Shown

_POWER = 0xF
_SWITCH_ON, _ENABLE = 0x7, 0xF
_VOLTAGE, _NO_QUICK_STOP = 0x2, 0x4
_DISABLE = 0x8
_OFF, _ON = 0x6, 0x7
"""Bits 0-2 of STW1."""
_RESET = 0x80
_OPERATION_ENABLED, _FAULT = 0x4, 0x8
"""Of ZSW1."""
_CERTAIN = 3
"""So many Enable Operation in succession, and the drive has had one."""
_UNPOWERED = (
    State.NOT_READY_TO_SWITCH_ON,
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
)
_FAULTY = (State.FAULT, State.FAULT_REACTION_ACTIVE)


class Rule(enum.Enum):
    """What is checked."""

    ENABLE = "Enable Operation only on the PLC's ON, after an OFF in this connection and after the last doubt"
    SWITCH_ON = "Switch On only on the PLC's ON, after an OFF in this connection and after the last doubt"
    KEPT = "Enable Operation is kept only in operation or for a ramp"
    MOTION = "no setpoint without operation, and none but 0 on a ramp"
    RAMP = "OFF1 and a loss with a ramp keep the power on until standstill"
    OFF2 = "OFF2 takes the voltage off in the same step, in every state"
    OFF3 = "OFF3 and a loss with a quick stop brake in the same step"
    LATCH = "a quick stop is not cut short"
    DOUBT = "a lost drive, or one of no state, is sent Quick Stop (coasting goes first)"
    OPERATES = "ZSW1.2 only with Operation Enabled commanded and shown"
    REACHED = "ZSW1.10 only when the setpoint sent is the PLC's and the drive is in operation"
    REASON = "every refusal has a reason"
    GUARD = "the guard behind everything has nothing to stop"
    RESET = "Fault Reset only with an edge of the PLC in this connection"


@dataclass(frozen=True, slots=True)
class Expected:
    """What the user chose, as far as the rules depend on it."""

    loss: State | None = State.QUICK_STOP_ACTIVE
    """OPERATION_ENABLED: a ramp; QUICK_STOP_ACTIVE; None: to coast."""
    resume: bool = False
    hold: bool = False
    """STW1.10 = 0 holds the last valid words."""


class Memory(NamedTuple):
    """What the rules remember from step to step."""

    connected: bool = False
    """There was a frame with control in the present connection."""
    released: bool = False
    """An OFF was seen in the present connection after the last doubt."""
    enables: int = 0
    """Enable Operation in succession, up to ``_CERTAIN``."""
    ramp: bool = False
    """It is kept for a ramp."""
    coasts: bool = False
    """OFF2 or Disable Operation in a stop, and the drive has not shown that it is off since."""
    brakes: bool = False
    """OFF3 or a loss with quick stop, and no drive without power since."""
    operated: bool = False
    """The drive showed operation."""
    idle: bool = False
    """STW1.7 was 0 in this connection."""
    reset: bool = False


class Monitor:
    """Checks one step after the other."""

    def __init__(self, expected: Expected) -> None:
        self._expected = expected

    def step(self, memory: Memory, plc: Plc, shown: Shown, output: Output) -> tuple[Memory, tuple[Rule, ...]]:
        """The memory after the step, and the rules that it breaks."""
        expected, word, cw = self._expected, plc.word, output.controlword
        power = cw & _POWER
        control = plc.setpoints is not None and word & CONTROL != 0
        connected = plc.setpoints is not None and (memory.connected or control)
        state = state_of(shown.statusword) if shown.ok else None
        unknown = not shown.ok or state is None
        fault = state in _FAULTY
        operates = state is State.OPERATION_ENABLED
        unpowered = state in _UNPOWERED
        gone = not connected
        # What is asked.
        coast = (connected and not word & _VOLTAGE) or (gone and expected.loss is None)
        brake = (connected and word & _OFF == _VOLTAGE | (word & 1)) or (
            gone and expected.loss is State.QUICK_STOP_ACTIVE
        )
        brake = brake and not coast
        disable = connected and not word & _DISABLE  # ends a ramp and a quick stop at once (S5)
        off = control and word & _ON == _OFF
        on = control and word & _ON == _ON
        enable = on and word & _POWER == _ENABLE
        hold = expected.hold and connected and not control and word & _ON == _ON
        ramps = (connected and word & _ON == _OFF) or (gone and expected.loss is State.OPERATION_ENABLED)
        ramps = ramps or (connected and not control and not hold and not coast and not brake)
        # What forbids a start.
        certain = memory.enables == _CERTAIN
        left = memory.operated and certain and (unpowered or state is State.QUICK_STOP_ACTIVE)
        doubt = unknown or fault
        kept = power == _ENABLE and memory.enables > 0
        goes_on = hold and kept and not memory.ramp
        # A restart, and a drive that left operation, come before the frame of the same cycle.
        released = off or (memory.released and not shown.restarted and not left)
        released = released and not (gone or doubt or coast or brake)
        if not control and not goes_on:
            released = False
        commanded = power == _ENABLE and released and (enable or goes_on)
        ramp = power == _ENABLE and not commanded
        broken: list[Rule] = []
        if power == _ENABLE and not kept and not (enable and released):
            broken.append(Rule.ENABLE)
        if power == _SWITCH_ON and not (on and released):
            broken.append(Rule.SWITCH_ON)
        if ramp and kept and (coast or brake or doubt or not (ramps or memory.ramp)):
            broken.append(Rule.KEPT)
        if output.velocity and not commanded:
            broken.append(Rule.MOTION)
        turning = operates and shown.velocity != 0
        stopping = doubt or memory.brakes or disable
        if ramps and turning and memory.enables and not stopping and power != _ENABLE:
            broken.append(Rule.RAMP)
        if coast and cw & _VOLTAGE:
            broken.append(Rule.OFF2)
        is_quick_stop = cw & _OFF & ~1 == _VOLTAGE
        no_power = unpowered or fault or memory.coasts or state is State.QUICK_STOP_ACTIVE or shown.restarted
        voltage_off = not cw & _VOLTAGE
        if brake and memory.connected and not is_quick_stop and not (voltage_off and (no_power or disable)):
            broken.append(Rule.OFF3)
        may_coast = coast or memory.coasts or disable
        if memory.brakes and operates and not is_quick_stop and not (voltage_off and may_coast):
            broken.append(Rule.LATCH)
        if (
            unknown
            and not shown.restarted
            and not is_quick_stop
            and not ((coast or memory.coasts or (brake and disable)) and voltage_off)
        ):
            broken.append(Rule.DOUBT)
        if output.guarded:
            broken.append(Rule.GUARD)
        if output.zsw1 & _OPERATION_ENABLED and not output.zsw1 & _FAULT and not (operates and commanded):
            broken.append(Rule.OPERATES)
        wanted = plc.setpoints[1] if plc.setpoints is not None and word & ENABLES_SETPOINT == ENABLES_SETPOINT else 0
        follows = operates and commanded and (output.velocity != 0) == (wanted != 0)
        if output.zsw1 & StatusBit.TARGET_REACHED and not follows:
            broken.append(Rule.REACHED)
        if not output.reason and not (commanded and operates and (output.velocity != 0) == (wanted != 0)):
            broken.append(Rule.REASON)
        asks_reset = connected and word & ACKNOWLEDGE != 0
        if cw & _RESET and not memory.reset and not (asks_reset and memory.idle):
            broken.append(Rule.RESET)
        after = Memory(
            connected,
            released and (expected.resume or not ramp),
            min(memory.enables + 1, _CERTAIN) if power == _ENABLE else 0,
            ramp,
            coast or ((memory.coasts or (disable and voltage_off)) and not (unpowered or fault)),
            (brake or memory.brakes) and not (unpowered or fault or coast),
            operates,
            connected and (not asks_reset or memory.idle),
            cw & _RESET != 0,
        )
        return after, tuple(broken)
