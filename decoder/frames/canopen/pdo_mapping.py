"""The PDOs of a recording as the drive's codec sees them, whatever the gateway that made it has mapped."""

from __future__ import annotations

from pdgw.decoder.frames.canopen.records import PdoLayout
from pdgw.ds301.pdo import Pdo, PdoDirection
from pdgw.dsp402.optional_objects import image_entry


def recorded_rpdo(layout: PdoLayout, families: tuple[str, ...]) -> Pdo | None:
    """The RPDO as it was mapped; None for one with an object that is none of the drive's, which may be of these families."""
    entries = tuple(image_entry(*address, families) for address in layout.addresses)
    known = tuple(entry for entry in entries if entry is not None and entry.attribute)
    if not known or len(known) < len(entries) or sum(entry.type.bits for entry in known) != layout.size * 8:
        return None
    return Pdo(PdoDirection.RPDO, int(layout.name.removeprefix(PdoDirection.RPDO.label)), known)
