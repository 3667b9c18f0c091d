"""A proportional position controller like that of a PLC program, over telegrams 5, 6, 105 and 106, with and without DSC.

Source: docs/motion.md "DSC". Positions are increments of G1_XIST1, speeds rpm. Not implemented: feed-forward of the
acceleration.
"""

from __future__ import annotations

from collections.abc import Mapping

from pdgw.durations import SECONDS_PER_MINUTE
from pdgw.gateway.motion.dsc import KPC_PER_UNIT, difference
from pdgw.profidrive.datatypes import N4_100_PERCENT, DataType

_LOWEST, _HIGHEST = DataType.N4.integer_range


class PositionLoop:
    """``gain`` in 1/s. ``dsc``: send gain and error to the drive (KPC, XERR), else their product as NSOLL_B."""

    def __init__(self, gain: float, *, dsc: bool, increments_per_revolution: int, reference_rpm: float) -> None:
        self.gain = gain
        self.dsc = dsc
        self._increments = increments_per_revolution
        self._reference = reference_rpm
        self.error = 0.0
        """Error of the last step, increments."""

    def step(self, target: float, actuals: Mapping[str, int], feed_forward_rpm: float = 0.0) -> dict[str, int]:
        """The setpoints of one cycle for a target, from the actual values of the last frame."""
        whole = round(target)
        self.error = target - whole + difference(whole, actuals["G1_XIST1"])
        if self.dsc:
            kpc = round(self.gain * KPC_PER_UNIT)
            return {"NSOLL_B": self._speed(feed_forward_rpm), "XERR": round(self.error), "KPC": kpc}
        rpm = self.gain * self.error / self._increments * SECONDS_PER_MINUTE
        return {"NSOLL_B": self._speed(feed_forward_rpm + rpm), "XERR": 0, "KPC": 0}

    def _speed(self, rpm: float) -> int:
        return max(_LOWEST, min(round(rpm / self._reference * N4_100_PERCENT), _HIGHEST))
