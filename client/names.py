"""Complete names: a parameter description has only sixteen characters for one (PROFIdrive 6.2.1.4), objects have longer names.

The data sheets of the package complete a truncated name; an unknown name stays as it is.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from pdgw import dsp402, dsp406
from pdgw.profidrive.parameters.description import NAME_LENGTH

_OBJECT = re.compile(r"^\[([0-9A-Fa-f]{4})\]\s*\nParameterName=(.+?)\s*$", re.MULTILINE)


@cache
def _names() -> Mapping[int, frozenset[str]]:
    """The names of each object in the data sheets."""
    found: dict[int, set[str]] = {}
    for package in (dsp402, dsp406):
        for path in sorted(Path(package.__path__[0], "eds").glob("*.eds")):
            for index, name in _OBJECT.findall(path.read_text(encoding="latin-1")):
                found.setdefault(int(index, 16), set()).add(name)
    return {index: frozenset(names) for index, names in found.items()}


def full_name(pnu: int, told: str) -> str:
    """The complete name for a truncated one; the truncated one itself if no name, or several names, start with it."""
    fitting = {name for name in _names().get(pnu, ()) if name[:NAME_LENGTH].rstrip() == told}
    return fitting.pop() if len(fitting) == 1 else told
