"""What the walk sees of the power stage in each step, for the safety rules; without the power table and the interlock."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any, NamedTuple

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import STATE_OF_STATUS, ControlBit, State, StatusBit
from pdgw.gateway.axis.settings import PlcLossReaction
from tests.long.rules import ENABLE, FAULTY, UNPOWERED, ZSW1_FAULT, Rule, Seen, broken
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
from tests.long.walk.values import Answered, Life, Output, Plc, Shown

_SWITCH_ON, _OFF, _ON = 0x7, 0x6, 0x7
_VOLTAGE, _STOPS, _DISABLE = 0x2, 0x6, 0x8
"""Bits of STW1 and of the Controlword."""
_CERTAIN = 3
"""After this number of consecutive Enable Operation the drive has received one."""
_DEAD = (State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED, *FAULTY)
"""States without power that a delayed Enable Operation cannot leave."""
_ANSWERS, _OLD, _BLIND = 2, 2, 2
"""Answers of a standstill; steps after which an answer is old; steps in which a ramp continues without one."""
_BELOW = (State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON)
"""States below Switched On."""


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
    on_steps: int = 0
    """Steps in which a drive below Switched On follows an ON."""
    by_sdo: bool = False
    """The speed of the drive is read by SDO: a ramp ends after two answers to requests since it began."""


class Stopping(enum.Enum):
    """The stop that the PLC, or its loss, asks for."""

    NONE = ""
    RAMP = "OFF1"
    BRAKE = "OFF3"


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
    waits: int = 0
    """Steps in which the PLC sends ON and the drive is below Switched On, up to the first in which the ON is used up."""
    stopping: Stopping = Stopping.NONE
    """With ``by_sdo``,"""
    steps: int = 0
    """steps since it began, up to the first in which a ramp without a known speed may end;"""
    still: int = 0
    """answers since then in succession, up to two, that showed standstill;"""
    aged: int = 2
    """and steps since the last request, up to the first in which its answer is old."""
    halting: int = 0
    """Steps in which an axis with tasks turned in spite of Halt, up to the first that is too late: it may get Quick Stop."""


class _Asked:
    """The command of one frame, or its absence."""

    def __init__(self, expected: Expected, memory: Memory, plc: Plc) -> None:
        word, raw = plc.word, expected.raw
        there = plc.setpoints is not None
        self.lives, self.missed = _life(expected, memory, plc)
        alive = there and not (self.lives and expected.life is not None and self.missed > expected.life)
        self.control = alive and (raw or word & CONTROL != 0)
        self.connected = alive and (memory.connected or self.control)
        self.lost = None if self.connected else expected.loss
        """The reaction to the lost PLC."""
        self.off = self.control and word & _ON == _OFF
        self.on = self.control and word & _ON == _ON
        self.enable = self.on and word & _DISABLE != 0
        self.reset = self.control and word & ACKNOWLEDGE != 0
        self.hold = expected.hold and self.connected and not self.control and word & _ON == _ON
        # OFF2 and OFF3 are valid in every frame, also without sign of life, or without control after a loss.
        self.coast = (there and not word & _VOLTAGE) or self.lost is PlcLossReaction.COAST
        off3 = there and word & _STOPS == _VOLTAGE
        self.brake = (off3 or self.lost is PlcLossReaction.QUICK_STOP) and not self.coast
        self.stops = there and self.brake
        """Stopped by a frame, not by a loss."""

    def stop(self, memory: Memory, plc: Plc, *, raw: bool) -> None:
        """The ramp, and what ends a stop."""
        word, connected = plc.word, self.connected
        self.begins = self.brake and not memory.quick_stop
        """The quick stop starts with this frame, so STW1.3 = 0 does not end it."""
        falls = memory.armed and not raw and not self.begins
        self.disable = connected and not word & _DISABLE and (falls or word & _ON == _ON)
        """Ends a ramp and a quick stop at once (S5 of the profile)."""
        off1 = (connected and not raw and word & _ON == _OFF) or self.lost is PlcLossReaction.RAMP
        uncontrolled = connected and not self.control and not self.hold
        self.ramp = (off1 or uncontrolled) and not (self.coast or self.brake)


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
        """The state of the rules after the step, and the broken rules."""
        step = _Step(self._expected, memory, plc, shown, output)
        step.release()
        step.power_stage()
        step.stop()
        step.status()
        after = step.following()
        if self._expected.tasks:
            after = after._replace(**step.task())
        else:
            step.speed()
        return after, broken(step.seen)


class _Step:
    """One step: what was seen, and the memory after it."""

    def __init__(self, expected: Expected, memory: Memory, plc: Plc, shown: Shown, output: Output) -> None:
        self.expected, self.memory, self.plc, self.shown, self.output = expected, memory, plc, shown, output
        self.asked = _Asked(expected, memory, plc)
        self.asked.stop(memory, plc, raw=expected.raw)
        self.power = output.controlword & ENABLE
        self.stopping, self.steps, self.still, self.aged = Stopping.NONE, 0, 0, _OLD
        state = STATE_OF_STATUS[shown.statusword & 0x7F] if shown.ok else None
        self.uncertain = state is None or state in FAULTY
        self.in_operation = state is State.OPERATION_ENABLED
        self.stops = self.asked.coast or self.asked.brake or self.uncertain
        self.seen = Seen(output.controlword, state, reason=bool(output.reason), guarded=output.guarded)

    def release(self) -> None:
        """Whether the PLC may start the drive, and why Enable Operation is sent."""
        asked, memory, state, power = self.asked, self.memory, self.seen.state, self.power
        # Reasons that forbid a start. A restart, or a drive that left operation, precedes the frame of the same cycle.
        fell = state in UNPOWERED or state is State.QUICK_STOP_ACTIVE
        left = memory.operated and memory.enables == _CERTAIN and fell
        goes_on = asked.hold and power == ENABLE and memory.enables > 0 and not memory.ramp
        used_up = memory.waits > 0 and memory.waits >= self.expected.on_steps
        released = asked.off or (memory.released and not (self.shown.restarted or left or used_up))
        self.released = released and asked.connected and not self.stops and (asked.on or asked.off or goes_on)
        self.commanded = power == ENABLE and self.released and (asked.enable or goes_on)
        self.ramp = power == ENABLE and not self.commanded

    def power_stage(self) -> None:
        """Enable Operation, and what allows it."""
        asked, memory, seen, enables = self.asked, self.memory, self.seen, self.power == ENABLE
        kept = enables and memory.enables > 0
        seen.energizes = self.power == _SWITCH_ON or (enables and not kept)
        seen.on = asked.enable if enables else asked.on
        seen.released = self.released
        seen.held = self.ramp and kept
        seen.may_hold = not self.stops and (asked.ramp or memory.ramp)
        seen.resets = self.output.controlword & ControlBit.FAULT_RESET != 0 and not memory.reset
        seen.acknowledges = asked.reset and (memory.idle or self.expected.raw)

    def stop(self) -> None:
        """The stops that the PLC asks for, or its loss."""
        asked, memory, seen = self.asked, self.memory, self.seen
        turns = self._may_turn() if self.expected.by_sdo else self.shown.velocity != 0
        stopping = self.uncertain or self.shown.restarted or memory.brakes or memory.coasts or asked.disable
        stuck = max(memory.entering, memory.halting) > self.expected.enter_steps
        seen.ramps = asked.ramp and self.in_operation and turns and memory.enables > 0 and not (stopping or stuck)
        seen.off2 = asked.coast
        seen.off3 = asked.brake and (memory.connected or asked.stops)
        seen.may_coast = asked.coast or memory.coasts or asked.disable
        moves = self.in_operation or (seen.state is State.QUICK_STOP_ACTIVE and turns)
        seen.quick_stops = memory.brakes and moves

    def _may_turn(self) -> bool:
        """The speed is read by SDO: a stop has to continue, unless the speed of a ramp was unknown for too long."""
        memory, shown = self.memory, self.shown
        brakes = self.asked.brake or memory.brakes or memory.quick_stop
        ramps = self.asked.ramp or memory.ramp
        self.stopping = Stopping.BRAKE if brakes else Stopping.RAMP if ramps else Stopping.NONE
        self.steps = memory.steps if self.stopping is memory.stopping else 0
        fresh = shown.answered is Answered.FRESH
        answered = fresh or (shown.answered is Answered.LATE and memory.aged > 0)
        self.aged = min((0 if fresh else _OLD - 1) if answered else memory.aged + 1, _OLD)
        still = memory.still if self.steps else 0
        if answered:
            after_order = self.steps > (0 if fresh else 1)
            still = min(still + 1, _ANSWERS) if not shown.velocity and after_order else 0
        self.still = still
        if self.aged < _OLD and still == _ANSWERS:
            return False
        known = self.aged < _OLD and shown.velocity != 0
        return known or brakes or self.steps < _BLIND

    def speed(self) -> None:
        """A telegram with a speed."""
        self.seen.moves = self.output.velocity != 0
        self.seen.ordered = self.commanded or (self.expected.own_ramp and self.ramp) or self.expected.raw

    def task(self) -> dict[str, Any]:
        """A telegram with tasks. Returns the fields of ``Memory`` that it changes."""
        memory, plc, seen, output = self.memory, self.plc, self.seen, self.output
        active = plc.word & FUNCTIONS if self.asked.connected else 0
        operates = self.commanded and self.in_operation
        strobe = output.controlword & ControlBit.NEW_SETPOINT != 0
        homes = strobe and output.mode == Mode.HOMING
        starts = strobe or output.velocity != 0
        given = operates and memory.given and plc.word & DO_NOT_REJECT != 0
        interrupted = given and not plc.word & NO_INTERMEDIATE_STOP
        rises = active & ~memory.active != 0 and memory.connected
        edge = operates and (memory.edge or rises or interrupted)
        withdrawn = (homes and not active & HOME) or (output.velocity != 0 and not active & JOG)
        unanswered = self._unanswered() if strobe and not homes else 0
        seen.moves = starts
        seen.ordered = self.commanded and (memory.started or edge) and not withdrawn
        seen.waits = unanswered > self.expected.answer_steps
        return {
            "active": active,
            "edge": edge and (memory.started or not starts),
            "started": starts,
            "given": given or (edge and starts),
            "unanswered": unanswered,
        }

    def _unanswered(self) -> int:
        taken = self.shown.mode == Mode.POSITION and self.shown.statusword & StatusBit.MODE_12
        if taken or self.memory.unanswered < 0:
            return -1
        return min(self.memory.unanswered, self.expected.answer_steps) + 1

    def status(self) -> None:
        """What ZSW1 and the reason say."""
        expected, output, seen = self.expected, self.output, self.seen
        operates = follows = self.in_operation and self.commanded
        if not expected.tasks and not expected.raw:
            setpoints = self.plc.setpoints
            enabled = setpoints is not None and self.plc.word & ENABLES_SETPOINT == ENABLES_SETPOINT
            setpoint = setpoints[1] if enabled and setpoints is not None else 0
            follows = operates and (self.asked.hold or (output.velocity != 0) == (setpoint != 0))
        seen.zsw1 = output.zsw1 & ZSW1_FAULT if expected.raw else output.zsw1
        # Disable Operation acts when the drive has left operation, not when it is sent.
        disables = self.in_operation and output.controlword & _STOPS == _STOPS
        seen.operates = operates or disables or seen.zsw1 & ZSW1_FAULT != 0
        seen.follows = follows or expected.tasks
        seen.refused = not follows and not (expected.raw and output.controlword == self.plc.word)

    def following(self) -> Memory:
        """The memory after the step, without that of a task."""
        asked, memory, seen = self.asked, self.memory, self.seen
        state, quick_stop = seen.state, seen.controlword & _STOPS == _VOLTAGE
        off = state in UNPOWERED or state in FAULTY
        ends = asked.disable or state is State.QUICK_STOP_ACTIVE
        armed = (asked.connected and self.plc.word & _DISABLE != 0) or (memory.armed and not asked.begins)
        waits = self.released and asked.on and state in _BELOW and not self.expected.raw
        entering = min(memory.entering, self.expected.enter_steps) + 1
        ignored = (
            self.expected.tasks and self.in_operation and self.shown.velocity and seen.controlword & ControlBit.HALT
        )
        return Memory(
            connected=asked.connected,
            released=self.released and (self.expected.resume or not self.ramp),
            enables=min(memory.enables + 1, _CERTAIN) if self.power == ENABLE else 0,
            ramp=self.ramp,
            coasts=(state not in _DEAD or memory.enables > 0)
            and (asked.coast or memory.coasts or (ends and not seen.voltage)),
            brakes=not off and not asked.coast and (asked.brake or memory.brakes),
            operated=self.in_operation,
            idle=asked.control and (not asked.reset or memory.idle),
            reset=seen.controlword & ControlBit.FAULT_RESET != 0,
            quick_stop=quick_stop,
            armed=(self.ramp or quick_stop) and armed,
            lives=asked.lives,
            missed=asked.missed,
            entering=entering if memory.enables and state is State.SWITCHED_ON else 0,
            waits=min(memory.waits + 1, self.expected.on_steps) if waits else 0,
            stopping=self.stopping,
            steps=min(self.steps + 1, _BLIND) if self.stopping is not Stopping.NONE else 0,
            still=self.still,
            aged=self.aged,
            halting=min(memory.halting, self.expected.enter_steps) + 1 if ignored else 0,
        )
