"""What the simulated drive has of its family: homing methods and fault numbers, from the overlay of the ENGEL-like drive."""

from __future__ import annotations

from pdgw.dsp402.modes import STANDARD_HOMING_METHODS
from pdgw.dsp402.overlay import overlay

_FAMILY = overlay("engel")
DRIVE_FAULTS = _FAMILY.drive_faults
"""By the number in 200Ch."""
HOMING_METHODS = {method: (STANDARD_HOMING_METHODS | _FAMILY.homing_texts)[method] for method in _FAMILY.homing_methods}
"""Values of 6098h, with what they search for."""
