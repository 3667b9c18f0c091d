"""The SDO writes that give a device the PDOs of a layout."""

from __future__ import annotations

from collections.abc import Collection

from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.node.plan import plan_steps, straight_plan
from pdgw.ds301.pdo import PdoLayout
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation, with_objects
from pdgw.peers.drive.objects import FAMILY


def engel_layout(operation: Operation) -> PdoLayout:
    """The layout of an operation with the objects the ENGEL-like drive has for it."""
    return with_objects(LAYOUTS[operation], FAMILY.entries)


def pdo_steps(
    layout: PdoLayout,
    node_id: int,
    available: Collection[int],
    *,
    sync: bool = False,
    event_ms: int | None = 50,
    inhibit_us: int = 0,
) -> list[SdoStep]:
    """For a device with these communication parameters."""
    plan = straight_plan(layout, node_id, available, sync=sync)
    return plan_steps(plan, node_id, available, event_ms=event_ms, inhibit_us=inhibit_us)
