"""Times as the user gives them."""

from __future__ import annotations

import datetime

from pdgw.durations import SECOND
from pdgw.gateway.errors import GatewayError


def moment(text: str, option: str, zero_ns: int) -> int:
    """Nanoseconds of a time: seconds since ``zero_ns``, or an ISO time; GatewayError names the option."""
    try:
        return zero_ns + round(float(text) * SECOND)
    except (ValueError, OverflowError):
        pass
    try:
        return round(datetime.datetime.fromisoformat(text).timestamp() * SECOND)
    except (ValueError, OverflowError, OSError):
        raise GatewayError(f"{option} {text}: expected seconds or an ISO time like 2026-03-01T12:00:00") from None
