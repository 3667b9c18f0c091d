"""DCF files of simulated drives: their data sheet with values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pdgw.ds301.eds.writer import DeviceInfo, write_eds
from pdgw.ds301.objects import Access, CanType, Entry, ObjectSpec, array, var
from pdgw.peers.drive.objects import INFO, drive_objects

MAKERS = 0x2200
"""First of the maker's objects."""


def makers_objects(count: int) -> tuple[ObjectSpec, ...]:
    """Further objects of the maker, 100 sub-indices each, and a text in 2210h."""
    specs = []
    for start in range(0, count, 100):
        index = 0x2300 + start // 100
        entries = (
            Entry(index, sub, f"Setting {start + sub}", CanType.U16, default=start + sub)
            for sub in range(1, 1 + min(100, count - start))
        )
        specs.append(array(index, "Settings", *entries))
    text = var(0x2210, "Name of the machine", CanType.VISIBLE_STRING, Access.RW, default="")
    real = var(0x2211, "Gain", CanType.REAL32, Access.RW, default=0.5)
    return (*specs, text, real)


def dcf_text(
    values: Mapping[str, object], *, objects: tuple[ObjectSpec, ...] = (), info: DeviceInfo = INFO, stamp: int = 0
) -> str:
    """The data sheet of the drive, with ParameterValues by section (``6085``, ``6094sub1``). ``stamp``: 1020h."""
    verify = array(0x1020, "Verify configuration", *(Entry(0x1020, sub, "Stamp", CanType.U32) for sub in (1, 2)))
    text = write_eds(info, (*drive_objects(), *objects, verify))
    if stamp:
        values = {**values, "1020sub1": stamp, "1020sub2": stamp}
    lines = []
    for line in text.splitlines():
        lines.append(line)
        if (section := line.strip("[]")) in values:
            lines.append(f"ParameterValue={values[section]}")
    assert len(lines) == len(text.splitlines()) + len(values), "each section is there"
    return "\n".join(lines) + "\n"


def write_dcf(path: Path, values: Mapping[str, object], **options: object) -> Path:
    """As ``dcf_text``, to a file."""
    path.write_text(dcf_text(values, **options))  # type: ignore[arg-type]
    return path
