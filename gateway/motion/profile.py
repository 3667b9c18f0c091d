"""Motion profile, cycle by cycle: a trapezoid of speed to a position, or a ramp to a speed. Pure.

All numbers are integers in one unit of length that the caller chooses: positions, speeds per cycle, accelerations per cycle and
cycle. Only the speed from which an axis can still stop at its target is rounded, downward. No speed and no acceleration is above
the request, and the target is met exactly.
"""

from __future__ import annotations

from math import isqrt


def highest_speed(way: int, deceleration: int) -> int:
    """The highest speed of the next cycle from which ``deceleration`` (above 0) still ends after ``way`` (0 or more)."""
    # With n further cycles: distance = (n + 1) speed - deceleration n (n + 1) / 2, with the largest n that fits.
    cycles = (isqrt(4 * (2 * way // deceleration) + 1) - 1) // 2
    return (2 * way + deceleration * cycles * (cycles + 1)) // (2 * (cycles + 1))


def next_speed(speed: int, wanted: int, acceleration: int, deceleration: int) -> int:
    """One cycle toward a speed: faster by ``acceleration`` at most, slower by ``deceleration``; through zero in two cycles."""
    if speed < 0 or (speed == 0 and wanted < 0):
        return -next_speed(-speed, -wanted, acceleration, deceleration)
    if wanted > speed:
        return min(wanted, speed + acceleration)
    return max(wanted, speed - deceleration, 0)


class Profile:
    """Position and speed of an axis for the next cycle. Each call of a method calculates one cycle, except ``stand``."""

    def __init__(self) -> None:
        self.position = 0
        self.speed = 0

    def stand(self, position: int) -> None:
        """Stay at standstill here."""
        self.position = position
        self.speed = 0

    def toward(self, target: int, speed: int, acceleration: int, deceleration: int) -> None:
        """Move to a position with at most ``speed`` (0 or more). If it cannot be reached any more, pass it and return."""
        way = target - self.position
        wanted = 0
        if way * self.speed >= 0:
            wanted = min(speed, highest_speed(abs(way), deceleration))
            if way < 0:
                wanted = -wanted
        self.turn(wanted, acceleration, deceleration)

    def turn(self, speed: int, acceleration: int, deceleration: int) -> None:
        """Change to a speed with its sign."""
        self.speed = next_speed(self.speed, speed, acceleration, deceleration)
        self.position += self.speed

    def stop(self, deceleration: int) -> None:
        """Stop."""
        self.turn(0, 0, deceleration)
