"""Safety rules of an axis, checked on every step, without imports from the power table or the interlock.

Source: PROFIdrive profile 4.1 (state machine of the drive, OFF1 to OFF3), docs/translation.md "States", "Standard telegrams"
and "Losses", docs/safety.md.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import NamedTuple

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import STATE_OF_STATUS, State, StatusBit
from pdgw.gateway.axis.settings import PlcLossReaction
from tests.long.walk.plc import (
    ACKNOWLEDGE,
    CONTROL,
    DO_NOT_REJECT,
    ENABLES_SETPOINT,
    FUNCTIONS,
    HOME,
    JOG,
    NO_INTERMEDIATE_STOP,
)
from tests.long.walk.values import Life, Output, Plc, Shown

_POWER = 0xF
_SWITCH_ON, _ENABLE = 0x7, 0xF
_VOLTAGE, _NO_QUICK_STOP = 0x2, 0x4
_DISABLE = 0x8
_STOPS = _VOLTAGE | _NO_QUICK_STOP
_OFF, _ON = 0x6, 0x7
"""Bits 0-2 of STW1."""
_NEW_SETPOINT = 0x10
_RESET = 0x80
_OPERATION_ENABLED, _FAULT = 0x4, 0x8
"""Bits of ZSW1."""
_CERTAIN = 3
"""After this number of consecutive Enable Operation the drive has received one."""
_UNPOWERED = (
    State.NOT_READY_TO_SWITCH_ON,
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
)
_DEAD = (State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED)
"""States without power that a delayed Enable Operation cannot leave."""
_FAULTY = (State.FAULT, State.FAULT_REACTION_ACTIVE)


class Rule(enum.Enum):
    """The rules."""

    ENABLE = "Enable Operation only on the PLC's ON, after an OFF in this connection and after the last loss or fault"
    SWITCH_ON = "Switch On only on the PLC's ON, after an OFF in this connection and after the last loss or fault"
    KEPT = "Enable Operation is kept only in operation or for a ramp"
    MOTION = "no speed without operation, and none but 0 on a ramp"
    TASK = "a task, a homing and a jog start only in operation, by an edge of the PLC"
    WITHDRAWN = "homing and jog move only while their bit is 1"
    RAMP = "OFF1 and a loss with a ramp keep the power on until standstill"
    OFF2 = "OFF2 takes the voltage off in the same step, in every state"
    OFF3 = "OFF3 and a loss with a quick stop brake in the same step"
    LATCH = "a quick stop is not cut short"
    UNKNOWN = "a lost drive, or one of no state, is sent Quick Stop (coasting goes first)"
    OPERATES = "ZSW1.2 only with Operation Enabled commanded and shown"
    REACHED = "ZSW1.10 only when the setpoint sent is the PLC's and the drive is in operation"
    REASON = "every refusal has a reason"
    UNANSWERED = "a setpoint that the drive does not acknowledge in time has a reason"
    GUARD = "the final guard has nothing to stop"
    RESET = "Fault Reset only with an edge of the PLC in this connection"


@dataclass(frozen=True, slots=True)
class Expected:
    """The telegram and the user's settings that the rules depend on."""

    loss: PlcLossReaction = PlcLossReaction.QUICK_STOP
    resume: bool = False
    """ON during a ramp resumes operation."""
    hold: bool = False
    """STW1.10 = 0 holds the last valid words."""
    raw: bool = False
    """Telegram 100: the Controlword is the PLC's own and OFF1 is a Shutdown."""
    tasks: bool = False
    """Traversing tasks instead of a speed."""
    own_ramp: bool = False
    """The gateway generates the ramps itself."""
    life: int | None = None
    """P925: tolerated consecutive failures of the sign of life; None: not monitored."""
    answer_steps: int = 0
    """Steps in which a drive acknowledges a setpoint."""
    enter_steps: int = 0
    """Steps in which a drive enters operation."""


