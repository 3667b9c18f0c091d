"""The behaviours of a simulated drive in addition to those of any CANopen node.

Source: CiA DSP 402 V2.0 and the manufacturer's guide. ``peers/habits.toml`` has the habits that are made of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING, Final, cast

from pdgw.base.durations import MS
from pdgw.dsp402.states import UNPOWERED, Command, State, StatusBit
from pdgw.peers.drive.model.latency import DelayLine
from pdgw.peers.drive.model.ramps import TICK
from pdgw.peers.node.behaviour import Behaviour, catalogue
from pdgw.peers.node.node_behaviours import NODE_BEHAVIOURS, NODE_HABITS, Periodic, Reboot
from pdgw.peers.node.object_behaviours import ObjectValue

if TYPE_CHECKING:
    from pdgw.peers.drive.model.model import DriveModel

_UNDER_VOLTAGE: Final = 6
_NOISE_PERIOD: Final = 10 * MS


class DriveBehaviour(Behaviour):
    """A behaviour with access to the model of the drive."""

    @property
    def model(self) -> DriveModel:
        """The model of the node's drive."""
        return cast("DriveModel", self.node.image)


class Transition(DriveBehaviour):
    """The drive needs time for a change of its state."""

    delay_ms = 0
    state = ""
    targets: Sequence[str] = ()

    def begin(self) -> None:
        for target in self.targets:
            self.model.transition_ms[State(self.state), State(target)] = self.delay_ms

    def end(self) -> None:
        for target in self.targets:
            del self.model.transition_ms[State(self.state), State(target)]


class _Disguise(DriveBehaviour):
    """The drive shows other values than its own: ``disguise`` changes its image after each update."""

    def begin(self) -> None:
        self.model.disguises.append(self.disguise)

    def end(self) -> None:
        self.model.disguises.remove(self.disguise)

    def disguise(self, model: DriveModel, now: int) -> None:
        """Change the shown values (``now``: the model's time in ns)."""
        raise NotImplementedError


# -- Statusword and mode --------------------------------------------------------------------------------------------------


class ShownBits(_Disguise):
    """Bits of a value have other values, or (``inverted``) the opposite ones in every second period.

    ``states``, ``mode``, ``standstill``: only in these states, in this mode of operation, at standstill.
    """

    shown = "statusword"
    states: Sequence[str] = ()
    mode = 0
    standstill = False
    mask = 0
    bits = 0
    inverted = False
    period_ms = 0

    def disguise(self, model: DriveModel, now: int) -> None:
        if self.states and model.state.value not in self.states:
            return
        if (self.mode and model.mode != self.mode) or (self.standstill and model.ramp.speed):
            return
        value = getattr(model, self.shown)
        if not self.inverted:
            setattr(model, self.shown, value & ~self.mask | self.bits)
        elif now // (self.period_ms * MS) & 1:
            setattr(model, self.shown, value ^ self.bits)


class LateBits(_Disguise):
    """Bits of a value are late; the first value is shown at once."""

    shown = "statusword"
    delay_ms = 0
    bits = 0xFFFF

    def begin(self) -> None:
        self._line = DelayLine()
        super().begin()

    def disguise(self, model: DriveModel, now: int) -> None:
        value = getattr(model, self.shown)
        late = self._line.show(value, now, self.delay_ms)
        setattr(model, self.shown, value & ~self.bits | late & self.bits)


