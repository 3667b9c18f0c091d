"""Statements of the profile, each shown by a test: the table of docs/profile-statements.md is made from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "profile-statements.md"
MODULE = "tests.gateway.axis.test_statements"
_HEAD = """# Profile statements

Each row is a statement of PROFIdrive, or of the maker of a telegram, with its public source. If the gateway differs, the row
has the reason. `tests/gateway/axis/test_statements.py` checks each statement; `tests/profidrive/test_profile_oracle.py`
compares random words and times with published tables.

| statement | source | gateway |
| --- | --- | --- |
"""


@dataclass(frozen=True, slots=True)
class Statement:
    """``differs``: why the gateway does something else; empty where it agrees."""

    text: str
    source: str
    differs: str


STATEMENTS: list[Statement] = []


def statement(text: str, source: str, differs: str = "") -> Callable[[Callable[[], None]], Callable[[], None]]:
    """The test below shows what the gateway does about this."""

    def kept(test: Callable[[], None]) -> Callable[[], None]:
        STATEMENTS.append(Statement(text, source, differs))
        return test

    return kept


def document() -> str:
    """The whole document."""
    import_module(MODULE)
    return _HEAD + "".join(
        f"| {item.text} | {item.source} | {f'differs: {item.differs}' if item.differs else 'agrees'} |\n"
        for item in STATEMENTS
    )


def write() -> None:
    """Rewrite the document (``make docs``)."""
    DOCUMENT.write_text(document(), encoding="utf-8")
