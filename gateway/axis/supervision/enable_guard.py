"""Last guard: compares the number of Enable Operation commands with the number of requests of the PLC.

It uses no phases and no drive state. An ON counts after an OFF of the same connection. Each time the PLC starts to request
operation in such an ON (STW1 bits 0-3 = 1111 after another word), one rising Enable Operation is allowed. None is allowed if
Enable Operation stayed set until then (``ramp_stop_resume``, ``control_lost = "hold"``). Source: docs/safety.md.
"""

from __future__ import annotations

from typing import Final

from pdgw.dsp402.states import ControlBit
from pdgw.gateway.axis.demand_report import OFFS, PowerWish

ENABLE_OPERATION: Final = (
    ControlBit.SWITCH_ON | ControlBit.ENABLE_VOLTAGE | ControlBit.QUICK_STOP | ControlBit.ENABLE_OPERATION
)
_ENABLE: Final = PowerWish.ENABLE
_OFFS: Final = OFFS
_CONTINUING: Final = (PowerWish.ON, PowerWish.HOLD)


class EnableGuard:
    """Guard of one axis. Call ``step`` once per cycle, after everything that changes the Controlword."""

    def __init__(self) -> None:
        self._off_seen = False
        """The PLC sent OFF, and nothing but ON since."""
        self._asked = False
        """Whether the PLC requested operation in the previous cycle."""
        self._commanded = False
        """The Controlword of the cycle before was Enable Operation."""
        self._granted = False
        """The PLC began to ask, and operation was not commanded since."""

    def step(self, wish: PowerWish | None, controlword: int) -> bool:
        """Check one cycle. False for an Enable Operation without a request, which must not be sent. ``wish``: request of the
        PLC, None without one.
        """
        asks = wish is _ENABLE
        if asks is not self._asked or not asks:
            self._asked = asks
            self._follow(wish)
        commanded = controlword & ENABLE_OPERATION == ENABLE_OPERATION
        if commanded is self._commanded:
            return True
        allowed = not commanded or self._granted
        if commanded:
            self._granted = False
        self._commanded = commanded and allowed
        return allowed

    def _follow(self, wish: PowerWish | None) -> None:
        if wish is _ENABLE:
            self._granted = self._off_seen and not self._commanded
            return
        self._granted = False
        if wish in _OFFS:
            self._off_seen = True
        elif wish not in _CONTINUING:
            self._off_seen = False
