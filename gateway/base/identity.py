"""Identification of the gateway: P964, P975 and I&M0. Its build, and what that was measured with.

The vendor and device numbers are placeholders until the configuration sets others: PI assigns them to the seller of a device.

Which build of the package runs: its version, whether its cyclic path is compiled, and the interpreter.

A pure build takes about twice the time of a compiled one for a cycle, so each log, status and measurement says which it
was.

The numbers of axes and cycle times that each build was measured with, and whether a configuration is beyond them. The figures
are in ``measured.toml``, from measurements with ``tests.long.bench exchange``.
"""

from __future__ import annotations

import platform
import sysconfig
import tomllib
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from pdgw.base.phrases import counted
from pdgw.base.version import package_version

VENDOR_ID = 0xFFFF
"""Not assigned."""
DEVICE_ID = 0x0402
ORDER_ID = "PDGW"
HARDWARE_REVISION = 1
RELEASE_YEAR = 2026
RELEASE_DAY_MONTH = 2111
"""DDMM."""
RELEASE: tuple[int, int, int] = tuple(int(part) for part in package_version().split("."))  # type: ignore[assignment]
FIRMWARE_VERSION = RELEASE[0] * 100 + RELEASE[1]
"""As P964 and P975 show it: 123 is 1.23."""


def unit(vendor_id: int, device_id: int) -> tuple[int, int, int, int, int]:
    """First elements of P964 and P975: manufacturer, type, version, date of the release."""
    return vendor_id, device_id, FIRMWARE_VERSION, RELEASE_YEAR, RELEASE_DAY_MONTH


_HOT: Final = "pdgw.gateway.links.cyclic"
"""A module that every compiled build has compiled."""
COMPILED: Final = "compiled"
PURE: Final = "pure Python"


def kind() -> str:
    """``compiled`` or ``pure Python``."""
    spec = find_spec(_HOT)
    return PURE if spec is None or (spec.origin or "").endswith(".py") else COMPILED


def interpreter() -> str:
    """Such as ``CPython 3.12.1, PGO``: built with profile-guided optimisation, if the interpreter says so. Debian's does not."""
    optimised = "--enable-optimizations" in str(sysconfig.get_config_var("CONFIG_ARGS") or "")
    return f"{platform.python_implementation()} {platform.python_version()}{', PGO' * optimised}"


def build_text() -> str:
    """Such as ``0.9.0, compiled, CPython 3.12.1, PGO``."""
    return f"{package_version()}, {kind()}, {interpreter()}"


PATH: Final = Path(__file__).with_name("measured.toml")
Row = tuple[int, float]
"""Number of axes and cycle time in milliseconds that were measured with at most 0.1 % of the cycles missed."""


def beyond_measured(axes: int, cycle_ms: float, build: str | None = None) -> str:
    """Empty, or one line: no measurement of this build (``build``: another one) had as many axes in as short a cycle."""
    document = tomllib.loads(PATH.read_text(encoding="utf-8"))
    build = kind() if build is None else build
    rows: Sequence[Row] = [(row["axes"], row["cycle_ms"]) for row in document[build]]
    if any(axes <= most and cycle_ms >= shortest for most, shortest in rows):
        return ""
    best = ", ".join(f"{most} at {shortest:g} ms" for most, shortest in rows)
    return (
        f"{counted(axes, 'axis', 'axes')} at {cycle_ms:g} ms: beyond what this build ({build}) was measured for; "
        f"measured axes: {best}. Watch the missed cycles with pdgw status"
    )