class Memory(NamedTuple):
    """State of the rules between steps."""

    connected: bool = False
    """A frame with control has arrived in the present connection."""
    released: bool = False
    """An OFF has arrived in the present connection after the last loss or fault."""
    enables: int = 0
    """Consecutive Enable Operation, up to ``_CERTAIN``."""
    ramp: bool = False
    """Enable Operation stays set for a ramp."""
    coasts: bool = False
    """OFF2, Disable Operation during a stop, or the end of a quick stop; the drive has not reported power off since."""
    brakes: bool = False
    """OFF3 or a loss with quick stop; the drive has not reported power off since."""
    operated: bool = False
    """The drive reported operation."""
    idle: bool = False
    """STW1.7 was 0 since the PLC has control in this connection."""
    reset: bool = False
    """The last Controlword had Fault Reset."""
    active: int = 0
    """The bits of STW1 that start a motion by their edge."""
    edge: bool = False
    """One of them rose in operation and no motion has started since, or the motion it started is interrupted."""
    started: bool = False
    """The last command was a motion: New Setpoint, or a speed."""
    given: bool = False
    """A motion has started in the present operation and was not rejected: it continues after an intermediate stop."""
    quick_stop: bool = False
    """The last Controlword was Quick Stop."""
    armed: bool = False
    """STW1.3 was 1 during the present stop, so its fall to 0 ends the stop."""
    lives: bool = False
    """The sign of life has started in this connection."""
    missed: int = 0
    """Its consecutive failures, up to the first that is not tolerated."""
    unanswered: int = 0
    """Steps of New Setpoint without an acknowledge, up to the first that needs a reason; -1 after an acknowledge."""
    entering: int = 0
    """Steps in Switched On after Enable Operation, up to the first that is too late."""


class _Asked:
    """The command of one frame, or its absence."""

    __slots__ = (
        "begins",
        "brake",
        "coast",
        "connected",
        "control",
        "disable",
        "enable",
        "gone",
        "hold",
        "lives",
        "missed",
        "off",
        "on",
        "ramp",
        "reset",
        "stops",
    )

    def __init__(self, expected: Expected, memory: Memory, plc: Plc) -> None:
        word, raw = plc.word, expected.raw
        there = plc.setpoints is not None
        self.lives, self.missed = lives, missed = _life(expected, memory, plc)
        alive = there and not (lives and expected.life is not None and missed > expected.life)
        control = self.control = alive and (raw or word & CONTROL != 0)
        connected = self.connected = alive and (memory.connected or control)
        gone = self.gone = not connected
        # OFF2 and OFF3 are valid in every frame, also without sign of life, or without control after a loss.
        self.coast = (there and not word & _VOLTAGE) or (gone and expected.loss is PlcLossReaction.COAST)
        stop = (there and word & _STOPS == _VOLTAGE) or (gone and expected.loss is PlcLossReaction.QUICK_STOP)
        self.brake = stop and not self.coast
        self.stops = there and self.brake
        """Stopped by a frame, not by a loss."""
        self.begins = self.brake and not memory.quick_stop
        """The quick stop starts with this frame, so STW1.3 = 0 does not end it."""
        falls = memory.armed and not raw and not self.begins
        self.disable = connected and not word & _DISABLE and (falls or word & _ON == _ON)
        """Ends a ramp and a quick stop at once (S5 of the profile)."""
        self.off = control and word & _ON == _OFF
        self.on = control and word & _ON == _ON
        self.enable = self.on and word & _DISABLE != 0
        self.hold = expected.hold and connected and not control and word & _ON == _ON
        off1 = (connected and not raw and word & _ON == _OFF) or (gone and expected.loss is PlcLossReaction.RAMP)
        uncontrolled = connected and not control and not (self.hold or self.coast or self.brake)
        self.ramp = (off1 and not (self.coast or self.brake)) or uncontrolled
        self.reset = control and word & ACKNOWLEDGE != 0


