"""From the physical position to what a simulated encoder puts out: pure functions on integers.

Source: CiA DSP 406 V2.0 chapters 5.4 (order of the functions), 8.1.1-8.1.4 and 8.4.10 (code sequence, scaling, preset,
offset), 8.1.9 (speed), 8.2 (cams), 8.3 (work area). Where the profile is silent: the physical position counts on beyond the
number of distinguishable revolutions, so that the output wraps at the total measuring range only; hysteresis widens a cam
on both sides once it is active.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass


class AreaState(enum.IntFlag):
    """Area state register 6400h of a channel."""

    OUT_OF_RANGE = 1 << 0
    """Beyond the manufacturer's minimum or maximum position (650Ah)."""
    OVERFLOW = 1 << 1
    UNDERFLOW = 1 << 2


def names(value: enum.IntFlag) -> str:
    """The set bits in words: ``position error, commissioning diagnostics``; ``none`` without any."""
    return ", ".join((bit.name or "").lower().replace("_", " ") for bit in value) or "none"


INT16 = (-0x8000, 0x7FFF)


@dataclass(frozen=True, slots=True)
class Chain:
    """Code sequence, scaling and range in force: physical step ``p`` gives ``floor(+-p * numerator / denominator)``.

    ``total_range`` is the number of position values (1..2^32).
    """

    counterclockwise: bool
    numerator: int
    denominator: int
    total_range: int

    def scaled(self, physical: int) -> int:
        """The position before the offset, in measuring units, not wrapped."""
        return (-physical if self.counterclockwise else physical) * self.numerator // self.denominator

    def output(self, physical: int, offset: int) -> int:
        """The position value, 0..total_range-1."""
        return (self.scaled(physical) + offset) % self.total_range

    def offset_for(self, physical: int, preset: int) -> int:
        """The offset (6509h) that makes ``preset`` the position value; the nearest to 0, so that it fits Integer32."""
        offset = (preset - self.scaled(physical)) % self.total_range
        return offset - self.total_range if 2 * offset >= self.total_range else offset

    def speed(self, physical_per_second: float) -> float:
        """Measuring units per second, positive while the position value grows."""
        speed = physical_per_second * self.numerator / self.denominator
        return -speed if self.counterclockwise else speed


def chain(
    *, counterclockwise: bool, scaling: bool, numerator: int, denominator: int, total_range: int, steps: int
) -> Chain:
    """The chain of the present parameters.

    ``numerator`` and ``denominator`` are 6001h and 6501h, of a linear encoder 6501h and 6005h/1; ``total_range`` is 6002h.
    ``steps`` is what the hardware distinguishes: a larger range is not reached.
    """
    if not scaling:
        return Chain(counterclockwise, 1, 1, steps)
    reachable = steps * numerator // denominator
    return Chain(counterclockwise, numerator, denominator, max(1, min(total_range, reachable)))


def speed_value(speed: float) -> int:
    """A speed as 6030h shows it: the Integer16 saturates."""
    low, high = INT16
    return min(max(round(speed), low), high)


def within(position: int, low: int, high: int) -> bool:
    """Whether a position is between two limits; low > high is the area around the end of the range."""
    if low <= high:
        return low <= position <= high
    return position >= low or position <= high


def cam_active(position: int, low: int, high: int, hysteresis: int, active: bool, total_range: int) -> bool:
    """The next state of a cam: it becomes active between its limits and inactive beyond limit and hysteresis.

    The hysteresis reaches across the end of the range, where the position wraps.
    """
    if within(position, low, high):
        return True
    if not active:
        return False
    if low > high:
        return low - hysteresis <= high + hysteresis or within(position, low - hysteresis, high + hysteresis)
    return any(
        low - hysteresis <= turned <= high + hysteresis
        for turned in (position - total_range, position, position + total_range)
    )


def cam_state(active: int, enable: int, polarity: int) -> int:
    """Cam state register 6300h of a channel: polarity inverts, a disabled cam reads 0."""
    return (active ^ polarity) & enable & 0xFF


def area_state(position: int, low: int, high: int, *, out_of_range: bool) -> AreaState:
    """Area state register 6400h of a channel.

    With low > high a position outside the area is below the low and above the high limit: both bits are set.
    """
    state = AreaState.OUT_OF_RANGE if out_of_range else AreaState(0)
    if not within(position, low, high):
        if position < low:
            state |= AreaState.UNDERFLOW
        if position > high:
            state |= AreaState.OVERFLOW
    return state
