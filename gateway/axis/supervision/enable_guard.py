"""Last guard: compares the number of Enable Operation commands with the number of requests of the PLC.

It uses no phases and no drive state. An ON counts after an OFF of the same connection. Each time the PLC starts to request
operation in such an ON (STW1 bits 0-3 = 1111 after another word), one rising Enable Operation is allowed. None is allowed if
Enable Operation stayed set until then (``ramp_stop_resume``, ``control_lost = "hold"``). Source: docs/safety.md.
"""

from __future__ import annotations

import enum
from typing import Final

from pdgw.dsp402.states import ControlBit
from pdgw.gateway.axis.demand_report import OFFS, PowerWish

ENABLE_OPERATION: Final = (
    ControlBit.SWITCH_ON | ControlBit.ENABLE_VOLTAGE | ControlBit.QUICK_STOP | ControlBit.ENABLE_OPERATION
)
_ENABLE: Final = PowerWish.ENABLE
_CONTINUING: Final = (PowerWish.ON, PowerWish.HOLD)


class _Request(enum.Enum):
    """The requests of the PLC up to now."""

    LOCKED = "no OFF in this connection, or something else than OFF and ON since"
    RELEASED = "OFF, and nothing but ON since: not operation"
    GRANTED = "operation, not commanded since the request began"
    USED = "operation, commanded"


_LOCKED: Final = _Request.LOCKED
_RELEASED: Final = _Request.RELEASED
_GRANTED: Final = _Request.GRANTED
_USED: Final = _Request.USED


class EnableGuard:
    """Guard of one axis. Call ``step`` once per cycle, after everything that changes the Controlword."""

    def __init__(self) -> None:
        self._request = _LOCKED
        self._commanded = False
        """The Controlword of the cycle before was Enable Operation."""

    def step(self, wish: PowerWish | None, controlword: int) -> bool:
        """Check one cycle. False for an Enable Operation without a request, which must not be sent. ``wish``: request of the
        PLC, None without one.
        """
        if wish is _ENABLE:
            if self._request is _RELEASED:
                self._request = _USED if self._commanded else _GRANTED
        elif wish in OFFS or (wish in _CONTINUING and self._request is not _LOCKED):
            self._request = _RELEASED
        else:
            self._request = _LOCKED
        commanded = controlword & ENABLE_OPERATION == ENABLE_OPERATION
        if commanded is self._commanded:
            return True
        self._commanded = commanded and self._request is _GRANTED
        if self._commanded:
            self._request = _USED
        return self._commanded is commanded
