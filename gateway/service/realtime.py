"""Real-time scheduling of the gateway's process, if the operating system grants it.

The exchange runs with a real-time priority (SCHED_FIFO), unless the process was started with another policy. A refusal is
logged, and the gateway runs without. Linux only; elsewhere the log says that it is not available.
"""

from __future__ import annotations

import logging
import os
from typing import Final

DEFAULT_PRIORITY: Final = 40
"""Below the threads of the kernel that serve network and CAN (50)."""
NEEDED_BELOW_MS: Final = 8
"""Shorter cycles are missed at usual scheduling when other processes need the processor."""

Line = tuple[int, str]
"""A log level and line."""


def request(cycle_time_ms: float) -> Line:
    """Request the priority; returns the line for the log.

    Call it before the first thread starts: threads inherit it, and a thread without the priority that holds the interpreter would
    delay the exchange.
    """
    try:
        # The user may have set another policy for the process (chrt, CPUSchedulingPolicy=).
        if os.sched_getscheduler(0) == os.SCHED_OTHER:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(DEFAULT_PRIORITY))
        priority = os.sched_getparam(0).sched_priority
        return (
            logging.INFO,
            f"real-time priority {priority} (SCHED_FIFO)" if priority else "normal scheduling, as started",
        )
    except AttributeError:
        reason = "is not available on this operating system"
    except OSError as error:
        reason = (
            f"is not granted ({error.strerror or error}; LimitRTPRIO={DEFAULT_PRIORITY}, CAP_SYS_NICE or "
            "root grants it)"
        )
    short = cycle_time_ms < NEEDED_BELOW_MS
    risk = f"; a busy machine misses cycles of {cycle_time_ms:g} ms" if short else ""
    return logging.WARNING if short else logging.INFO, f"normal scheduling: SCHED_FIFO {reason}{risk}"


def usual(pid: int) -> None:
    """Restore normal scheduling for a child process, which inherits the gateway's."""
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))
