"""The table of what acts in a mode has an entry for each mode and object, and each entry is what the gateway does."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.objects import Access
from pdgw.dsp402.acting import (
    ACTING,
    ADDED_TO_TARGET,
    HALT_SWITCHES_OFF,
    TURNS_ROUND,
    Acting,
    Effect,
    Treatment,
    acting_in,
    left_to_the_drive,
    read_acting,
)
from pdgw.dsp402.drive.left_overs import LeftOvers
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS, FURTHER_OBJECTS, STATUSWORD
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.dsp402.states import STATUS_OF, State
from pdgw.dsp402.units.mechanics import UNIT_OBJECTS
from pdgw.dsp402.units.velocity import VL_FACTORS
from tests.support.drives.data_sheets import SHEETS

_STOPS = "6007 605A 605B 605C 605D 605E"
_TORQUE = "6072 6073 60E0 60E1 6080"
_RAMPS = "607F 6083 6084 6085 6086 60A4 60C5 60C6"
FIGURES: Mapping[Mode, str] = {
    Mode.POSITION: f"{_STOPS} {_TORQUE} {_RAMPS} 607A 607B 607C 607D 607E 6065 6066 6081 6082 60F2",
    Mode.VL_VELOCITY: f"{_STOPS} {_TORQUE} 6042 6046 6047 6048 6049 604A",
    Mode.VELOCITY: f"{_STOPS} {_TORQUE} {_RAMPS} 607D 607E 60F8 60FF",
    Mode.TORQUE: f"{_STOPS} {_TORQUE} 6071 6085 6087",
    Mode.HOMING: f"{_STOPS} {_TORQUE} 607C 607E 6065 6066 607F 6085 6098 6099 609A 60C5 60C6",
    Mode.CYCLIC_POSITION: (
        f"{_STOPS} {_TORQUE} 6065 6066 607A 607B 607C 607D 607E 607F 6085 60B0 60B1 60B2 60C2 60C5 60C6"
    ),
    Mode.CYCLIC_VELOCITY: f"{_STOPS} {_TORQUE} 607D 607E 607F 6085 60B1 60B2 60C2 60C5 60C6 60F8 60FF",
    Mode.CYCLIC_TORQUE: f"{_STOPS} {_TORQUE} 6071 6085 60B2 60C2",
}
"""The inputs of the control functions of CiA 402-2, mode by mode, and the limits of drives of the market."""
STATUS_ONLY = frozenset({0x6067, 0x606D, 0x606F})
"""Windows: they change what the Statusword shows."""
RATINGS = frozenset({0x6075, 0x6076})
"""They define 1/1000 of current and torque."""
COMMANDS = frozenset({0x6040, 0x6060, 0x60FE})
"""State, mode and outputs."""
WRITTEN_BY_SDO = frozenset({0x6007, 0x6098, 0x60C2, 0x60F2})
"""Commanded without an RPDO: by guarding, homing, SYNC, and before the first relative task."""
OPERATIONS = {
    Mode.POSITION: (Operation.POSITIONING, Operation.POSITIONER),
    Mode.VL_VELOCITY: (Operation.VELOCITY, Operation.VELOCITY_WITH_POSITION, Operation.VELOCITY_WITH_LOAD),
    Mode.VELOCITY: (Operation.VELOCITY, Operation.VELOCITY_WITH_TORQUE, Operation.POSITIONER),
    Mode.TORQUE: (Operation.TRANSPARENT,),
    Mode.CYCLIC_POSITION: (Operation.CYCLIC_POSITION,),
    Mode.CYCLIC_VELOCITY: (Operation.CYCLIC_VELOCITY, Operation.VELOCITY),
    Mode.CYCLIC_TORQUE: (Operation.TRANSPARENT,),
}
"""The contents of the RPDOs in a mode."""


def indices(text: str) -> set[int]:
    return {int(index, 16) for index in text.split()}


def rows_of(mode: Mode, index: int) -> list[Acting]:
    return [row for row in acting_in({mode}) if row.entry.index == index]


@pytest.mark.parametrize("mode", Mode)
def test_every_object_that_acts_in_a_mode_has_an_entry(mode: Mode) -> None:
    missing = {index for index in indices(FIGURES[mode]) if not rows_of(mode, index)}
    assert not missing, {f"{index:04X}h" for index in missing}


def test_each_bit_of_an_object_has_one_entry_in_a_mode() -> None:
    for mode in Mode:
        taken: dict[tuple[int, int], int] = {}
        for row in acting_in({mode}):
            assert not taken.get(row.address, 0) & row.mask, (mode, row)
            taken[row.address] = taken.get(row.address, 0) | row.mask


def test_every_writable_object_of_the_profile_acts_in_a_mode_or_is_known_not_to() -> None:
    """Those of the catalogues and of the drives of the market; a new one needs a decision."""
    entries = [entry for spec in (*DRIVE_OBJECTS.objects, *FURTHER_OBJECTS) for entry in spec.entries]
    known, writable = ({item.index for item in entries}, {item.index for item in entries if item.access is Access.RW})
    profile = writable | {index for sheet in SHEETS.values() for index in sheet.indices if index not in known}
    acting = {row.entry.index for row in ACTING}
    others = STATUS_ONLY | RATINGS | COMMANDS | UNIT_OBJECTS | {*VL_FACTORS, 0x6094}
    undecided = profile - acting - others
    assert not undecided, {f"{index:04X}h" for index in undecided}
    assert not acting & others


def test_what_is_commanded_is_in_an_rpdo_of_each_telegram_with_the_mode_or_written_by_sdo() -> None:
    for mode, operations in OPERATIONS.items():
        for row in acting_in({mode}):
            if row.treatment is not Treatment.COMMANDED or row.entry.index in WRITTEN_BY_SDO:
                continue
            for operation in operations:
                carried = {name for pdo in LAYOUTS[operation].rpdos for name in pdo.attributes}
                assert row.entry.attribute in carried, (mode, operation, str(row.entry))


def test_no_value_of_an_object_that_adds_to_a_setpoint_stays_unseen() -> None:
    for row in ACTING:
        if row.effect is Effect.ADDS and row.treatment is not Treatment.COMMANDED:
            shows = left_to_the_drive({row.address: 5}, row.modes, ())
            assert row.treatment is Treatment.ZERO or any(f"{row.entry} = 5" in line for line in shows), row


@pytest.mark.parametrize(
    ("row", "fits", "wrong", "corrected"),
    [
        (HALT_SWITCHES_OFF, (1, 2, 3, 4, -1), (0,), 1),
        (TURNS_ROUND, (0x00, 0x01, 0x11), (0x40, 0x81, 0xC0), 0),
        (ADDED_TO_TARGET, (0x01, 0xC1), (0x00, 0x02, 0x40), 1),
    ],
)
def test_only_the_bits_of_an_entry_are_compared_and_corrected(
    row: Acting, fits: tuple[int, ...], wrong: tuple[int, ...], corrected: int
) -> None:
    assert all(map(row.fits, fits))
    for value in wrong:
        assert not row.fits(value)
        assert row.corrected(value) & row.mask == corrected
        assert row.corrected(value) & ~row.mask == value & ~row.mask
        with pytest.raises(Dsp402Error, match=rf"{row.entry.index:04X}h: {value} .*write {row.entry.index:04X}h"):
            row.check({row.address: value})
    row.check({})


def test_a_wrong_value_is_found_although_the_data_sheet_lacks_the_object() -> None:
    (row,) = (row for row in rows_of(Mode.CYCLIC_VELOCITY, 0x60B1))
    (limit,) = rows_of(Mode.CYCLIC_VELOCITY, 0x60E0)
    found = read_acting((row, limit), (), lambda *_: b"\x38\xff\xff\xff", {})
    assert found == {(0x60B1, 0): -200}, "a limit is read only if the data sheet has it"
    assert read_acting((row,), (), lambda *_: None, {}) == {}
    assert read_acting((row,), (), lambda *_: b"", {}) == {(0x60B1, 0): None}
    assert read_acting((row,), (), pytest.fail, {(0x60B1, 0): 7}) == {(0x60B1, 0): 7}


def test_what_is_left_to_the_drive_is_shown_with_its_values_and_not_what_an_rpdo_carries() -> None:
    found = {(0x6072, 0): 1000, (0x60E0, 0): 300, (0x60B2, 0): 0, (0x605A, 0): 2, (0x60FF, 0): 5, (0x6046, 2): 3000}
    assert left_to_the_drive(found, {Mode.CYCLIC_VELOCITY}, {(0x6072, 0)}) == (
        "limits of the drive: Positive torque limit value 60E0h = 300",
        "stops of the drive: Quick Stop Option Code 605Ah = 2",
    )
    assert "offsets of the drive: Torque offset 60B2h = -5" in left_to_the_drive({(0x60B2, 0): -5}, set(Mode), ())


class _Drive:
    """SDO access to a drive in a state; ``refuses`` each write."""

    def __init__(self, statusword: int, *, refuses: bool = False) -> None:
        self.statusword = statusword
        self.refuses = refuses
        self.written: list[tuple[int, int]] = []

    def read_number(self, index: int, subindex: int) -> int:
        assert (index, subindex) == STATUSWORD
        return self.statusword

    def do(self, step: SdoStep) -> None:
        if self.refuses:
            raise Dsp402Error("node 1", "read-only", "a drive that accepts it")
        self.written.append((step.index, step.value))


(OFFSET,) = (row for row in ACTING if row.treatment is Treatment.ZERO and row.entry.index == 0x60B1)
OFF, POWERED = STATUS_OF[State.SWITCH_ON_DISABLED], STATUS_OF[State.QUICK_STOP_ACTIVE]


def corrected(drive: _Drive, row: Acting, value: int | None) -> tuple[str, list[str], bool]:
    """Why the drive is refused, the notes, and whether the correction waits for the end of its power."""
    notes: list[str] = []
    left = LeftOvers(drive, lambda _, text: notes.append(text))  # type: ignore[arg-type]
    return left.correct((row,), {row.address: value}), notes, left.waits


def test_value_that_cannot_be_read_is_set_to_0_or_named() -> None:
    drive = _Drive(OFF)
    assert corrected(drive, OFFSET, None)[0] == ""
    assert drive.written == [(0x60B1, 0)]
    refusal, notes, _ = corrected(_Drive(OFF, refuses=True), OFFSET, None)
    assert not refusal, "it may be 0"
    assert "60B1h: the drive adds it" in notes[0]
    drive = _Drive(OFF)
    refusal, notes, _ = corrected(drive, TURNS_ROUND, None)
    assert (refusal, drive.written) == ("", [])
    assert "60F2h: bits 6 and 7 change the direction to a target; it cannot be read now" in notes[0]


@pytest.mark.parametrize("state", State)
def test_value_is_corrected_without_power_only(state: State) -> None:
    drive = _Drive(STATUS_OF[state])
    refusal, _, waits = corrected(drive, OFFSET, 200)
    powered = state in {
        State.SWITCHED_ON,
        State.OPERATION_ENABLED,
        State.QUICK_STOP_ACTIVE,
        State.FAULT_REACTION_ACTIVE,
    }
    assert bool(drive.written) is not powered
    assert (refusal != "", waits) == (powered, powered)


def test_a_relative_option_that_the_drive_keeps_is_a_note_and_no_refusal() -> None:
    refusal, notes, waits = corrected(_Drive(OFF, refuses=True), ADDED_TO_TARGET, 0)
    assert (refusal, waits) == ("", False)
    assert "60F2h = 0: relative tasks may begin at the last target, also after a stop" in notes[0]
    assert corrected(_Drive(POWERED), ADDED_TO_TARGET, 0)[2], "set when the drive is off"
