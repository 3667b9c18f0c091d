"""Scaling of a drive that a telegram requires: the quantities whose fractions its signals are.

Source: docs/devices.md "What each signal needs". A signal in the drive's own units needs no 100 %.
"""

from __future__ import annotations

from typing import NamedTuple

from pdgw.dsp402.drive_type import Quantity, Scaling
from pdgw.dsp402.units.unit_keys import KEY_LINES
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.signals import Signal, SignalQuantity
from pdgw.profidrive.telegrams import Telegram

_REFERENCES = {
    SignalQuantity.SPEED: Quantity.SPEED,
    SignalQuantity.MOTION_VELOCITY: Quantity.PROFILE_VELOCITY,
    SignalQuantity.ACCELERATION: Quantity.ACCELERATION,
    SignalQuantity.DECELERATION: Quantity.DECELERATION,
    SignalQuantity.POSITION: Quantity.POSITION,
}
"""The reference of the drive that is 100 % of a signal."""


def quantity_of(signal: Signal) -> Quantity | None:
    """The quantity that a signal is a fraction of; None for a signal in other units."""
    if signal.quantity is None or signal.type not in {DataType.N2, DataType.N4}:
        return None
    return _REFERENCES.get(signal.quantity)


def needed_quantities(telegram: Telegram) -> tuple[Quantity, ...]:
    """In the order of ``Quantity``; the speed always: without it no standstill is known."""
    signals = (*telegram.setpoints.signals, *telegram.actuals.signals)
    needed = {Quantity.SPEED} | {quantity for signal in signals if (quantity := quantity_of(signal)) is not None}
    return tuple(quantity for quantity in Quantity if quantity in needed)


_UNITS = (
    ("counts_per_revolution", "position units per revolution", "counts_per_revolution"),
    ("velocity_per_rpm", "velocity units per rpm", "velocity_unit"),
    ("acceleration_per_rpm_s", "acceleration units per rpm/s", "acceleration_unit"),
)
"""Parts of a scaling besides its 100 % values: attribute, name in messages, and configuration key."""


class Missing(NamedTuple):
    """All parts of a scaling that a telegram lacks."""

    why: str
    keys: tuple[str, ...]

    @property
    def lines(self) -> tuple[str, ...]:
        """Lines to paste into the [[axis]]; each is rejected until its value is filled in."""
        return tuple(KEY_LINES[key] for key in self.keys)

    @property
    def text(self) -> str:
        """For one line: the reasons, then what to paste."""
        if not self.keys:
            return self.why
        short = ", ".join(line.partition("  #")[0] for line in self.lines)
        return f"{self.why}; paste into its [[axis]] and fill in: {short}"


def missing(scaling: Scaling, needed: tuple[Quantity, ...], *, converts: bool) -> Missing:
    """``converts``: positions, velocities and accelerations are made of each other (positioner, DSC)."""
    parts = [text for text in (scaling.refusal(*needed),) if text]
    keys = list(scaling.missing_keys(*needed))
    for attribute, what, key in _UNITS if converts else ():
        if getattr(scaling, attribute) is None and key not in keys:
            if not parts or key not in parts[0]:
                parts.append(f"{what}: unknown, set {key}")
            keys.append(key)
    return Missing("; ".join(parts), tuple(keys))
