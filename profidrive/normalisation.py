"""Fractions of a reference to physical integers and back, exactly: what every cycle reckons with."""

from __future__ import annotations

from fractions import Fraction

from pdgw.profidrive.errors import ProfidriveError


class Normalisation:
    """Exact conversion between a physical integer and a fixed-point fraction of a reference.

    ``reference`` is the physical value (in the units of the integer) of 100 %; ``full_scale`` is the wire value of 100 %;
    ``wire_range`` and ``value_range`` limit the results.

    value -> wire truncates toward zero (the published examples require it), wire -> value rounds to nearest, half away from
    zero, so that a value written and read back is itself (true while reference < full_scale / 2).
    """

    def __init__(
        self,
        reference: Fraction | int,
        full_scale: int,
        wire_range: tuple[int, int],
        value_range: tuple[int, int],
    ) -> None:
        self.reference = Fraction(reference)
        if self.reference <= 0:
            raise ProfidriveError("normalisation reference", reference, "a value above 0")
        # value = wire * num / den;  wire = value * den / num
        ratio = self.reference / full_scale
        self._num = ratio.numerator
        self._den = ratio.denominator
        self.wire_min, self.wire_max = wire_range
        self.value_min, self.value_max = value_range

    def _values(self) -> tuple[object, ...]:
        return self._num, self._den, self.value_min, self.value_max, self.wire_min, self.wire_max

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Normalisation) and self._values() == other._values()

    def __hash__(self) -> int:
        return hash(self._values())

    def to_wire(self, value: int) -> int:
        """The fraction of the reference, truncated toward zero and saturated at the wire range."""
        wire = value * self._den // self._num if value >= 0 else -(-value * self._den // self._num)
        if wire > self.wire_max:
            return self.wire_max
        if wire < self.wire_min:
            return self.wire_min
        return wire

    def to_value(self, wire: int) -> int:
        """The nearest physical value, saturated at the value range."""
        if wire >= 0:
            value = (2 * wire * self._num + self._den) // (2 * self._den)
        else:
            value = -((-2 * wire * self._num + self._den) // (2 * self._den))
        if value > self.value_max:
            return self.value_max
        if value < self.value_min:
            return self.value_min
        return value

    def saturates(self, wire: int) -> bool:
        """Whether ``to_value(wire)`` has to apply a limit."""
        scaled = 2 * wire * self._num
        return not (2 * self.value_min - 1) * self._den < scaled < (2 * self.value_max + 1) * self._den
