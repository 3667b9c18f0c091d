"""The tables in the documentation are those of the declarations."""

from __future__ import annotations

from pathlib import Path

from tests.long.bench import counting
from tests.long.documents import habits, package_picture
from tests.long.documents.commands import COMMANDS_PATH, generate_commands
from tests.long.documents.tables import PATH, generate
from tests.support.documents.parts import read_part
from tests.support.documents.plc_blocks import BLOCKS_PATH, generate_blocks

DOCS = Path(__file__).parents[2] / "docs"
"""Of the project, also where the package that is tested is installed elsewhere."""


def test_docs_tables_are_up_to_date() -> None:
    assert (DOCS / PATH.name).read_text(encoding="utf-8") == generate(), "run: make docs"
    assert (DOCS / package_picture.PATH.name).read_text(encoding="utf-8") == package_picture.generate(), (
        "run: make docs"
    )
    assert read_part(*habits.PLACE) == habits.generate(), "run: make docs"


def test_documents_have_the_counts_of_the_limits() -> None:
    assert counting.MEASURED.read_text(encoding="utf-8") == counting.measured(), "run: make docs"
    assert read_part(*counting.PLACE) == counting.share_of_the_recorder(), "run: make docs"


def test_table_of_the_commands_is_up_to_date() -> None:
    assert (DOCS / COMMANDS_PATH.name).read_text(encoding="utf-8") == generate_commands(), "run: make docs"


def test_tables_of_the_plc_blocks_are_up_to_date() -> None:
    assert (DOCS / BLOCKS_PATH.name).read_text(encoding="utf-8") == generate_blocks(), "run: make docs"
