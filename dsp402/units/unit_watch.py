"""Objects of a drive to read again in operation: those that define its units, and its position if no TPDO contains it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.objects import ObjectAddress
from pdgw.dsp402 import objects

_FAST_NS: Final = 50 * MS
_BEGINNING_NS: Final = 2 * SECOND
"""Time after the first motion command in which wrong units must be detected."""
_SLOW_NS: Final = 100 * MS
_PATIENCE_NS: Final = 200 * MS
_POSITION: Final = (objects.POSITION_ACTUAL, 0)
_WATCHED: Final = (
    objects.SI_UNIT_VELOCITY,
    objects.VELOCITY_FACTOR,
    objects.VELOCITY_ENCODER_FACTOR,
    objects.VELOCITY_NOTATION,
    objects.VELOCITY_DIMENSION,
    objects.VELOCITY_ENCODER_RESOLUTION,
    objects.POSITION_ENCODER_RESOLUTION,
    objects.GEAR_RATIO,
    objects.FEED_CONSTANT,
    objects.POSITION_FACTOR,
    objects.VL_SETPOINT_FACTOR,
    objects.VL_DIMENSION_FACTOR,
    objects.SI_UNIT_POSITION,
    objects.POSITION_NOTATION,
    objects.POSITION_DIMENSION,
    objects.POLARITY,
    objects.POSITION_RANGE_LIMIT,
)
"""Objects that define the units of velocities and positions, their sign and their wrap; the likeliest first."""


class UnitWatch:
    """Monitors the unit objects of one drive, from one description to the next."""

    def __init__(self, answers: Mapping[ObjectAddress, int]) -> None:
        self._turn = [address for index in _WATCHED for address in sorted(answers) if address[0] == index]
        self.last_values = {address: answers[address] for address in self._turn}
        """The last value of each of these objects."""
        self.position_missing = False
        """False: the position is in a TPDO, or the drive has none."""
        self.read_ns = 0
        """When the position was read last; 0 never."""
        self.asked: ObjectAddress | None = None
        """Pending request,"""
        self.asked_ns = 0
        """and when."""
        self.changed = False
        """An object has another value than before: all of them must be read again."""
        self._begun = self._due = 0
        self._positions = 0

    def is_due(self, now: int, *, operates: bool, moves: bool) -> bool:
        """Whether something has to be read. ``operates``: the drive is commanded to be in operation, ``moves``: also to move."""
        self._begun = (self._begun or now) if moves else 0
        due = self._due if self.asked is None else self.asked_ns + _PATIENCE_NS
        return (moves or operates) and now >= due

    def next_object(self, now: int) -> ObjectAddress | None:
        """The object whose turn it is, position and units in turns; None for a drive that has neither."""
        self._due = now + (_FAST_NS if now - self._begun < _BEGINNING_NS else _SLOW_NS)
        self._positions ^= 1
        if not self.position_missing and (self._positions or not self._turn):
            self.asked = _POSITION
        elif self._turn:
            self._turn.append(self._turn.pop(0))
            self.asked = self._turn[-1]
        else:
            self.asked = None
        self.asked_ns = now
        return self.asked

    def discard(self, address: ObjectAddress) -> None:
        """The drive does not have the object."""
        if address == _POSITION:
            self.position_missing = True
        else:
            self._turn.remove(address)
