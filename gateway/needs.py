"""What of a drive's scaling a telegram cannot do without: the quantities its signals are fractions of.

Source: docs/units.md "What each signal needs". A signal in the drive's own units needs no 100 %.
"""

from __future__ import annotations

from pdgw.dsp402.drive_type import Quantity
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import Telegram

_QUANTITIES = (
    ("NSOLL", Quantity.SPEED),
    ("NIST", Quantity.SPEED),
    ("MDI_VELOCITY", Quantity.PROFILE_VELOCITY),
    ("MDI_ACC", Quantity.ACCELERATION),
    ("MDI_DEC", Quantity.DECELERATION),
    ("MDI_TARPOS", Quantity.POSITION),
    ("XIST_A", Quantity.POSITION),
)
"""Beginning of a signal's name, and what it is a fraction of."""


def quantity_of(signal: Signal) -> Quantity | None:
    """What a signal is a fraction of; None for one that is no fraction, or of none of these quantities."""
    if signal.type not in {DataType.N2, DataType.N4}:
        return None
    return next((quantity for start, quantity in _QUANTITIES if signal.name.startswith(start)), None)


def needed_quantities(telegram: Telegram) -> tuple[Quantity, ...]:
    """In the order of ``Quantity``; the speed always: without it no standstill is known."""
    signals = (*telegram.setpoints.signals, *telegram.actuals.signals)
    needed = {Quantity.SPEED} | {quantity for signal in signals if (quantity := quantity_of(signal)) is not None}
    return tuple(quantity for quantity in Quantity if quantity in needed)
