"""The measured build of the package and the machine."""

from __future__ import annotations

import os
import platform
from datetime import UTC, datetime
from importlib.metadata import version

from pdgw.gateway.errors import GatewayError
from pdgw.gateway.service.build import build, interpreter

_PRIORITY = 10


def machine() -> dict[str, object]:
    """The properties that the figures depend on, as plain data."""
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "version": version("profidrive-gateway"),
        "build": build(),
        "python": interpreter(),
        "system": f"{platform.system()} {platform.release()}",
        "processor": platform.machine(),
        "cores": os.cpu_count(),
    }


def use_real_time_priority() -> None:
    """Set real-time priority for this process and its children. GatewayError without permission."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except AttributeError:
        raise GatewayError("--realtime: this system has no real-time priority of Linux' kind") from None
    except OSError as error:
        raise GatewayError(f"--realtime: not allowed ({error.strerror}); root or CAP_SYS_NICE is needed") from error
