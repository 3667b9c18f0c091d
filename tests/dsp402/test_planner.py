"""The PDO planner: what it plans for each variant of drive and telegram, and for data sheets of real drives; its SDO writes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.ds301.configuration import EVENT_DRIVEN_PROFILE
from pdgw.ds301.node.plan import Pace, PdoPlan, plan_steps
from pdgw.ds301.node.planner import Findings, found_in_data_sheet
from pdgw.ds301.pdo import COB_ID_INVALID, Pdo, PdoDirection
from pdgw.dsp402.drive.client import load_eds
from pdgw.dsp402.drive.guarding import guard_steps
from pdgw.dsp402.drive_type import DriveType, Dsp402Error, Quantity
from pdgw.dsp402.identification.describe import answers_of_defaults, describe
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.dsp402.pdo.planner import plan_pdos
from pdgw.peers.drive import SHAPES
from tests.support.axis.mapping import engel_layout, pdo_steps
from tests.support.drives.drive_types import described

NODE = 5
RPDO, TPDO = PdoDirection
ENGEL = described("engel")


def plan(operation: Operation, findings: Findings | None = None, drive: DriveType = ENGEL) -> PdoPlan:
    return plan_pdos(LAYOUTS[operation], drive, NODE, findings or found_in_data_sheet(drive.pdos), sync=False)


def mapped(pdo: Pdo) -> tuple[PdoDirection, int, list[int], tuple[str, ...]]:
    """What of a PDO is not the limits of one drive."""
    return pdo.direction, pdo.number, [entry.mapping for entry in pdo.entries], tuple(pdo.attributes)


def carried(found: PdoPlan) -> set[str]:
    return {entry.attribute for entry in found.commanded if entry.attribute}


def shown(found: PdoPlan) -> set[str]:
    return set(found.shown)


def needed(operation: Operation) -> tuple[set[str], set[str]]:
    layout = LAYOUTS[operation]
    rpdos, tpdos = ({name for pdo in pdos for name in pdo.attributes} for pdos in (layout.rpdos, layout.tpdos))
    return rpdos, tpdos


@pytest.mark.parametrize("operation", list(Operation))
def test_a_drive_that_takes_any_mapping_gets_the_layout_of_the_telegram(operation: Operation) -> None:
    found, layout = plan(operation), engel_layout(operation)
    assert [mapped(item.pdo) for item in found.rpdos] == [mapped(pdo) for pdo in reversed(layout.rpdos)]
    assert [mapped(item.pdo) for item in found.tpdos] == [mapped(pdo) for pdo in layout.tpdos]
    assert not found.written
    assert not found.read
    assert not found.notes


def test_value_of_a_family_is_mapped_to_the_object_of_that_family() -> None:
    there = ENGEL.entry("dynamic_speed_limit")
    other = replace(there, index=0x2320, subindex=3)
    drive = replace(
        ENGEL,
        entries={**ENGEL.entries, "dynamic_speed_limit": other},
        pdos=replace(ENGEL.pdos, mappable=ENGEL.pdos.mappable - {(0x2003, 0)} | {(0x2320, 3)}),
    )
    found = plan(Operation.TRANSPARENT, drive=drive)
    mappings = [entry.mapping for item in found.rpdos for entry in item.pdo.entries]
    assert other.mapping in mappings
    assert there.mapping not in mappings


def test_a_drive_without_a_value_of_a_family_is_refused_by_the_name_of_the_value_alone() -> None:
    drive = described("rpm")
    with pytest.raises(Dsp402Error, match=r"^Dynamic Speed Limit: 'not an object of this drive'"):
        plan_pdos(LAYOUTS[Operation.TRANSPARENT], drive, NODE, found_in_data_sheet(drive.pdos), sync=False)


@pytest.mark.parametrize("operation", list(Operation))
def test_the_controlword_is_last_in_its_pdo_and_its_pdo_is_sent_last(operation: Operation) -> None:
    found = plan(operation)
    assert [item for item in found.rpdos if "controlword" in item.pdo.attributes] == [found.rpdos[-1]]
    assert found.rpdos[-1].pdo.attributes[-1] == "controlword"


@pytest.mark.parametrize("name", SHAPES)
def test_a_plan_has_all_that_is_needed_once_or_names_the_object_that_is_missing(name: str) -> None:
    for operation in Operation:
        check_plan(operation, described(name))


def check_plan(operation: Operation, drive: DriveType) -> None:
    rpdos, tpdos = needed(operation)
    spare, optional = LAYOUTS[operation].cyclic_only, LAYOUTS[operation].optional.keys()
    if not all(drive.has(attribute) for attribute in (rpdos | tpdos) - optional):
        with pytest.raises(Dsp402Error, match="not an object of this drive"):
            plan(operation, drive=drive)
        return
    found = plan(operation, drive=drive)
    missing = {attribute for attribute in optional if not drive.has(attribute)}
    assert carried(found) == rpdos - missing
    assert tpdos - missing - spare <= shown(found) <= tpdos - missing
    assert len([note for note in found.notes if "not available" in note]) >= len(missing)
    names = [name for item in found.rpdos for name in item.pdo.attributes]
    assert len(names) == len(set(names))
    assert len({item.cob_id for item in (*found.rpdos, *found.tpdos)}) == len(found.rpdos) + len(found.tpdos)


def test_predefined_pdos_that_are_fixed_are_adopted_and_the_rest_goes_by_sdo() -> None:
    found = plan(Operation.POSITIONING, drive=described("fixed-pdo"))
    assert found.lines == (
        "RPDO3 401h: Controlword 6040h, Target Position 607Ah; its own mapping; its own COB-ID",
        "TPDO2 281h: Statusword 6041h, Modes of Operation Display 6061h; on change and by event timer; its own mapping; "
        "its own COB-ID",
        "TPDO3 381h: Position Actual Value 6064h; on change and by event timer; its own mapping; its own COB-ID",
        "TPDO4 481h: Velocity Actual Value 606Ch; on change and by event timer; its own mapping; its own COB-ID",
        "written by SDO when they change: Modes of Operation 6060h, Profile Velocity 6081h, Profile Acceleration 6083h, "
        "Profile Deceleration 6084h",
    )
    # TPDO 3 brings the Statusword too; it is taken from one PDO alone.
    assert [item.pdo.attributes for item in found.tpdos][1] == ("position_actual",)
    assert found.tpdos[1].pdo.size == 6


def test_rpdo_with_an_object_without_a_value_is_not_used() -> None:
    findings = found_in_data_sheet(ENGEL.pdos)
    findings.fixed = dict.fromkeys(findings.cob_ids, ())
    findings.fixed[RPDO, 1] = (0x6040_0010, 0x6071_0010)
    findings.fixed[RPDO, 2] = (0x0005_0008, 0x6040_0010)
    findings.fixed[TPDO, 1] = (0x6041_0010, 0x200C_0010, 0x606C_0020)
    found = plan(Operation.VELOCITY, findings)
    assert [item.pdo.number for item in found.rpdos] == [2]
    assert found.rpdos[0].pdo.size == 3
    assert [entry.attribute for entry in found.written] == ["target_velocity"]
    assert found.tpdos[0].pdo.attributes == ("statusword", "velocity_actual")
    assert found.tpdos[0].pdo.size == 8


def test_without_any_pdo_for_the_controlword_the_drive_is_refused_with_what_it_has() -> None:
    findings = found_in_data_sheet(ENGEL.pdos)
    findings.fixed = {(RPDO, number): (0x6071_0010,) for number in range(1, 6)}
    with pytest.raises(Dsp402Error, match="no RPDO for Controlword 6040h: fixed are 1600h with 6071h; 1601h"):
        plan(Operation.VELOCITY, findings)


def test_objects_that_cannot_be_mapped_go_by_sdo() -> None:
    findings = found_in_data_sheet(ENGEL.pdos)
    findings.unmappable |= {(0x607A, 0), (0x6061, 0)}
    found = plan(Operation.POSITIONING, findings)
    assert [entry.index for entry in found.written] == [0x607A]
    assert [entry.index for entry in found.read] == [0x6061]
    assert found.rpdos[-1].pdo.attributes == ("modes_of_operation", "controlword")


def test_a_pdo_takes_no_more_objects_than_the_drive_allows_and_keeps_the_controlword() -> None:
    findings = found_in_data_sheet(ENGEL.pdos)
    findings.most[RPDO, 1] = 1
    found = plan(Operation.VELOCITY, findings)
    assert found.rpdos[-1].pdo.attributes == ("controlword",)


@pytest.mark.parametrize(
    ("timer", "type_", "pace"),
    [(True, None, Pace.TIMER), (False, None, Pace.SYNC), (False, 255, Pace.CHANGE), (True, 1, Pace.SYNC)],
)
def test_transmission_type_of_a_tpdo_is_one_the_drive_supports(timer: bool, type_: int | None, pace: Pace) -> None:
    findings = found_in_data_sheet(ENGEL.pdos)
    if not timer:
        findings.timerless.add((TPDO, 1))
    if type_ is not None:
        findings.types[TPDO, 1] = type_
    found = plan(Operation.VELOCITY, findings)
    assert found.tpdos[0].pace is pace
    assert found.needs_sync is (pace is Pace.SYNC)
    assert bool(found.notes) is (pace is not Pace.TIMER)
    # Where silence says nothing, the values are asked for.
    assert bool(found.read) is (pace is Pace.CHANGE)


def test_tpdo_that_waits_for_remote_requests_is_replaced_by_another() -> None:
    findings = found_in_data_sheet(ENGEL.pdos)
    findings.types[TPDO, 1] = 253
    found = plan(Operation.VELOCITY, findings)
    assert (found.tpdos[0].pdo.number, found.tpdos[0].pdo.attributes[0]) == (3, "statusword")
    assert found.notes == (
        "TPDO1 not used: its transmission type 253 is neither on SYNC nor event-driven, and cannot be written",
    )


def test_drive_whose_tpdos_all_wait_for_remote_requests_is_refused() -> None:
    findings = found_in_data_sheet(ENGEL.pdos)
    findings.types = dict.fromkeys(((TPDO, number) for number in range(1, 6)), 252)
    with pytest.raises(Dsp402Error, match="no TPDO for Statusword 6041h"):
        plan(Operation.VELOCITY, findings)


def test_tpdo_on_sync_after_a_change_is_also_read_by_sdo() -> None:
    findings = found_in_data_sheet(ENGEL.pdos)
    findings.types[TPDO, 1] = 0
    found = plan(Operation.VELOCITY, findings)
    assert (found.tpdos[0].pace, found.tpdos[0].type, found.needs_sync) == (Pace.CHANGE, 0, True)
    assert [entry.attribute for entry in found.read] == ["statusword", "velocity_actual"]


def test_cob_ids_that_cannot_be_written_are_kept_and_others_beyond_the_fifth_too() -> None:
    slots = [replace(slot, number=slot.number + 20) if slot.number > 1 else slot for slot in ENGEL.pdos.rpdos]
    drive = replace(ENGEL, pdos=replace(ENGEL.pdos, rpdos=tuple(slots)))
    findings = found_in_data_sheet(drive.pdos)
    findings.kept.add((RPDO, 1))
    findings.cob_ids |= {(RPDO, 1): 0x4000_0321, (RPDO, 22): 0x333, (RPDO, 23): 0x8000_0000}
    found = plan(Operation.POSITIONING, findings, drive)
    assert [(item.pdo.number, item.cob_id, item.keeps_cob_id) for item in found.rpdos][-1] == (1, 0x321, True)
    assert (22, 0x333, True) in [(item.pdo.number, item.cob_id, item.keeps_cob_id) for item in found.rpdos]
    steps = plan_steps(found, NODE, {item.pdo.communication_index for item in found.rpdos}, event_ms=50, inhibit_us=0)
    assert not [step for step in steps if step.is_cob_id and step.index in (0x1400, 0x1415)]


@given(
    fixed=st.sets(st.tuples(st.sampled_from(PdoDirection), st.integers(1, 5))),
    absent=st.sets(st.tuples(st.sampled_from(PdoDirection), st.integers(1, 5))),
    unmappable=st.sets(st.sampled_from(sorted(ENGEL.pdos.mappable - {(0x6040, 0), (0x6041, 0)}))),
    timerless=st.sets(st.tuples(st.just(TPDO), st.integers(1, 5))),
    operation=st.sampled_from(Operation),
)
def test_any_findings_give_a_plan_with_everything_or_a_refusal(
    fixed: set[tuple[PdoDirection, int]],
    absent: set[tuple[PdoDirection, int]],
    unmappable: set[tuple[int, int]],
    timerless: set[tuple[PdoDirection, int]],
    operation: Operation,
) -> None:
    findings = found_in_data_sheet(ENGEL.pdos)
    findings.cob_ids = {key: cob_id for key, cob_id in findings.cob_ids.items() if key not in absent}
    findings.fixed = dict.fromkeys(fixed, (0x6040_0010,)) | {key: (0x6041_0010,) for key in fixed if key[0] is TPDO}
    findings.unmappable |= unmappable
    findings.timerless |= timerless
    if {direction for direction, _ in findings.cob_ids} != set(PdoDirection):
        with pytest.raises(Dsp402Error, match="PDOs of the drive"):
            plan(operation, findings)
        return
    found = plan(operation, findings)
    rpdos, tpdos = needed(operation)
    assert carried(found) == rpdos
    spare = LAYOUTS[operation].cyclic_only
    assert tpdos - spare <= shown(found) <= tpdos
    assert not {entry.attribute for entry in found.read} & spare, "by SDO it would be too old"
    steps = plan_steps(
        found, NODE, {0x1400 + n for n in range(5)} | {0x1800 + n for n in range(5)}, event_ms=50, inhibit_us=0
    )
    valid = {step.index for step in steps if step.is_cob_id and not step.value & COB_ID_INVALID}
    assert valid == {item.pdo.communication_index for item in (*found.rpdos, *found.tpdos)}
    assert {item.type for item in found.rpdos} == {EVENT_DRIVEN_PROFILE}


# -- data sheets that differ in one thing -----------------------------------------------------------------------------


FOLDER = Path(__file__).parent / "eds"
DEMAND = "the bit for speed within tolerance is 0; a frozen ramp keeps the actual speed"
NO_DEMAND = f"Velocity Demand Value 606Bh not available: {DEMAND}"
PLANS = {
    "fixed-pdo": (
        "RPDO2 305h: Controlword 6040h, Target velocity 60FFh; its own mapping; its own COB-ID",
        "TPDO2 285h: Velocity actual value 606Ch, Statusword 6041h; on change and by event timer; its own mapping; "
        "its own COB-ID",
        NO_DEMAND,
    ),
    "no-event-timer": (
        "RPDO1 205h: Target velocity 60FFh, Controlword 6040h",
        "TPDO1 185h: Statusword 6041h, Velocity actual value 606Ch; on SYNC",
        NO_DEMAND,
        "TPDO1 on SYNC: it has no event timer (1800h/5)",
    ),
    "unmappable": (
        "RPDO1 205h: Controlword 6040h",
        "TPDO1 185h: Statusword 6041h, Velocity actual value 606Ch; on change and by event timer",
        "written by SDO when they change: Target velocity 60FFh",
        NO_DEMAND,
    ),
    "own-cob-ids": (
        "RPDO1 32Ah: Target velocity 60FFh, Controlword 6040h; its own COB-ID",
        "TPDO1 1AAh: Statusword 6041h, Velocity actual value 606Ch; on change and by event timer; its own COB-ID",
        NO_DEMAND,
    ),
    "vl": (
        "RPDO1 205h: vl target velocity 6042h, Controlword 6040h",
        "TPDO1 185h: Statusword 6041h, vl velocity actual value 6044h; on change and by event timer",
        f"vl velocity demand 6043h not available in a PDO: {DEMAND}",
    ),
}


def _drive(name: str) -> DriveType:
    dictionary = load_eds(FOLDER / f"{name}.eds", NODE)
    return describe(dictionary, answers_of_defaults(dictionary))


def test_every_data_sheet_has_its_plan() -> None:
    assert {path.stem for path in FOLDER.glob("*.eds")} == {*PLANS}


@pytest.mark.parametrize("name", PLANS)
def test_the_plan_of_telegram_1_is_what_the_data_sheet_allows(name: str) -> None:
    drive = _drive(name)
    assert drive.scaling.reference(Quantity.SPEED) == 3000
    found = plan_pdos(LAYOUTS[Operation.VELOCITY], drive, NODE, found_in_data_sheet(drive.pdos), sync=False)
    assert found.lines == PLANS[name]


@pytest.mark.parametrize("name", PLANS)
def test_positioning_is_refused_with_the_object_that_is_missing(name: str) -> None:
    drive = _drive(name)
    with pytest.raises(Dsp402Error, match="Target Position 607Ah: 'not an object of this drive'"):
        plan_pdos(LAYOUTS[Operation.POSITIONING], drive, NODE, found_in_data_sheet(drive.pdos), sync=False)


# -- the SDO writes ---------------------------------------------------------------------------------------------------


FOUR = [direction.communication_index + n for direction in PdoDirection for n in range(4)]
FIVE = [direction.communication_index + n for direction in PdoDirection for n in range(5)]


@pytest.mark.parametrize("operation", list(Operation))
@pytest.mark.parametrize("available", [FOUR, FIVE])
def test_afterwards_exactly_the_pdos_of_the_layout_are_valid(operation: Operation, available: list[int]) -> None:
    layout = LAYOUTS[operation]
    steps = pdo_steps(layout, 4, available, sync=False, event_ms=50, inhibit_us=0)
    last = {step.index: step.value for step in steps if step.subindex == 1 and step.index in available}
    assert set(last) == set(available)
    valid = {index for index, value in last.items() if not value & COB_ID_INVALID}
    wanted = {pdo.communication_index for pdo in (*layout.rpdos, *layout.tpdos)}
    assert valid == wanted & set(available)
    assert not [step for step in steps if step.index & 0x1FF == 4 and available is FOUR]


@pytest.mark.parametrize(("sync", "rpdo", "tpdo"), [(False, 255, 255), (True, 255, 1)])
def test_sync_changes_the_tpdos_only(sync: bool, rpdo: int, tpdo: int) -> None:
    steps = pdo_steps(LAYOUTS[Operation.POSITIONING], 4, FIVE, sync=sync, event_ms=50, inhibit_us=1000)
    types = {step.index: step.value for step in steps if step.subindex == 2 and step.index in FIVE}
    assert {value for index, value in types.items() if index < 0x1800} == {rpdo}
    assert {value for index, value in types.items() if index >= 0x1800} == {tpdo}
    times = {(step.subindex, step.value) for step in steps if step.index == 0x1800 and step.subindex in {3, 5}}
    assert times == (set() if sync else {(3, 10), (5, 50)})


def test_guarding_is_set_both_ways_before_the_drive_starts() -> None:
    steps = guard_steps(127, 300, 100, -1)
    assert [(s.index, s.subindex, s.data.hex()) for s in steps] == [
        (0x1016, 1, "2c017f00"),
        (0x6007, 0, "ffff"),
        (0x1017, 0, "6400"),
    ]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((128, 300, 100, 3), r"gateway node-ID: 128.*1\.\.127"),
        ((127, 65536, 100, 3), r"65536 ms.*0\.\.65535 ms"),
        ((127, 300, 65536, 3), r"1017h/0: 65536.*0\.\.65535"),
        ((127, 300, 100, 40000), r"6007h/0: 40000.*-32768\.\.32767"),
    ],
)
def test_a_value_that_does_not_fit_its_object_is_named(values: tuple[int, int, int, int], message: str) -> None:
    with pytest.raises(Dsp402Error, match=message):
        guard_steps(*values)
