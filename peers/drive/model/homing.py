"""Homing of the simulated drive; the sources are those of ``modes``."""

from __future__ import annotations

import math

from pdgw.dsp402.objects import HOMING_ACCELERATION, HOMING_SPEEDS, MAX_ACCELERATION
from pdgw.dsp402.objects import NEGATIVE_LIMIT_SWITCH as NEGATIVE_LIMIT
from pdgw.dsp402.objects import POSITIVE_LIMIT_SWITCH as POSITIVE_LIMIT
from pdgw.dsp402.states import ControlBit, StatusBit
from pdgw.peers.drive.model.image import DriveImage
from pdgw.peers.drive.model.mode_of_operation import ModeOfOperation
from pdgw.peers.drive.model.ramps import INCREMENTS_PER_REVOLUTION
from pdgw.peers.drive.objects import HOMING_METHODS


class Homing(ModeOfOperation):
    """The homing methods of the family. They search limit switches, index pulses and mechanical stops."""

    def __init__(self, drive: DriveImage) -> None:
        super().__init__(drive)
        self._phase = ""
        self._attained = self._error = False
        self._reached = True
        self._index_from = 0.0

    @property
    def slow_down_rate(self) -> float:
        return self.drive.acceleration(self.drive.read(HOMING_ACCELERATION, 0), MAX_ACCELERATION)

    def selected(self) -> None:
        self.disabled()
        self._attained = self._error = False
        self._reached = True

    def enabled(self) -> None:
        self._reached = True

    def disabled(self) -> None:
        self._phase = ""

    def condition(self) -> tuple[object, ...]:
        return self._phase, self._attained, self._error, self._reached

    def bits(self, halted: bool, units: int) -> int:
        bits = 0
        if self._attained:
            bits |= StatusBit.MODE_12
        if self._error:
            bits |= StatusBit.MODE_13
        return bits | StatusBit.TARGET_REACHED if self._reached or (halted and units == 0) else bits

    def command(self, word: int, previous: int) -> None:
        if self._rises(word, previous) and self._allowed(word, previous):
            self._start()
        elif not word & ControlBit.NEW_SETPOINT and self._phase:
            self._phase = "stopping"

    def _start(self) -> None:
        self.drive.started += 1
        self._attained = self._error = False
        self._reached = False
        method = self.drive.homing_method
        if method not in HOMING_METHODS:
            self._error = True
        elif method == 35:
            self._home_here()
        else:
            self._phase = "search"

    def _home_here(self) -> None:
        self.drive.home_here()
        self._phase = ""
        self._attained = True
        self._reached = True

    def move(self) -> None:
        drive, phase = self.drive, self._phase
        acceleration = self.slow_down_rate
        if not phase or phase == "stopping" or drive.halted:
            if drive.slow_down(drive.halt_rate(acceleration) if drive.halted else acceleration):
                self._reached = self._reached or not phase or drive.halted
                if phase == "stopping":
                    self._phase = ""
                    self._reached = True
            return
        method = drive.homing_method
        direction = -1.0 if method in {1, 17, -17} else 1.0
        fast, slow = (min(drive.read(HOMING_SPEEDS, sub) * drive.unit, drive.speed_limit) for sub in (1, 2))
        on_switch = bool(drive.digital_inputs & (NEGATIVE_LIMIT if direction < 0 else POSITIVE_LIMIT))
        if phase == "search":
            self._search(direction, fast, acceleration, on_switch)
        elif phase == "leave":
            drive.ramp.linear(-direction * slow, acceleration, acceleration)
            if not on_switch and drive.ramp.speed * direction < 0:
                if method in {1, 2}:
                    self._phase = "index"
                    self._index_from = drive.machine_position
                else:
                    self._home_here()
        elif phase == "index":
            drive.ramp.linear(-direction * slow, acceleration, acceleration)
            before = math.floor(self._index_from / INCREMENTS_PER_REVOLUTION)
            after = math.floor(drive.machine_position / INCREMENTS_PER_REVOLUTION)
            if before != after:
                drive.machine_position = float(max(before, after) * INCREMENTS_PER_REVOLUTION)
                self._home_here()

    def _search(self, direction: float, speed: float, acceleration: float, on_switch: bool) -> None:
        """Move to the limit switch or the mechanical stop. A missing switch is a homing error."""
        drive = self.drive
        at_stop = drive.machine_position == drive.machine.stop(direction)
        if drive.homing_method < 0:
            if at_stop:
                self._home_here()
                return
        elif on_switch:
            if drive.slow_down(acceleration):
                self._phase = "leave"
            return
        elif at_stop:
            self._phase = ""
            self._error = True
            drive.ramp.set(0.0)
            return
        drive.ramp.linear(direction * speed, acceleration, acceleration)
