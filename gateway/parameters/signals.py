"""Which parameter or CANopen object carries a signal: P923."""

from __future__ import annotations

from pdgw.profidrive.signals import signal

SIGNAL_SOURCES: dict[str, int] = {
    "STW1": 967,
    "ZSW1": 968,
    "NSOLL_A": 0x60FF,
    "NIST_A": 0x606C,
    "NSOLL_B": 0x60FF,
    "NIST_B": 0x606C,
    "XIST_A": 0x6064,
    "SATZANW": 0x6098,
    "AKTSATZ": 0x6098,
    "MDI_TARPOS": 0x607A,
    "MDI_VELOCITY": 0x6081,
    "MDI_ACC": 0x6083,
    "MDI_DEC": 0x6084,
    "IAIST_GLATT": 0x6078,
    "NIST_A_GLATT": 0x606C,
}
"""By signal name; signals that are not here come from no single object."""

_ELEMENTS = 100


def signal_list() -> tuple[int, ...]:
    """P923: element n is the PNU that carries signal n, 0 where none does."""
    sources = [0] * _ELEMENTS
    for name, pnu in SIGNAL_SOURCES.items():
        sources[signal(name).number] = pnu
    return tuple(sources)
