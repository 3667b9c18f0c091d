"""Which parameter or CANopen object carries a signal: P923."""

from __future__ import annotations

from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.profidrive.parameters.description import Pnu
from pdgw.profidrive.signals import signal


def _index(attribute: str) -> int:
    return DRIVE_OBJECTS.attribute(attribute).index


SIGNAL_SOURCES: dict[str, int] = {
    "STW1": Pnu.STW1,
    "ZSW1": Pnu.ZSW1,
    "NSOLL_A": _index("target_velocity"),
    "NIST_A": _index("velocity_actual"),
    "NSOLL_B": _index("target_velocity"),
    "NIST_B": _index("velocity_actual"),
    "XIST_A": _index("position_actual"),
    "SATZANW": _index("homing_method"),
    "AKTSATZ": _index("homing_method"),
    "MDI_TARPOS": _index("target_position"),
    "MDI_VELOCITY": _index("profile_velocity"),
    "MDI_ACC": _index("profile_acceleration"),
    "MDI_DEC": _index("profile_deceleration"),
    "IAIST_GLATT": _index("current_actual"),
    "NIST_A_GLATT": _index("velocity_actual"),
}
"""Source by signal name; other signals have no single source object."""

_ELEMENTS = 100


def signal_list() -> tuple[int, ...]:
    """P923: element n is the PNU that carries signal n, 0 where none does."""
    sources = [0] * _ELEMENTS
    for name, pnu in SIGNAL_SOURCES.items():
        sources[signal(name).number] = pnu
    return tuple(sources)
