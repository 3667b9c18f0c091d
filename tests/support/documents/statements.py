"""Statements of the profile, each shown by a test: the table of docs/telegrams.md is made from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from tests.support.documents.parts import write_part

PLACE = ("telegrams.md", "statements")
MODULE = "tests.gateway.axis.test_statements"
_HEAD = """| statement | source | gateway |
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


def statement_table() -> str:
    """The table of all statements."""
    import_module(MODULE)
    return _HEAD + "".join(
        f"| {item.text} | {item.source} | {f'differs: {item.differs}' if item.differs else 'agrees'} |\n"
        for item in STATEMENTS
    )


def write() -> None:
    """Write the table into the document (``make docs``)."""
    write_part(*PLACE, statement_table())
