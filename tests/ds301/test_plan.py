"""The PDO plan of a node: what the planner makes of data sheet and refused writes, and the load of its frames."""

from __future__ import annotations

import pytest

from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.bus.load import GATEWAY
from pdgw.ds301.node.plan import PdoPlan, plan_steps
from pdgw.ds301.node.planner import DeviceMapping, Findings, found_in_data_sheet, plan_pdos
from pdgw.ds301.objects import CanType, Entry, ObjectAddress
from pdgw.ds301.pdo import Pdo, PdoCapabilities, PdoDirection, PdoLayout, PdoSlot

NODE = 5
RPDO, TPDO = PdoDirection


def _entry(index: int, attribute: str, type_: CanType = CanType.U16) -> Entry:
    return Entry(index, 0, attribute, type_, attribute=attribute)


SPEED, CONTROL = _entry(0x2001, "speed"), _entry(0x2002, "control")
TORQUE, RAMP = _entry(0x2003, "torque"), _entry(0x2004, "ramp")
STATUS, ACTUAL = _entry(0x3001, "status"), _entry(0x3002, "actual")
CURRENT = _entry(0x3003, "current")
LAYOUT = PdoLayout(
    rpdos=(Pdo(RPDO, 1, (SPEED, TORQUE, CONTROL)), Pdo(RPDO, 2, (RAMP,))),
    tpdos=(Pdo(TPDO, 1, (STATUS, ACTUAL)), Pdo(TPDO, 2, (CURRENT,))),
    essential=frozenset({"control", "status"}),
)
SLOTS = tuple(PdoSlot(number) for number in (1, 2, 3))
ALL = frozenset(entry.address for entry in LAYOUT.entries)


def _plan(mappable: frozenset[ObjectAddress] = ALL, findings: Findings | None = None, *, sync: bool = False) -> PdoPlan:
    device = PdoCapabilities(SLOTS, SLOTS, mappable)
    return plan_pdos(LAYOUT, device, NODE, findings or found_in_data_sheet(device), sync=sync, sync_rpdos=sync)


def _contents(plan: PdoPlan) -> dict[str, tuple[str, ...]]:
    return {str(item.pdo): item.pdo.attributes for item in (*plan.rpdos, *plan.tpdos)}


@pytest.mark.parametrize(
    ("sync", "rates"), [(False, [100, 500, 250, 100]), (True, [500, 500, 500, 500])], ids=["event-driven", "on SYNC"]
)
def test_frames_have_the_rate_of_their_cycle_and_belong_to_their_sender(sync: bool, rates: list[float]) -> None:
    """Event-driven PDOs without Controlword or Statusword are allowed 100 frames per second."""
    frames = _plan(sync=sync).frames(NODE, 500, 250, {"control", "status"})
    assert [(frame.name, frame.size, frame.cob_id, frame.sender) for frame in frames] == [
        ("RPDO2 5", 2, 0x305, GATEWAY),
        ("RPDO1 5", 6, 0x205, GATEWAY),
        ("TPDO1 5", 4, 0x185, NODE),
        ("TPDO2 5", 2, 0x285, NODE),
    ]
    assert [frame.per_second for frame in frames] == rates


def test_frame_that_is_rarer_than_100_per_second_stays_so() -> None:
    assert [frame.per_second for frame in _plan().frames(NODE, 50, 25, {"control"})] == [50, 50, 25, 25]


def test_control_and_status_are_mapped_although_the_data_sheet_forbids_it() -> None:
    """Without these two the node cannot be operated."""
    plan = _plan(frozenset({TORQUE.address, ACTUAL.address}))
    assert _contents(plan) == {"RPDO1": ("torque", "control"), "TPDO1": ("status", "actual")}
    assert (plan.written, plan.read) == ((SPEED, RAMP), (CURRENT,))


def test_fixed_mapping_that_fits_is_adopted_although_another_pdo_is_free() -> None:
    findings = found_in_data_sheet(PdoCapabilities(SLOTS, SLOTS))
    findings.fixed = {(RPDO, 2): (RAMP.mapping,), (TPDO, 2): (STATUS.mapping,)}
    plan = _plan(findings=findings)
    assert _contents(plan)["RPDO2"] == ("ramp",)
    assert [item.adopted for item in plan.rpdos] == [True, False]
    assert _contents(plan)["TPDO3"] == ("current",), "another mapping than its own"


@pytest.mark.parametrize(
    ("most", "contents", "written"),
    [
        (3, ("speed", "torque", "control"), ()),
        (2, ("speed", "control"), ("torque",)),
        (1, ("control",), ("speed", "torque")),
    ],
)
def test_pdo_that_refuses_a_number_of_objects_has_one_less(
    most: int, contents: tuple[str, ...], written: tuple[str, ...]
) -> None:
    """Until it accepts them; what has no room is written by SDO."""
    device = PdoCapabilities(SLOTS, SLOTS, ALL)
    mapping, available = DeviceMapping(lambda _index, _subindex: 0), [0x1400, 0x1401, 0x1402, 0x1800, 0x1801, 0x1802]
    mapping.survey(device, dict.fromkeys(available, 0))
    for _ in range(4):
        plan = _plan(findings=mapping.findings)
        steps = plan_steps(plan, NODE, available, event_ms=50, inhibit_us=0)
        refused = next(
            (step for step in steps if step.index == 0x1600 and step.subindex == 0 and step.value > most), None
        )
        if refused is None:
            break
        assert mapping.learn(refused, SdoAbortedError(Abort.PDO_LENGTH))
    assert _contents(plan)["RPDO1"] == contents
    assert tuple(entry.attribute for entry in plan.written) == written
    assert _contents(plan)["RPDO2"] == ("ramp",)
