"""Mutations of the package's own data sheet: every one is imported, or refused with lines; none crashes."""

from __future__ import annotations

import canopen
from hypothesis import given, settings
from hypothesis import strategies as st

from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.text import EdsError
from pdgw.peers.drive.objects import EDS_PATH

NODE = 5
LINES = EDS_PATH.read_text(encoding="ascii").splitlines()
SMALL = [line for line in LINES[: LINES.index("[1003]")] if line] + LINES[LINES.index("[1400]") : LINES.index("[1401]")]
VALUES = (
    "",
    "0x",
    "001",
    "010",
    "-1",
    "0xFFFFFFFFFF",
    "$NODEID",
    "$nodeid + 1",
    "1.0",
    "abc",
    "0x8",
    "0x9",
    "; x",
    "255",
)
NAMES = (
    "[1000]",
    "[1018sub1]",
    "[1018SUB100]",
    "[1400sub0]",
    "[DEFAULT]",
    "[]",
    "[1018Name]",
    "[2000sub3]",
    "[Comments]",
)

mutations = st.one_of(
    st.tuples(st.just("delete"), st.integers(0, 2000), st.just("")),
    st.tuples(st.just("repeat"), st.integers(0, 2000), st.just("")),
    st.tuples(st.just("swap"), st.integers(0, 2000), st.just("")),
    st.tuples(st.just("value"), st.integers(0, 2000), st.sampled_from(VALUES) | st.text(max_size=8)),
    st.tuples(st.just("insert"), st.integers(0, 2000), st.sampled_from(NAMES) | st.text(max_size=12)),
    st.tuples(
        st.just("key"), st.integers(0, 2000), st.sampled_from(("CompactSubObj=3", "SubNumber=9", "ObjectType=0x8"))
    ),
)


def mutated(base: list[str], changes: list[tuple[str, int, str]]) -> str:
    lines = list(base)
    for kind, place, text in changes:
        at = place % max(1, len(lines))
        if kind == "delete":
            del lines[at : at + 1]
        elif kind == "repeat":
            lines[at:at] = lines[at : at + 6]
        elif kind == "swap":
            lines[at : at + 2] = lines[at : at + 2][::-1]
        elif kind == "value":
            lines[at : at + 1] = [lines[at].partition("=")[0] + "=" + text] if lines else []
        else:
            lines.insert(at, text)
    return "\n".join(lines)


def check(data: bytes) -> None:
    """A file is either refused with at least one reason, or a dictionary a node can be made of, and right when repaired."""
    reasons = None
    try:
        imported = import_eds(data, NODE)
    except EdsError as error:
        reasons = error.problems
    if reasons is not None:
        assert reasons
        return
    canopen.RemoteNode(NODE, imported.dictionary)
    again = import_eds(imported.text.encode(), NODE)
    assert again.repairs == ()
    assert again.text == imported.text


@given(st.lists(mutations, min_size=1, max_size=6))
def test_mutations_of_a_small_sheet(changes: list[tuple[str, int, str]]) -> None:
    check(mutated(SMALL, changes).encode("utf-8", "surrogatepass"))


@settings(max_examples=settings().max_examples * 4 // 10)
@given(st.lists(mutations, min_size=1, max_size=30))
def test_mutations_of_the_whole_sheet(changes: list[tuple[str, int, str]]) -> None:
    check(mutated(LINES, changes).encode("utf-8", "surrogatepass"))


@given(st.integers(0, 4000), st.binary(min_size=1, max_size=8))
def test_damaged_bytes(place: int, junk: bytes) -> None:
    data = "\r\n".join(SMALL).encode()
    check(data[:place] + junk + data[place + len(junk) :])


@given(st.binary(max_size=200))
def test_any_bytes(data: bytes) -> None:
    check(data)
