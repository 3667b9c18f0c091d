"""Facts of the simulated drive from the overlay of the ENGEL-like drive: modes, homing methods, fault numbers."""

from __future__ import annotations

from typing import Final

from pdgw.dsp402.identification.overlay import overlay
from pdgw.dsp402.modes import STANDARD_HOMING_METHODS

FAMILY = overlay("engel")
FAMILY_MODES = FAMILY.modes
"""The manufacturer's values of 6060h."""
_NUMBERS = {text: number for number, text in FAMILY_MODES.items()}
_turntable = FAMILY.drive_quirks.turntable
assert _turntable is not None
TURNTABLE: Final = _turntable
"""Its mode, and the bits of the Controlword that set the direction."""
CURRENT_CONTROL = _NUMBERS["current control with dynamic speed limitation"]
SPEED_CONTROL = _NUMBERS["speed control with dynamic current limitation"]
DRIVE_FAULTS = FAMILY.drive_faults
"""Faults by the number in 200Ch."""
HOMING_METHODS = {method: (STANDARD_HOMING_METHODS | FAMILY.homing_texts)[method] for method in FAMILY.homing_methods}
"""Values of 6098h with the switch or mark that they search."""
