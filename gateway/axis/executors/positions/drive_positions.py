"""The positions of a drive: their unit and sign, the range that it shows and accepts, and whether they wrap there.

Source: docs/motion.md, docs/devices.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pdgw.ds301.objects import CanType, ObjectAddress
from pdgw.dsp402.drive_type import DriveType, Scaling
from pdgw.gateway.motion.modulo import Ring


@dataclass(frozen=True, slots=True)
class DrivePositions:
    """The positions of the drive that is set, until another one is. In its units."""

    scaling: Scaling = field(default_factory=Scaling)
    targets: tuple[int, int] = CanType.I32.integer_range
    """Range of 607Ah."""
    ends: tuple[int, int] | None = None
    """Between these the drive can be sent; None: it wraps, or has no range."""
    objects: Mapping[ObjectAddress, int] = field(default_factory=dict)
    """The drive's values of the objects that define the unit and the sign of positions."""
    has_velocity: bool = False
    """The drive has 6081h: its tasks have the speed that they are given."""

    @classmethod
    def of(cls, drive: DriveType) -> DrivePositions:
        """The positions of a drive."""
        scaling = drive.scaling
        ends = None if scaling.position_wraps else scaling.position_range
        has_velocity = drive.has("profile_velocity")
        return cls(scaling, drive.limits("target_position"), ends, drive.position_objects, has_velocity)

    def ring(self) -> Ring:
        """A new count of the drive's position over its wraps."""
        low, _ = (self.scaling.position_wraps and self.scaling.position_range) or CanType.I32.integer_range
        return Ring(low, self.scaling.position_span)

    def differs(self, before: DrivePositions) -> bool:
        """Whether a position means another place than with the drive before."""
        return any(before.objects.get(address, value) != value for address, value in self.objects.items())

    def unconfirmed(self, ring: Ring) -> str:
        """That only the profile says that the drive wraps at 607Bh, and it has not done so yet; empty: it is confirmed."""
        if not self.scaling.position_wraps or self.scaling.wrap_confirmed or ring.wrapped:
            return ""
        return self.scaling.range_text

    def ends_text(self, position: int) -> str:
        """Where the positions of the drive end, and how far it is from there; empty if they do not end."""
        ends, text, counts = self.ends, self.scaling.range_text, self.scaling.counts_per_revolution
        if ends is None:
            return ""
        if counts is None:
            return text
        backward, forward = (float(abs(end - position) / counts) for end in ends)
        return f"{text}: {forward:.1f} turns forward, {backward:.1f} turns backward"
