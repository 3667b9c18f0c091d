"""The SDO writes that give a device the PDOs of a layout."""

from __future__ import annotations

from collections.abc import Collection

from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.node.plan import PdoPlan, plan_steps
from pdgw.ds301.node.planner import found_in_data_sheet, plan_pdos
from pdgw.ds301.pdo import PdoCapabilities, PdoLayout
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation, with_objects
from pdgw.peers.drive.objects import FAMILY


def engel_layout(operation: Operation) -> PdoLayout:
    """The layout of an operation with the objects the ENGEL-like drive has for it."""
    return with_objects(LAYOUTS[operation], FAMILY.entries)


def straight_plan(layout: PdoLayout, node_id: int, available: Collection[int], *, sync: bool = False) -> PdoPlan:
    """For a device with these communication parameters, which can map everything."""
    device = PdoCapabilities.of(layout)
    findings = found_in_data_sheet(device)
    for way, number in [*findings.cob_ids]:
        if way.communication_index + number - 1 not in available:
            del findings.cob_ids[way, number]
    return plan_pdos(layout, device, node_id, findings, sync=sync)


def pdo_steps(
    layout: PdoLayout,
    node_id: int,
    available: Collection[int],
    *,
    sync: bool = False,
    event_ms: int = 50,
    inhibit_us: int = 0,
) -> list[SdoStep]:
    """For a device with these communication parameters."""
    plan = straight_plan(layout, node_id, available, sync=sync)
    return plan_steps(plan, node_id, available, event_ms=event_ms, inhibit_us=inhibit_us)
