"""Mutated DCF files, and values of each data type: read, or refused with lines; what is saved is read again."""

from __future__ import annotations

import tempfile
from datetime import datetime
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from pdgw.ds301.eds.dcf import Commissioning, read_dcf, value_of, write_dcf
from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.text import EdsError
from pdgw.ds301.values import INTEGERS
from pdgw.gateway.configuration.device_values import is_owned
from tests.fuzz.test_data_sheets import mutated, mutations
from tests.support.drives.dcf import dcf_text, makers_objects

NODE = 5
OBJECTS = makers_objects(3)
GIVEN = {
    "6085": 1200,
    "6065": "$NODEID+0x100",
    "607C": -77,
    "2210": "press 3",
    "2211": "1.25",
    "2300sub1": 7,
    "6060": 3,
}
LINES = dcf_text(GIVEN, objects=OBJECTS, stamp=15_000).splitlines()
"""The places of the values are near the end of the file: those of the manufacturer are before those of the profile."""
SMALL = [line for line in LINES[: LINES.index("[1003]")] if line] + LINES[LINES.index("[2210]") :]
DEVICE = Commissioning(NODE, 500_000, "press", (1, 2, 3, 4), datetime(2026, 11, 29))


def check(data: bytes) -> None:
    """The values of a file are writable, not owned, and the same in a file that is saved of a device that has them."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "drive.dcf"
        file.write_bytes(data)
        try:
            values = read_dcf(file, NODE, is_owned)
        except EdsError:
            return
        held = {item.address: item.encoded(4) for item in values.items}
        assert not [index for index, _ in held if is_owned(index)]
        assert all(item.is_held_by(held[item.address]) for item in values.items)
        dictionary = import_eds(file, NODE).dictionary
        for item in values.items:
            try:
                value_of(item.data_type, held[item.address])
            except ValueError:
                del held[item.address]
        file.write_text(write_dcf(dictionary, held, DEVICE, verifies=True), encoding="utf-8")
        again = {item.address: item.encoded(4) for item in read_dcf(file, NODE, is_owned).items}
        assert again == {address: data for address, data in held.items() if data or address not in held}


@settings(max_examples=100)
@given(st.lists(mutations, min_size=1, max_size=8))
def test_a_mutated_dcf_is_read_or_refused_with_lines(changes: list[tuple[str, int, str]]) -> None:
    check(mutated(SMALL, changes).encode("utf-8", "surrogatepass"))


@settings(max_examples=100)
@given(
    st.sampled_from(["6067", "6073", "6086", "609A", "2300sub2"]),
    st.text(max_size=12) | st.integers().map(str) | st.integers().map(hex),
)
def test_any_value_of_an_object_is_read_or_refused_with_its_line(section: str, value: str) -> None:
    place = SMALL.index(f"[{section}]") + 1
    check("\n".join([*SMALL[:place], f"ParameterValue={value}", *SMALL[place:]]).encode("utf-8", "surrogatepass"))


@given(st.sampled_from(sorted(INTEGERS)), st.data())
def test_each_whole_number_of_each_type_is_saved_as_itself(data_type: int, data: st.DataObject) -> None:
    bits, signed = INTEGERS[data_type]
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    value = data.draw(st.integers(low, high))
    assert int(value_of(data_type, value.to_bytes(bits // 8, "little", signed=signed))) == value
