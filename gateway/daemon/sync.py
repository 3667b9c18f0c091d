"""SYNC of a bus: sent after the RPDOs of each cycle; how evenly, and how old the positions are that setpoints are made from.

Source: CiA 301 (SYNC), docs/motion.md "DSC". SYNC follows the PLC's frame, there is no PLL. What is measured is shown
(``pdgw status``); nothing is decided by it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from pdgw.base.durations import MS, US
from pdgw.ds301.bus.network import CanNetwork
from pdgw.gateway.axis.executors.dsc import DscExecutor
from pdgw.gateway.motion.dsc_setpoint import KPC_PER_UNIT, DscForm
from pdgw.gateway.objects.axis import Axis

_KEPT = 1024
"""Number of newest values for the percentile."""
_PERCENTILE = 99


class Spread:
    """Times in nanoseconds: the 99th percentile of the newest 1024, and the worst there ever was."""

    def __init__(self) -> None:
        self._newest: deque[int] = deque(maxlen=_KEPT)
        self.worst = 0

    def add(self, value: int) -> None:
        """One more."""
        self._newest.append(value)
        self.worst = max(self.worst, value)

    @property
    def p99(self) -> int:
        """0 while there is none."""
        values = sorted(self._newest)
        return values[(len(values) - 1) * _PERCENTILE // 100] if values else 0


class SyncProducer:
    """The SYNC of one bus; ``axes``: those on it that take their setpoints with it."""

    def __init__(self, network: CanNetwork, period_ns: int, axes: Sequence[Axis], clock: Callable[[], int]) -> None:
        self.network = network
        self.period_ns = period_ns
        self.jitter = Spread()
        """Deviation of the intervals from the period."""
        self.dead_times: dict[int, Spread] = {axis.do_id: Spread() for axis in axes}
        """Dead times by DO: from the SYNC that samples a position to the middle of the period in which the resulting setpoint
        acts."""
        self._axes = axes
        self._clock = clock
        self._last = self._before = 0

    def send(self) -> None:
        """Send one SYNC from the cyclic exchange and measure the interval."""
        self.network.send_sync()
        now = self._clock()
        if self._last:
            self.jitter.add(abs(now - self._last - self.period_ns))
            for axis in self._axes:
                if axis.good:
                    age = now - self._measured(axis.drive.units.position_ns)
                    self.dead_times[axis.do_id].add(age + self.period_ns // 2)
        self._before, self._last = self._last, now

    def status(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "period_ms": self.period_ns / MS,
            "jitter_p99_us": round(self.jitter.p99 / US, 1),
            "jitter_worst_us": round(self.jitter.worst / US, 1),
            "axes": [self._axis_status(axis) for axis in self._axes],
        }

    def _axis_status(self, axis: Axis) -> dict[str, Any]:
        measured, executor = self.dead_times[axis.do_id], axis.machine.executor
        dsc = executor.dsc if isinstance(executor, DscExecutor) else None
        by_speed = dsc is not None and dsc.choices.form is DscForm.SPEED
        return {
            "do_id": axis.do_id,
            "dead_time_p99_ms": round(measured.p99 / MS, 3),
            "dead_time_worst_ms": round(measured.worst / MS, 3),
            "dead_time_calculated_ms": None if dsc is None else dsc.dead_time_ns / MS,
            "highest_gain": dsc.gain_limit / KPC_PER_UNIT if dsc is not None and by_speed else None,
        }

    def _measured(self, received: int) -> int:
        """When a position that was received then was measured: at the SYNC before."""
        if received >= self._last:
            return self._last
        return self._before if received >= self._before else received
