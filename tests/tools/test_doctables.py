"""The tables in the documentation are those of the declarations."""

from __future__ import annotations

from pdgw.tools.doctables import (
    MISBEHAVIOUR_PATH,
    PATH,
    POWER_PATH,
    WORDS_PATH,
    generate,
    generate_misbehaviour,
    generate_power_table,
    generate_words,
)


def test_docs_tables_are_up_to_date() -> None:
    assert PATH.read_text(encoding="utf-8") == generate(), "run: make docs"
    assert MISBEHAVIOUR_PATH.read_text(encoding="utf-8") == generate_misbehaviour(), "run: make docs"
    assert POWER_PATH.read_text(encoding="utf-8") == generate_power_table(), "run: make docs"
    assert WORDS_PATH.read_text(encoding="utf-8") == generate_words(), "run: make docs"
