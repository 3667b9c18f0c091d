"""Bits that keep a drive object from what the PLC asks: evidence and remedies name those that do so now, and no others.

Source: PROFIdrive profile (control word 1); CiA DSP 402 (6041h, 60FDh); docs/translation.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from pdgw.gateway.base.reasons import Finding, Reason
from pdgw.gateway.base.step_text import equation
from pdgw.gateway.base.steps import OFF_ON, Bits


class BitEffect(NamedTuple):
    """One of several bits of a reason, or not always its cause. Without an effect, the text of the reason has the bit."""

    words: tuple[str, ...]
    """Signals of the PLC that have the bit; Statusword or 60FDh (digital inputs) of the drive."""
    bit: int
    reasons: tuple[Reason, ...]
    effect: str = ""
    level: int = 0
    """The value that has the effect."""


_WORDS: Final = ("STW1", "Controlword")
_STOPS: Final = (Reason.COAST_STOP, Reason.QUICK_STOP, Reason.HELD_OFF)
_SETPOINT: Final = (Reason.SETPOINT_DISABLED,)
AT_LIMIT: Final = (Reason.STOPPED_AT_LIMIT, Reason.TASK_AT_LIMIT, Reason.INTERNAL_LIMIT)
BIT_EFFECTS: Final = (
    BitEffect(_WORDS, 1, _STOPS, "OFF2"),
    BitEffect(_WORDS, 2, _STOPS, "OFF3"),
    BitEffect(_WORDS, 3, (Reason.ENABLE_MISSING, Reason.HELD_OFF), "Disable Operation"),
    BitEffect(("STW1",), 4, _SETPOINT, "the ramp output is 0"),
    BitEffect(("STW1",), 5, _SETPOINT, "the ramp is frozen"),
    BitEffect(("STW1",), 6, _SETPOINT, "the setpoint is 0"),
    BitEffect(("STW1",), 4, (Reason.REJECTED,)),
    BitEffect(("Statusword",), 9, (Reason.LOCAL_MODE, Reason.LOCAL_TURNS), "local mode"),
    BitEffect(("60FDh",), 0, AT_LIMIT, "negative limit switch", 1),
    BitEffect(("60FDh",), 1, AT_LIMIT, "positive limit switch", 1),
)


def bit_effects(reason: Reason, words: Mapping[str, int], effect: str = "") -> Finding:
    """A reason with the bits that give it. ``words``: values by name; ``effect``: what they have instead of their own."""
    own = [row for row in BIT_EFFECTS if reason in row.reasons]
    found = [
        (f"{word}.{row.bit}", row)
        for row in own
        for word in row.words
        if word in words and words[word] >> row.bit & 1 == row.level
    ]
    finding = Finding.of(reason)
    if found:
        bits, effects = tuple(name for name, _ in found), effect or ", ".join(row.effect for _, row in found)
        if effects:
            finding = finding._replace(evidence=f"{reason.head}: {equation(bits, own[0].level)} ({effects})")
        if "STW1" in own[0].words:
            finding = finding._replace(remedy=(Bits(bits), *(step for step in reason.remedy if step is OFF_ON)))
    return finding
