"""Bits of STW1 that must be 1, and what each takes from the axis while it is 0: texts name the missing bits alone.

Source: PROFIdrive profile (control word 1); docs/translation.md.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from pdgw.gateway.reasons import Reason


class BitEffect(NamedTuple):
    """The effect of a bit that is 0, and the reason of an axis that lacks nothing else."""

    bit: int
    effect: str
    reason: Reason


BIT_EFFECTS: Final = (
    BitEffect(1, "OFF2: the drive coasts", Reason.COAST_STOP),
    BitEffect(2, "OFF3: quick stop", Reason.QUICK_STOP),
    BitEffect(3, "operation is not enabled", Reason.ENABLE_MISSING),
    BitEffect(4, "the ramp output is 0", Reason.SETPOINT_DISABLED),
    BitEffect(5, "the ramp is frozen", Reason.SETPOINT_DISABLED),
    BitEffect(6, "the setpoint is 0", Reason.SETPOINT_DISABLED),
)


class Missing(NamedTuple):
    """The bits of a word that are 0, of those that lead to some reasons."""

    names: tuple[str, ...]
    effects: tuple[str, ...]

    @classmethod
    def of(cls, name: str, word: int, *reasons: Reason) -> Missing:
        """``name``, ``word``: STW1 or the Controlword of a transparent telegram, and its value."""
        rows = [row for row in BIT_EFFECTS if row.reason in reasons and not word >> row.bit & 1]
        return cls(tuple(f"{name}.{row.bit}" for row in rows), tuple(row.effect for row in rows))

    def set_to(self, value: int) -> str:
        """``STW1.1 = STW1.3 = 0``; empty without bits."""
        return " = ".join((*self.names, str(value))) if self.names else ""
