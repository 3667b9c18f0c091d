"""docs/drives.md lists the shapes there are."""

from __future__ import annotations

from pathlib import Path

from pdgw.peers.drive import SHAPES

PAGE = Path(__file__).parents[2] / "docs" / "drives.md"


def test_every_shape_is_in_the_documents() -> None:
    listed = {
        line.split("`")[1] for line in PAGE.read_text().splitlines() if line.startswith("| `") and "[" not in line
    }
    assert {*SHAPES} <= listed
