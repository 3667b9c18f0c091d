"""Compare commanded and measured speed and position of one measurement, as numbers and as text."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from pdgw.base.durations import SECONDS_PER_MINUTE
from pdgw.dsp402.drive_type import DriveType, Quantity

_TOLERANCE = Fraction(5, 100)
_UNCERTAIN_S = Fraction(2, 100)
"""Uncertainty of the time of a position."""


_COUNT_TURNS, _COUNT_SHARE = Fraction(1, 2), Fraction(15, 100)
"""How exactly a person counts turns: this number, or this share of the turns."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """One constant speed in the drive's units: commanded and measured values."""

    wire: int
    """NSOLL_A."""
    target: int
    """60FFh."""
    velocity: Fraction
    """Mean of 606Ch."""
    shown: int
    """NIST_A at the end."""
    seconds: Fraction
    moved: int | None
    """Change of 6064h in the measured time; None for a drive without it."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """A factor is measured divided by commanded, None if unknown. ``passed``: all factors are within their tolerance."""

    passed: bool
    lines: tuple[str, ...]
    speed_factor: Fraction
    position_factor: Fraction | None


def rpm(drive: DriveType, velocity: Fraction | int) -> Fraction:
    """Convert a velocity of the drive to rpm of the motor."""
    rated = drive.scaling.rated_speed_rpm
    assert rated is not None, "known wherever 100 % of the speed is"
    return velocity * rated / drive.scaling.reference(Quantity.SPEED)


def compare(drive: DriveType, held: Measurement) -> Comparison:
    """Compare speed and position with the command."""
    commanded = rpm(drive, held.target)
    speed = held.velocity / held.target
    passed = abs(speed - 1) <= max(_TOLERANCE, Fraction(2, abs(held.target)))
    lines = [
        f"commanded  NSOLL_A {held.wire & 0xFFFF:04X}h = {_g(commanded)} rpm = 60FFh {held.target}",
        f"speed      606Ch {_g(held.velocity)} = {_g(rpm(drive, held.velocity))} rpm, NIST_A {held.shown & 0xFFFF:04X}h: "
        f"factor {float(speed):.3f}",
    ]
    moved, counts = held.moved, drive.scaling.counts_per_revolution
    if moved is None:
        lines.append("position   none (6064h): only the drive reports the speed; compare it with a mark on the shaft")
        return Comparison(passed, tuple(lines), speed, None)
    way = f"position   6064h {moved:+d} in {float(held.seconds):.2f} s"
    if counts is None:
        would = moved / (commanded * held.seconds / SECONDS_PER_MINUTE)
        lines.append(f"{way}: counts_per_revolution is unknown, {float(would):.0f} would match the commanded speed")
        return Comparison(passed, tuple(lines), speed, None)
    seen = moved / counts / held.seconds * SECONDS_PER_MINUTE
    factor = seen / commanded
    lines.append(f"{way} = {_g(seen)} rpm ({_g(counts)} in one revolution): factor {float(factor):.3f}")
    expected = abs(commanded * held.seconds / SECONDS_PER_MINUTE * counts)
    if abs(factor - 1) > max(_TOLERANCE, _UNCERTAIN_S / held.seconds + 2 / expected):
        passed = False
        lines.append(
            "speed and position do not match: velocity_unit, counts_per_revolution or gear is wrong. Measure "
            f"the shaft: if it turned at {_g(commanded)} rpm, one revolution is {_g(counts * abs(factor))} of "
            f"6064h; if at {_g(seen)} rpm, one unit of 60FFh is {_g(seen / held.target)} rpm"
        )
    return Comparison(passed, tuple(lines), speed, factor)


def compare_turns(typed: str, turns: Fraction) -> tuple[bool, str]:
    """Compare the number of turns a person typed with the commanded one: (whether it is a number, what is wrong with it)."""
    try:
        seen = Fraction(typed.strip().replace(",", "."))
    except (ValueError, ZeroDivisionError):
        return False, ""
    if abs(abs(seen) - turns) <= max(_COUNT_TURNS, _COUNT_SHARE * turns):
        return True, ""
    return True, (
        f"the mark made {_g(seen)} turns, commanded were {_g(turns)}: velocity_unit, counts_per_revolution, "
        f"gear or 608Fh is wrong by a factor of {_g(abs(seen) / turns)}"
    )


def _g(value: Fraction) -> str:
    return f"{float(value):.4g}"
