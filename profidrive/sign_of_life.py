"""Sign of life between controller and device: bits 12-15 of STW2/ZSW2 and STW2_ENC/ZSW2_ENC, in both directions."""

from __future__ import annotations

from pdgw.profidrive.errors import ProfidriveError

HIGHEST = 15
"""The counter runs 1..15; 0 means that the sender has none, or lost it."""
MONITORING_OFF = 65535
"""P925: failures are not counted."""


def following(counter: int) -> int:
    """The counter after ``counter``: 1..15, 15 -> 1."""
    return counter % HIGHEST + 1


class SignOfLife:
    """Monitor the controller's counter and generate the device's own.

    Both start with the controller's first counter other than 0, so a controller without a sign of life is not monitored or
    answered. A counter is correct if it follows the last one, or is the one due after the number of cycles that passed.
    ``failed`` is True after more consecutive failures than tolerated, until 15 consecutive counters are correct: a controller
    that counts too slowly is lost once.
    """

    def __init__(self, tolerated: int) -> None:
        """``tolerated`` is P925: failures in succession that are accepted, 0..65534, or 65535 for no monitoring."""
        if not 0 <= tolerated <= MONITORING_OFF:
            raise ProfidriveError("P925", tolerated, f"0..{MONITORING_OFF}")
        self.tolerated = tolerated
        self.reset()

    def reset(self) -> None:
        """The connection is new: the next counter received is the first."""
        self.failures = 0
        """In succession; it counts up to the first that is not tolerated."""
        self._regained = 0
        """Correct counters in succession after a loss."""
        self.received = 0
        """The controller's counter of the last cycle."""
        self.due = 0
        """Expected next counter; 0 before the controller has started."""
        self._own = 0

    @property
    def failed(self) -> bool:
        """The controller's sign of life is lost (sensor error 0F02h)."""
        return self.tolerated != MONITORING_OFF and self.failures > self.tolerated

    def step(self, received: int) -> int:
        """Take the controller's counter (0..15) of this cycle; returns the device's own, 0 while there is none."""
        if not 0 <= received <= HIGHEST:
            raise ProfidriveError("sign of life", received, f"0..{HIGHEST}")
        if not self.due:
            if not received:
                return 0
            self.due = received
        elif received not in (0, self.received) and received in (following(self.received), self.due):
            self._regained = self._regained + 1 if self.failed else HIGHEST
            if self._regained == HIGHEST:
                self.failures = 0
            self.due = received
        else:
            self._regained = 0
            if self.failures <= self.tolerated:
                self.failures += 1
        self.received = received
        self.due = following(self.due)
        self._own = 0 if self.failed else following(self._own)
        return self._own
