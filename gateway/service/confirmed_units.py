"""Units of an axis that a person has confirmed: written by ``pdgw axis test``, shown by ``pdgw status``."""

from __future__ import annotations

from pdgw.dsp402.drive_type import Scaling
from pdgw.gateway.store import ConfirmedUnits

NEVER = "units not verified (pdgw axis test)"


def confirmation(date: str, serial_number: int, scaling: Scaling) -> ConfirmedUnits:
    """The stored result of a test: date (``2026-11-22``), serial number of the drive (1018h/4) and its units."""
    counts = scaling.counts_per_revolution
    return ConfirmedUnits(
        date=date,
        serial_number=serial_number,
        velocity_per_rpm=str(scaling.velocity_per_rpm),
        counts_per_revolution="" if counts is None else str(counts),
    )


def units_text(kept: ConfirmedUnits | None, serial_number: int, scaling: Scaling) -> str:
    """For a person: whether the present units of this drive are confirmed."""
    if kept is None:
        return NEVER
    now = confirmation(kept.date, serial_number, scaling)
    if now == kept:
        return f"units verified on {kept.date} (axis test)"
    other = "for other units"
    if now.serial_number != kept.serial_number:
        other = f"for the drive with serial number {kept.serial_number}, this drive has {serial_number}"
    return f"{NEVER}: the axis test of {kept.date} was {other}"
