"""The pure lists of SDO writes: what they cover, and values that fit no object."""

from __future__ import annotations

import pytest

from pdgw.ds301.pdo import COB_ID_INVALID, PdoDirection
from pdgw.dsp402.drive.guarding import guard_steps
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from tests.support.axis.mapping import pdo_steps

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
