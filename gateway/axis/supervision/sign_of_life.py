"""Sign of life of a drive's telegram: bits 12-15 of STW2 and ZSW2, monitored with P925.

Source: PROFIdrive profile 4.1 (P925), docs/motion.md "Sign of life". Monitoring and answers start with the first counter of the
PLC.
"""

from __future__ import annotations

from collections.abc import Sequence

from pdgw.profidrive.sign_of_life import HIGHEST, SignOfLife
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import Telegram

_SHIFT = signal("STW2").bit("SIGN_OF_LIFE").position
"""In ZSW2 too (a test)."""


class SignOfLifeWords:
    """The two words of one axis."""

    def __init__(self, telegram: Telegram, failures: int) -> None:
        self._stw2 = telegram.setpoints.index("STW2")
        self._zsw2 = telegram.actuals.index("ZSW2")
        self.counters = SignOfLife(failures)

    @property
    def lost(self) -> bool:
        """There is no PLC: more failures in succession than tolerated."""
        return self.counters.failed

    def tolerate(self, failures: int) -> None:
        """P925; the count starts again."""
        self.counters = SignOfLife(failures)

    def step(self, setpoints: Sequence[int] | None, actuals: list[int]) -> bool:
        """One cycle: sets ZSW2; True when the sign of life was lost in it."""
        counters = self.counters
        if setpoints is None:
            counters.reset()
            actuals[self._zsw2] = 0
            return False
        received = setpoints[self._stw2] >> _SHIFT & HIGHEST
        if not received and not counters.due:
            actuals[self._zsw2] = 0
            return False
        was_lost = counters.failed
        actuals[self._zsw2] = counters.step(received) << _SHIFT
        return counters.failed and not was_lost