class Noise(_Disguise):
    """Actual velocity and position differ at random from those of the shaft."""

    rpm = 0
    counts = 0
    _period = -1
    _drawn = 0.0, 0
    """Speed and position of this period."""

    def disguise(self, model: DriveModel, now: int) -> None:
        if self._period != (period := now // _NOISE_PERIOD):
            chance = Random(period)
            drawn = chance.uniform(-self.rpm, self.rpm), chance.randint(-self.counts, self.counts)
            self._period, self._drawn = period, drawn
        rpm, counts = self._drawn
        model.velocity_actual += round(rpm / model.unit)
        model.position_actual += counts


# -- machine and power ----------------------------------------------------------------------------------------------------


class _Load(DriveBehaviour):
    """The machine moves the shaft: ``speed`` is added to that of the ramp in each tick."""

    def begin(self) -> None:
        self.model.loads.append(self.speed)

    def end(self) -> None:
        self.model.loads.remove(self.speed)

    def speed(self, model: DriveModel) -> float:
        """rpm."""
        raise NotImplementedError


class RunsAway(_Load):
    """In operation the shaft accelerates to a speed, whatever the setpoint is, as with wrong motor phases or a wrong direction
    of the encoder. ``braking``: a stop ramp still brakes it, else only a motor without power.
    """

    rpm = 0
    ramp_ms = 0
    braking = 1
    _away: float | None = None

    def speed(self, model: DriveModel) -> float:
        if model.state is State.OPERATION_ENABLED or not (self.braking or model.state in UNPOWERED):
            step = self.rpm / self.ramp_ms
            away = (model.ramp.speed if self._away is None else self._away) + step
            self._away = min(away, self.rpm) if step > 0 else max(away, self.rpm)
            return self._away - model.ramp.speed
        if self._away is not None:
            model.ramp.set(self._away)
            self._away = None
        return 0.0


class TorqueLimit(_Load):
    """The torque is at its limit: the shaft accelerates with ``rpm_s`` at most; 0: a fixed stop holds it.

    ``bit_11`` and ``torque``: whether Statusword.11 and 6078h show it.
    """

    rpm_s = 0
    bit_11 = 1
    torque = 1
    _shaft = 0.0

    def begin(self) -> None:
        super().begin()
        self._shaft = self.model.speed if self.rpm_s else 0.0
        self.model.disguises.append(self._show)

    def end(self) -> None:
        super().end()
        self.model.disguises.remove(self._show)
        self.model.current_actual = 0
        self.model.ramp.set(self._shaft)

    def speed(self, model: DriveModel) -> float:
        ramp, shaft = model.ramp, self._shaft
        operating = model.state is State.OPERATION_ENABLED
        if not operating and model.deviation:
            ramp.set(shaft)  # a stop begins with the speed of the shaft
        slower = operating and ramp.speed * shaft >= 0 and abs(ramp.speed) > abs(shaft)
        reached = min(abs(ramp.speed), abs(shaft) + self.rpm_s * TICK)
        self._shaft = math.copysign(reached, ramp.speed) if slower else ramp.speed
        limited = self._shaft != ramp.speed
        if self.torque:
            model.current_actual = round(math.copysign(model.max_torque, ramp.speed)) if limited else 0
        return self._shaft - ramp.speed

    def _show(self, model: DriveModel, now: int) -> None:
        if self.bit_11 and model.deviation:
            model.statusword |= StatusBit.INTERNAL_LIMIT


class Sags(_Load):
    """The load drops at the start of operation: the shaft turns for some time."""

    rpm = 0
    sag_ms = 0
    _ticks = 0

    def speed(self, model: DriveModel) -> float:
        self._ticks = self._ticks + 1 if model.state is State.OPERATION_ENABLED else 0
        return self.rpm if 0 < self._ticks <= self.sag_ms else 0


class Swings(_Load):
    """The shaft turns to and fro: all the time under power, or (``after_stop``) less and less after each ramp to standstill."""

    rpm = 0
    period_ms = 1
    after_stop = False
    _size = 0.0
    _ticks = 0

    def begin(self) -> None:
        super().begin()
        self._size = 0.0 if self.after_stop else self.rpm

    def speed(self, model: DriveModel) -> float:
        if self.after_stop and model.ramp.speed:
            self._ticks, self._size = 0, math.copysign(self.rpm, model.ramp.speed)
            return 0.0
        before = self._place()
        self._ticks += self.after_stop or model.state not in UNPOWERED
        return self._place() - before

    def _place(self) -> float:
        """Where the shaft is, in ticks at 1 rpm."""
        swings = self._ticks / self.period_ms
        size = self._size * self.period_ms / (2 * math.pi)
        return size * math.exp(-swings if self.after_stop else 0) * math.sin(2 * math.pi * swings)


class MinimumSpeed(ObjectValue, DriveBehaviour):
    """An inverter with a minimum speed. ``turns_at_0``: also at setpoint 0."""

    turns_at_0 = 1

    def begin(self) -> None:
        super().begin()
        self.model.stands_at_setpoint_0 = not self.turns_at_0

    def end(self) -> None:
        super().end()
        self.model.stands_at_setpoint_0 = False


class LimitSwitch(DriveBehaviour):
    """A limit switch is active at the present position: the drive stops motion in that direction."""

    positive = 1

    def begin(self) -> None:
        model = self.model
        self._machine = model.machine
        side = "positive_limit" if self.positive else "negative_limit"
        model.machine = replace(model.machine, **{side: model.machine_position})

    def end(self) -> None:
        self.model.machine = self._machine


class EnableInputDropped(DriveBehaviour):
    """The enable input is 0."""

    def begin(self) -> None:
        self.model.set_enable_input(False)

    def end(self) -> None:
        self.model.set_enable_input(True)


class EnablesItself(Periodic, DriveBehaviour):
    """The drive enters operation by itself, repeatedly."""

    def act(self, now: int) -> None:
        for command in (Command.SHUTDOWN, Command.SWITCH_ON, Command.ENABLE_OPERATION):
            self.model.controlword = command.word
            self.model.command()


class FaultOfDrive(DriveBehaviour):
    """A fault of the manufacturer's table (200Ch). Its cause is present until the habit ends."""

    number = 0

    def begin(self) -> None:
        self.model.inject(self.number)

    def end(self) -> None:
        self.model.causes.discard(self.number)


class UnderVoltage(FaultOfDrive):
    """The DC-link voltage drops: fault 6, and 6079h shows the remaining voltage."""

    number = _UNDER_VOLTAGE
    voltage = 0

    def begin(self) -> None:
        self._before, self.model.dc_link_voltage = self.model.dc_link_voltage, self.voltage
        super().begin()

    def end(self) -> None:
        super().end()
        self.model.dc_link_voltage = self._before


class RebootInMotion(Reboot, DriveBehaviour):
    """The drive restarts while it turns: it is silent, then sends its boot-up message."""

    speed = 0
    _done = False

    def begin(self) -> None:
        """Wait for the motion."""

    def poll(self, now: int) -> None:
        if not self._done and abs(self.model.ramp.speed) > self.speed:
            self._done = True
            super().begin()
        super().poll(now)

    def next_event(self, now: int) -> int | None:
        return now + MS if not self._done and self.model.next_change() is not None else super().next_event(now)


DRIVE_HABITS: Final = {
    **NODE_HABITS,
    **catalogue(
        "drive",
        (
            *NODE_BEHAVIOURS,
            Transition,
            ShownBits,
            LateBits,
            Noise,
            RunsAway,
            TorqueLimit,
            Sags,
            Swings,
            MinimumSpeed,
            LimitSwitch,
            EnableInputDropped,
            EnablesItself,
            FaultOfDrive,
            UnderVoltage,
            RebootInMotion,
        ),
    ),
}
"""All habits of a simulated drive."""
