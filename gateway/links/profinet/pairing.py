"""Both cyclic frames of a PROFINET relationship in one turn of the loop, because a wake of the process is expensive.

The gateway's timer for the input frame is moved to shortly after the controller's frame. That frame waits in the socket and is
processed when the input frame is due, which contains its answer. In short cycles the frames of the buses wait too, and the loop
wakes earlier by the time that it needs to read them. A later frame of the controller wakes the loop. From time to time the loop
also waits for the frame to measure the drift of the two clocks.
"""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import MS
from pdgw.gateway.links.profinet.ethernet import EthernetPort
from pdgw.profinet.connection.ppm import Provider

LONGEST_NS: Final = 8 * MS
"""Frames of longer cycles are not paired: they wake the process seldom, and an alarm or a frame out of its time, which waits
for the next input frame too, would wait for long."""
_SHORT_NS: Final = 4 * MS
"""Frames of the buses wait for those of such cycles at most."""
_WAIT_NS: Final = MS // 10
"""Waiting time of a punctual frame; the jitter of controllers is smaller."""
_LOOK_NS: Final = 500 * MS
"""Interval of this measurement: clocks may drift by some 50 us each second."""


class Pairing:
    """When the frames of one relationship are taken together. Both have the provider's cycle. Times: monotonic nanoseconds."""

    def __init__(self, port: EthernetPort, provider: Provider) -> None:
        self.together = False
        """The controller's frame is processed when the input frame is due, without a wake of its own."""
        self.answering = False
        """The input frame is due, and is sent as soon as it contains the answer to the frame that was read for it."""
        self._port = port
        self._provider = provider
        self._cycle = provider.cycle_ns
        self._wait = min(_WAIT_NS, self._cycle // 8)
        self._most = self._cycle >> 6
        self._woken = 0
        self._reading = 0
        """Average time from the wake until the controller's frame is read."""
        self._fits = False
        """The last frame came when it should."""
        self._look_at = 0

    @property
    def is_short(self) -> bool:
        """Frames of the buses can wait for the next cycle."""
        return self.together and self._cycle <= _SHORT_NS

    @property
    def lead(self) -> int:
        """The time before an input frame at which the frames that wait for it are read."""
        return min(self._reading, self._cycle // 4) if self.is_short else 0

    def wake(self, deadline: int) -> int:
        """When the loop wakes for what is due at ``deadline``: earlier for the input frame."""
        return deadline - self.lead if deadline == self._provider.due else deadline

    def came(self, now: int) -> None:
        """A frame woke the loop: the input frames are moved to where it is not necessary."""
        # Input frames cannot overtake frames of the controller, so each step of the axes keeps one answer.
        late = (self._provider.due - now) % self._cycle - self._wait
        self._provider.move(-max(-self._most, min(self._most, late // 2)))
        self._fits = abs(late) <= self._wait // 2

    def due(self, now: int) -> bool:
        """Before an input frame is sent: whether the controller's frame must be processed now."""
        if now < self._provider.due - self.lead:
            return False
        self._woken = now
        if self._fits:  # this cycle's frame was used on arrival, the next one will wait
            self.together, self._fits = True, False
            self._look_at = now + _LOOK_NS
            self._port.listen(on=False)
            return False
        return self.together

    def again(self, now: int) -> bool:
        """The controller's frame was not among the queued ones at ``now``, and may still come before the input frame is due."""
        return self.together and now < self._provider.due

    def taken(self, now: int, *, found: bool) -> None:
        """The queued frames were read at ``now``. ``found``: the controller's frame was among them."""
        if found:
            self._reading += (now - self._woken - self._reading) // 8
        if not found or now >= self._look_at:
            self.end()

    def end(self) -> None:
        """The next frame wakes the loop."""
        self._fits = False
        if self.together:
            self.together = False
            self._port.listen(on=True)
