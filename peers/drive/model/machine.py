"""The machine of a simulated drive, with the limits of its travel."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pdgw.dsp402.objects import NEGATIVE_LIMIT_SWITCH as NEGATIVE_LIMIT
from pdgw.dsp402.objects import POSITIVE_LIMIT_SWITCH as POSITIVE_LIMIT


@dataclass(frozen=True, slots=True)
class Machine:
    """Limits of the simulated axis in increments of the machine (power-on position is 0). A shaft has none."""

    negative_limit: float | None = None
    positive_limit: float | None = None
    negative_stop: float = -math.inf
    positive_stop: float = math.inf

    def stop(self, direction: float) -> float:
        """The mechanical stop in a direction."""
        return self.negative_stop if direction < 0 else self.positive_stop

    def within_stops(self, position: float) -> bool:
        """Whether the position is between the mechanical stops."""
        return self.negative_stop < position < self.positive_stop

    def switches(self, position: float) -> int:
        """The limit switches of 60FDh at a position."""
        inputs = 0
        if self.negative_limit is not None and position <= self.negative_limit:
            inputs |= NEGATIVE_LIMIT
        if self.positive_limit is not None and position >= self.positive_limit:
            inputs |= POSITIVE_LIMIT
        return inputs


ROTARY_AXIS = Machine()
LINEAR_AXIS = Machine(-550_000, 550_000, -600_000, 600_000)
"""A slide with limit switches 134 revolutions away on either side, and mechanical stops beyond them."""
MACHINES = {"rotary": ROTARY_AXIS, "linear": LINEAR_AXIS}
