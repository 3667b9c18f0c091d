"""The touch probe of the simulated drive: 60B8h to 60BDh, with two inputs and the zero pulse of each revolution.

Source: CiA 402-2. Only the first event after arming is stored. The zero pulse is at multiples of a revolution of the
machine's position.
"""

from __future__ import annotations

import math

from pdgw.dsp402.drive import touch_probe
from pdgw.peers.drive.model.image import DriveImage
from pdgw.peers.drive.model.ramps import INCREMENTS_PER_REVOLUTION
from pdgw.peers.drive.model.shapes import POSITIONS


class TouchProbe:
    """The touch probe of a drive. The image has its objects if the variant has them."""

    def __init__(self, drive: DriveImage) -> None:
        self._drive = drive
        self._armed = 0
        self._at_zero_pulse = False
        self._inputs = [False, False]

    def command(self) -> None:
        """60B8h was written: newly enabled functions store a new position."""
        drive = self._drive
        function = drive.touch_probe_function
        kept = 0
        for edge in range(len(touch_probe.POSITIONS)):
            if _waits_for(function, edge) and _waits_for(self._armed, edge):
                kept |= drive.touch_probe_status & touch_probe.stored_bit(edge)
        self._armed = function
        self._at_zero_pulse = function & touch_probe.ZERO_PULSE != 0
        drive.touch_probe_status = touch_probe.enabled_bits(function) | kept

    def set_input(self, probe: int, on: bool) -> None:
        """Deflect or release probe 1 or 2."""
        before, self._inputs[probe - 1] = self._inputs[probe - 1], on
        if on is not before and not (probe == 1 and self._at_zero_pulse):
            self._latch(2 * (probe - 1) + (not on), self._drive.position)

    def turned(self, before: float, after: float) -> None:
        """The machine has moved between two positions (increments)."""
        if not self._at_zero_pulse or before == after:
            return
        passed = math.floor(after / INCREMENTS_PER_REVOLUTION)
        if after < before:
            passed = math.floor(before / INCREMENTS_PER_REVOLUTION)
            if passed * INCREMENTS_PER_REVOLUTION == before:
                passed -= 1
        pulse = passed * INCREMENTS_PER_REVOLUTION
        if min(before, after) <= pulse <= max(before, after) and pulse != before:
            self._latch(0, pulse - self._drive.zero)

    def _latch(self, edge: int, position: float) -> None:
        drive = self._drive
        stored = touch_probe.stored_bit(edge)
        if _waits_for(self._armed, edge) and not drive.touch_probe_status & stored:
            drive.touch_probe_status |= stored
            setattr(drive, POSITIONS[edge], round(position))


def _waits_for(function: int, edge: int) -> bool:
    """Whether 60B8h asks for an edge (0 to 3)."""
    bits = touch_probe.enable_bits(edge)
    return function & bits == bits
