"""Status bits about the PLC's present setpoint or task: 0 while an order is not confirmed.

Source: docs/transport.md chapter 1, "Which frames are new". While an order waits or was dropped, the axis has an older task.
Its "reached" and "acknowledged" do not answer the PLC's newest order. Not here: facts of the axis (standstill, limits, home
position).
"""

from __future__ import annotations

from typing import Final

from pdgw.dsp402.states import StatusBit
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import TelegramHalf

_CLAIMS: Final = {
    "ZSW1": signal("ZSW1").word("TARGET_REACHED", "TASK_ACKNOWLEDGE", positioning=True),
    "Statusword": StatusBit.TARGET_REACHED | StatusBit.MODE_12,
    "POS_ZSW": signal("POS_ZSW").word("TARGET_REACHED"),
    "POS_ZSW2": signal("POS_ZSW2").word("SETPOINT_REACHED", "FIXED_STOP_REACHED", "CLAMPING_TORQUE_REACHED"),
    "MELDW": signal("MELDW").word("RAMP_COMPLETED"),
}


def claims(actuals: TelegramHalf) -> tuple[tuple[int, int], ...]:
    """Place and bits of each word with claims, in a telegram's actual values."""
    return tuple((place, _CLAIMS[name]) for place, name in enumerate(actuals.names) if name in _CLAIMS)