def _life(expected: Expected, memory: Memory, plc: Plc) -> tuple[bool, int]:
    """Whether the sign of life has started, and its consecutive failures."""
    if expected.life is None or plc.setpoints is None:
        return False, 0
    if plc.life is Life.COUNTS:
        return True, 0
    return memory.lives, min(memory.missed + 1, expected.life + 1) if memory.lives else 0


class Monitor:
    """Checks the steps in order."""

    first = Memory()

    def __init__(self, expected: Expected) -> None:
        self._expected = expected

    def step(self, memory: Memory, plc: Plc, shown: Shown, output: Output) -> tuple[Memory, list[Rule]]:
        """The state of the rules after the step, and the violated rules."""
        expected, cw = self._expected, output.controlword
        asked = _Asked(expected, memory, plc)
        power = cw & _POWER
        state = STATE_OF_STATUS[shown.statusword & 0x7F] if shown.ok else None
        operates = state is State.OPERATION_ENABLED
        off = state in _UNPOWERED or state in _FAULTY
        dead = state in _DEAD or state in _FAULTY
        coast, brake = asked.coast, asked.brake
        # Reasons that forbid a start. A restart, or a drive that left operation, precedes the frame of the same cycle.
        fell = state in _UNPOWERED or state is State.QUICK_STOP_ACTIVE
        left = memory.operated and memory.enables == _CERTAIN and fell
        uncertain = state is None or state in _FAULTY
        kept = power == _ENABLE and memory.enables > 0
        goes_on = asked.hold and kept and not memory.ramp
        released = asked.off or (memory.released and not shown.restarted and not left)
        released = released and not (asked.gone or uncertain or coast or brake) and (asked.on or asked.off or goes_on)
        commanded = power == _ENABLE and released and (asked.enable or goes_on)
        ramp = power == _ENABLE and not commanded
        broken: list[Rule] = []
        if power == _ENABLE and not kept and not (asked.enable and released):
            broken.append(Rule.ENABLE)
        if power == _SWITCH_ON and not (asked.on and released):
            broken.append(Rule.SWITCH_ON)
        if ramp and kept and (coast or brake or uncertain or not (asked.ramp or memory.ramp)):
            broken.append(Rule.KEPT)
        self._check_stops(memory, asked, shown, state, output, uncertain, broken)
        self._check_shown(asked, plc, output, operates and commanded, broken)
        if output.guarded:
            broken.append(Rule.GUARD)
        if cw & _RESET and not memory.reset and not (asked.reset and (memory.idle or expected.raw)):
            broken.append(Rule.RESET)
        active = plc.word & FUNCTIONS if asked.connected and expected.tasks else 0
        edge = starts = given = False
        unanswered = 0
        if expected.tasks:
            starts = cw & _NEW_SETPOINT != 0 or output.velocity != 0
            given = commanded and operates and memory.given and plc.word & DO_NOT_REJECT != 0
            interrupted = given and not plc.word & NO_INTERMEDIATE_STOP
            rises = active & ~memory.active != 0 and memory.connected
            edge = commanded and operates and (memory.edge or rises or interrupted)
            if starts and not (commanded and (memory.started or edge)):
                broken.append(Rule.TASK)
            homes = cw & _NEW_SETPOINT != 0 and output.mode == Mode.HOMING
            if (homes and not active & HOME) or (output.velocity and not active & JOG):
                broken.append(Rule.WITHDRAWN)
            given = given or (edge and starts)
            edge = edge and not (starts and not memory.started)
            unanswered = self._unanswered(memory, shown, output)
            if unanswered > expected.answer_steps and not output.reason:
                broken.append(Rule.UNANSWERED)
        elif output.velocity and not commanded and not (expected.own_ramp and ramp) and not expected.raw:
            broken.append(Rule.MOTION)
        voltage_off = not cw & _VOLTAGE
        quick_stop = cw & _STOPS == _VOLTAGE
        ends = asked.disable or state is State.QUICK_STOP_ACTIVE
        armed = (asked.connected and plc.word & _DISABLE != 0) or (memory.armed and not asked.begins)
        after = Memory(
            asked.connected,
            released and (expected.resume or not ramp),
            min(memory.enables + 1, _CERTAIN) if power == _ENABLE else 0,
            ramp,
            (not dead or memory.enables > 0) and (coast or memory.coasts or (ends and voltage_off)),
            not off and not coast and (brake or memory.brakes),
            operates,
            asked.control and (not asked.reset or memory.idle),
            cw & _RESET != 0,
            active,
            edge,
            starts,
            given,
            quick_stop,
            (ramp or quick_stop) and armed,
            asked.lives,
            asked.missed,
            unanswered,
            min(memory.entering, expected.enter_steps) + 1 if memory.enables and state is State.SWITCHED_ON else 0,
        )
        return after, broken

    def _unanswered(self, memory: Memory, shown: Shown, output: Output) -> int:
        if not output.controlword & _NEW_SETPOINT or output.mode == Mode.HOMING:
            return 0
        taken = shown.mode == Mode.POSITION and shown.statusword & StatusBit.MODE_12
        if taken or memory.unanswered < 0:
            return -1
        return min(memory.unanswered, self._expected.answer_steps) + 1

    def _check_stops(
        self,
        memory: Memory,
        asked: _Asked,
        shown: Shown,
        state: State | None,
        output: Output,
        uncertain: bool,
        broken: list[Rule],
    ) -> None:
        cw, coast, brake, disable = output.controlword, asked.coast, asked.brake, asked.disable
        operates = state is State.OPERATION_ENABLED
        quick_stop, voltage_off = cw & _STOPS == _VOLTAGE, not cw & _VOLTAGE
        turning = operates and shown.velocity != 0
        stuck = memory.entering > self._expected.enter_steps
        stopping = uncertain or shown.restarted or memory.brakes or memory.coasts or disable or stuck
        if asked.ramp and turning and memory.enables and not stopping and cw & _POWER != _ENABLE:
            broken.append(Rule.RAMP)
        if coast and not voltage_off:
            broken.append(Rule.OFF2)
        may_coast = coast or memory.coasts or disable
        no_power = state in _UNPOWERED or state in _FAULTY or state is State.QUICK_STOP_ACTIVE
        if (
            brake
            and (memory.connected or asked.stops)
            and not quick_stop
            and not (voltage_off and (no_power or may_coast))
        ):
            broken.append(Rule.OFF3)
        moves = operates or (state is State.QUICK_STOP_ACTIVE and shown.velocity != 0)
        if memory.brakes and moves and not quick_stop and not (voltage_off and may_coast):
            broken.append(Rule.LATCH)
        if state is None and not quick_stop and not (voltage_off and may_coast):
            broken.append(Rule.UNKNOWN)

    def _check_shown(self, asked: _Asked, plc: Plc, output: Output, operates: bool, broken: list[Rule]) -> None:
        expected, zsw1 = self._expected, output.zsw1
        follows = operates
        if not expected.tasks and not expected.raw:
            setpoints = plc.setpoints
            enabled = setpoints is not None and plc.word & ENABLES_SETPOINT == ENABLES_SETPOINT
            wanted = setpoints[1] if enabled and setpoints is not None else 0
            follows = operates and (asked.hold or (output.velocity != 0) == (wanted != 0))
        if not expected.raw:
            if zsw1 & _OPERATION_ENABLED and not zsw1 & _FAULT and not operates:
                broken.append(Rule.OPERATES)
            if zsw1 & StatusBit.TARGET_REACHED and not expected.tasks and not follows:
                broken.append(Rule.REACHED)
        passes = expected.raw and output.controlword == plc.word
        if not output.reason and not follows and not passes:
            broken.append(Rule.REASON)
