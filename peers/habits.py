"""Habits of devices: what CiA 301, 402 and 406 leave open, what devices on the market do, and faults.

``habits.toml`` declares each habit once. The simulated devices have them, and tests derive from the table what a gateway must do.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

_HEX: Final = "hex"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a habit: an integer with its limits."""

    default: int
    low: int
    high: int
    meaning: str
    unit: str = ""

    def text(self, value: int) -> str:
        """A value as in documents. The unit "hex" only marks codes and bit patterns."""
        return f"{value:04X}h" if self.unit == _HEX else f"{value} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class Habit:
    """One row of the table."""

    device: str
    """"node" (any CANopen device), "drive" or "encoder"."""
    name: str
    text: str
    """What the device does."""
    source: str
    """What permits or forbids it: document with chapter, page or date; (u): unverified."""
    does: str
    """The class of the simulators."""
    parameters: Mapping[str, Parameter]
    legal_for: tuple[str, ...]
    """The devices for which it is legal: no fault, no warning, no stop."""
    fixed: Mapping[str, Any] = field(default_factory=dict)
    """Values of the class that no user sets."""
    legal: Mapping[str, Sequence[int]] = field(default_factory=dict)
    """Lowest and highest value of each parameter with which it is legal."""
    warns: bool = False
    """The gateway warns of it although it is legal."""
    cases: Sequence[Mapping[str, Any]] = ()
    """What a gateway must do in a situation, with the keys of ``tests/conformance/fault_cases.py``."""


def _habit(device: str, name: str, row: dict[str, Any]) -> Habit:
    devices = ("drive", "encoder") if device == "node" else (device,)
    legal_for = tuple(row.get("legal_for", devices if "legal" in row else ()))
    parameters = {key: Parameter(*values) for key, values in row.get("parameters", {}).items()}
    return Habit(device, name, **row | {"parameters": parameters, "legal_for": legal_for})


_TABLES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
HABITS: Final[Mapping[str, Habit]] = MappingProxyType(
    {name: _habit(device, name, row) for device, rows in _TABLES.items() for name, row in rows.items()}
)
"""The table, by name."""
