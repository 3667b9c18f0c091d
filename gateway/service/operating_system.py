"""What the gateway uses of the operating system: real-time scheduling, the service manager.

The exchange runs with a real-time priority (SCHED_FIFO), unless the process was started with another policy. A refusal is
logged, and the gateway runs without. Linux only; elsewhere the log says that it is not available. The service manager learns
that the gateway is ready and alive by the protocol of sd_notify(3), a datagram for each line. The sign of life comes only from
the cyclic loop: a loop that hangs is ended and started again.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Mapping
from typing import Final

from pdgw.base.durations import US
from pdgw.ds301.counters import Counters

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


_SHARE = 4
"""Signs of life in one watchdog period."""


class ServiceManager:
    """The service manager that started this process, by its environment; does nothing where there is none."""

    def __init__(self, environment: Mapping[str, str], process: int) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if address else None
        if self._socket is not None:
            self._socket.setblocking(False)
        interval = environment.get("WATCHDOG_USEC", "")
        mine = environment.get("WATCHDOG_PID", str(process)) == str(process)
        self.interval_ns = int(interval) * US // _SHARE if interval.isdigit() and mine else 0
        """Time between two signs of life; 0: none requested."""
        self._due = 0
        self.failures = 0

    @classmethod
    def of_this_process(cls) -> ServiceManager:
        """Create it from the environment variables of the process."""
        return cls(os.environ, os.getpid())

    def count_in(self, counters: Counters) -> None:
        """Report a message that was not accepted."""
        counters.add("service", "failures", "messages", "the service manager did not accept", lambda: self.failures)

    def start(self) -> None:
        """Report that ports and buses are open."""
        self._notify(b"READY=1")

    def cycle(self, now: int, accepted: bool, answered: int) -> None:
        """CycleListener: the sign of life."""
        if self.interval_ns and now >= self._due:
            self._due = now + self.interval_ns
            self._notify(b"WATCHDOG=1")

    def stop(self) -> None:
        """The drives are stopped, the rest is released."""
        self._notify(b"STOPPING=1")
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _notify(self, line: bytes) -> None:
        if self._socket is None:
            return
        try:
            self._socket.sendto(line, self._address)
        except OSError:
            self.failures += 1  # the service manager is missing or does not read: the exchange continues
