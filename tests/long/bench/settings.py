"""The same exchange with other settings, in turn in one run: real-time priority, no flight recorder."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from tests.long.bench.processes.processes import USUAL_SCHEDULING
from tests.long.bench.rows import Row, measure

AS_SHIPPED = "as by default"
SETTINGS: Mapping[str, str] = MappingProxyType(
    {
        AS_SHIPPED: "",
        "without flight recorder": "[trace]\nenabled = false\n",
        "usual scheduling": USUAL_SCHEDULING,
        "[realtime]": "[realtime]\npriority = 50\n",
    }
)
"""Further tables of the gateway's configuration."""
_TURNS = 3


@dataclass(frozen=True, slots=True)
class Choice:
    """A setting of ``SETTINGS``. ``rows``: one for each turn."""

    name: str
    rows: tuple[Row, ...]

    @property
    def p50(self) -> float:
        """p50 relative to the echo, in the best turn."""
        return min(row.ratio_p50 for row in self.rows)

    @property
    def p99(self) -> float:
        return min(row.ratio_p99 for row in self.rows)

    @property
    def cpu_ns_per_cycle(self) -> float | None:
        known = [row.cpu_ns_per_cycle for row in self.rows if row.cpu_ns_per_cycle is not None]
        return min(known) if known else None


def run(axes: int, period_ns: int, seconds: float, progress: Callable[[str], None]) -> list[Choice]:
    """Measure each setting in turn, ``seconds`` for each turn. Settings without permission are left out."""
    granted = {name: more for name, more in SETTINGS.items() if name != "[realtime]" or may_be_real_time()}
    rows: dict[str, list[Row]] = {name: [] for name in granted}
    for turn in range(_TURNS):
        for name, more in granted.items():
            progress(f"{name}, turn {turn + 1} of {_TURNS}")
            rows[name].append(measure(axes, period_ns, seconds, more))
    return [Choice(name, tuple(found)) for name, found in rows.items()]


def may_be_real_time() -> bool:
    """Whether the system permits real-time priority for this process."""
    try:
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, policy, parameters)
    except (AttributeError, OSError):
        return False
    return True
