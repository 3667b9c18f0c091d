"""Homing at the edge of a probe, while anything runs: STW1.11 with POS_STW2.8."""

from __future__ import annotations

import enum
from typing import Final

from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.requests import Command

_ON_THE_FLY: Final = Command.START_HOMING | Command.PASSIVE_HOMING


class Progress(enum.Enum):
    """Progress of a passive homing."""

    OFF = "not requested"
    ARMED = "waits for the edge"
    OVER = "has ended, and is still requested"


_OFF, _ARMED, _OVER = Progress.OFF, Progress.ARMED, Progress.OVER


class PassiveHoming:
    """The passive homing of one axis."""

    def __init__(self) -> None:
        self.progress = _OFF
        self.probe: int | Reason | None = None
        """The position at the edge of the armed probe, or why there is none; None: not yet."""

    def step(self, commands: int) -> int | Reason | None:
        """The position or the reason in the step in which the homing ends."""
        if commands & _ON_THE_FLY != _ON_THE_FLY:
            self.progress = _OFF
        elif self.progress is _OFF:
            self.progress = _ARMED
        elif self.progress is _ARMED and self.probe is not None:
            self.progress = _OVER
            return self.probe
        return None

    def drop(self) -> None:
        """Operation has ended."""
        if self.progress is _ARMED:
            self.progress = _OVER
