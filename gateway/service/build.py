"""Which build of the package runs: its version, whether its cyclic path is compiled, and the interpreter.

A pure build takes about twice the time of a compiled one for a cycle, so each log, status and measurement says which it was.
"""

from __future__ import annotations

import platform
import sysconfig
from importlib.util import find_spec
from typing import Final

from pdgw import __version__

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
    return f"{__version__}, {kind()}, {interpreter()}"
