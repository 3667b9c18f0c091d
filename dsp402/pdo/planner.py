"""The PDO plan of a drive: the objects that this drive has for its telegram, and what it cannot be operated without.

The Controlword is the last object of its RPDO and its RPDO the last that is sent: a drive that applies objects in the order
of the mapping would start toward the previous target.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from pdgw.ds301.node import planner
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.planner import Findings
from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import PdoDirection, PdoLayout
from pdgw.dsp402.drive_type import DriveType, Dsp402Error
from pdgw.dsp402.objects import CONTROL_ATTRIBUTE, STATUS_ATTRIBUTE
from pdgw.dsp402.pdo.layouts import with_objects, without

_ESSENTIAL = {PdoDirection.RPDO: CONTROL_ATTRIBUTE, PdoDirection.TPDO: STATUS_ATTRIBUTE}


def plan_pdos(
    needs: PdoLayout, drive: DriveType, node_id: int, findings: Findings, *, sync: bool, sync_rpdos: bool = False
) -> PdoPlan:
    """As ``ds301.node.planner.plan_pdos``.

    Dsp402Error when Controlword or Statusword have no PDO, or the drive lacks an object that is not optional.
    """
    notes = not_available(needs, drive)
    needs = _fitted(without(needs, {entry.attribute for entry in _missing(needs, drive)}), drive)
    plan = planner.plan_pdos(needs, drive.pdos, node_id, findings, sync=sync, sync_rpdos=sync_rpdos)
    carried = {name for item in (*plan.rpdos, *plan.tpdos) for name in item.pdo.attributes}
    for direction, essential in _ESSENTIAL.items():
        if essential not in carried:
            raise _without(direction, drive.entry(essential), findings)
    return replace(plan, notes=(*notes, *plan.notes))


def not_available(needs: PdoLayout, drive: DriveType) -> tuple[str, ...]:
    """One line for each optional object that the drive lacks: the object, and what the drive does or shows without it."""
    missing = _missing(needs, drive)
    return tuple(f"{entry} not available: {needs.optional[entry.attribute]}" for entry in missing)


def _missing(needs: PdoLayout, drive: DriveType) -> list[Entry]:
    return [entry for entry in needs.entries if entry.attribute in needs.optional and not drive.has(entry.attribute)]


def _fitted(needs: PdoLayout, drive: DriveType) -> PdoLayout:
    """With the objects that this drive has for what travels in the PDOs."""
    for entry in needs.entries:
        if not drive.has(entry.attribute):
            raise Dsp402Error(
                str(entry) if entry.index else entry.name,
                "not an object of this drive",
                "a drive with this object: the telegram needs it",
            )
    return replace(with_objects(needs, drive.entries), essential=frozenset(_ESSENTIAL.values()))


def _without(direction: PdoDirection, word: Entry, findings: Findings) -> Dsp402Error:
    index = direction.mapping_index
    there = [
        f"{index + number - 1:04X}h with {_named(mapping)}"
        for (way, number), mapping in findings.fixed.items()
        if way is direction and (way, number) in findings.cob_ids.keys() - findings.dead
    ]
    return Dsp402Error(
        "PDOs of the drive",
        f"no {direction.name} for {word}" + (f": fixed are {'; '.join(there)}" if there else ""),
        f"a PDO that can be mapped, or one whose mapping has {word.index:04X}h and only objects of the telegram",
    )


def _named(mapping: Iterable[int]) -> str:
    return ", ".join(f"{item >> 16:04X}h" for item in mapping) or "nothing"
