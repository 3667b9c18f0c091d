"""Real-time scheduling of the gateway's process, as far as the operating system grants it.

The exchange runs with a real-time priority (SCHED_FIFO), on chosen processors, with its memory locked: each is asked for by
``[realtime]`` in the configuration and refused politely without the right. Linux; elsewhere it is said that it is not there.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable

from pdgw.gateway.config_surroundings import RealtimeConfig

_MCL_CURRENT, _MCL_FUTURE = 1, 2
"""linux/mman.h"""
_SETCAP = "root, CAP_SYS_NICE and CAP_IPC_LOCK (systemd: AmbientCapabilities), or LimitRTPRIO and LimitMEMLOCK"


def apply(config: RealtimeConfig) -> list[str]:
    """Ask for everything configured; returns a line for each that was refused, with what would grant it.

    Called before the first thread is started: threads inherit it, and a thread without the priority that holds the
    interpreter would keep the exchange waiting.
    """
    refused: list[str] = []
    if config.cpu:
        refused += _try("cpu", list(config.cpu), lambda: os.sched_setaffinity(0, config.cpu))
    if config.priority is not None:
        wanted = config.priority
        refused += _try("priority", wanted, lambda: _set_priority(wanted))
    if config.lock_memory:
        refused += _try("lock_memory", "true", _lock_memory)
    return refused


def _try(key: str, value: object, action: Callable[[], None]) -> list[str]:
    try:
        action()
    except AttributeError:
        return [f"[realtime] {key} = {value}: not on this operating system, goes on without"]
    except OSError as error:
        return [f"[realtime] {key} = {value}: {error.strerror or error}, goes on without; it needs {_SETCAP}"]
    return []


def _set_priority(priority: int) -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def _lock_memory() -> None:
    lock = ctypes.CDLL(None, use_errno=True).mlockall
    if lock(_MCL_CURRENT | _MCL_FUTURE):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
