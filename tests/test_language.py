"""The language of everything a person reads: no word of the list in ``tests/language.toml``.

Read are the help of every command, the texts of messages, the texts of the web page, the documents, and the docstrings and
comments of all packages, and the names of their and the tests' files, functions, classes and constants.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest

from pdgw.tools.command_table import COMMANDS, GROUPS
from tests.support.documents.sources import QUOTED, ROOMS, within

ROOT: Final = Path(__file__).parents[1]
_DATA: Final = tomllib.loads((ROOT / "tests/language.toml").read_text("utf-8"))
RULES: Final = [(re.compile(rf"\b(?:{rule['pattern']})\b", re.IGNORECASE), rule["instead"]) for rule in _DATA["rule"]]
EXCEPTIONS: Final = _DATA["exception"]
OLD_NAMES: Final[list[str]] = _DATA["names"]["old"]
"""Names with a word of the list that files of users have. No name is added."""
_ANY: Final = re.compile("|".join(rule.pattern for rule, _ in RULES), re.IGNORECASE)
"""Nearly no text has a word of a rule."""
PACKAGES: Final = (*ROOMS, "tests/long")
_DEFINED: Final = re.compile(r"^ *(?:(?:async )?def |class |(?=[A-Z_]+\b(?::.*)? = ))(\w+)", re.MULTILINE)
_COMMENT: Final = re.compile(rf"{QUOTED}|(#.*)")
_WORDS: Final = 3
"""A literal with fewer words is a name or a key."""


def without_code(text: str) -> str:
    """A text without code between backticks, quoted values and placeholders."""
    return re.sub(r"`[^`]*`|\{[^{}]*\}|%[sdgr]", "x", text)


def found_in(text: str) -> list[str]:
    """What a text has of the list, each with what to write instead."""
    plain = without_code(text)
    if _ANY.search(plain) is None:
        return []
    return [
        f"{match[0]!r} (write: {instead})"
        for rule, instead in RULES
        for match in rule.finditer(plain)
        if not any(
            item["text"] in text and re.fullmatch(item["pattern"], match[0], re.IGNORECASE) for item in EXCEPTIONS
        )
    ]


def literals(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """The texts of a module with at least three words, by line; docstrings are left out."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else "x" for part in node.values]
            text = "".join(map(str, parts))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and not isinstance(tree, ast.Expr):
            text = node.value
        else:
            yield from literals(node)
            continue
        if len(re.findall(r"[A-Za-z]{2,}", text)) >= _WORDS and " " in text.strip():
            yield node.lineno, text


def helps(command: Any) -> Iterator[str]:
    """The help of a command, its options and the commands below it."""
    yield command.help or ""
    yield from (str(getattr(item, "help", None) or "") for item in command.params)
    for item in getattr(command, "commands", {}).values():
        yield from helps(item)


def page_texts(source: str) -> Iterator[tuple[int, str]]:
    """The texts of a script or page: between tags, in attributes for people, and quoted literals with words."""
    for number, line in enumerate(source.splitlines(), 1):
        code = re.sub(r"^\s*//.*|\s//\s.*", "", line)
        for text in re.findall(r">([^<>]+)<|\"([^\"]*)\"|`([^`]*)`", code):
            for part in text:
                plain = re.sub(r"\$\{[^}]*\}|<[^>]*>|class=\S+", " ", part)
                if len(re.findall(r"[A-Za-z]{2,}", plain)) > 1 and not re.search(r"[=;{}]", plain):
                    yield number, plain.strip()


def prose(document: str) -> Iterator[tuple[int, str]]:
    """The lines of a document without its blocks of code."""
    fenced = False
    for number, line in enumerate(document.splitlines(), 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        elif not fenced and not line.startswith("    "):
            yield number, re.sub(r"\]\([^)]*\)", "]", line)


@pytest.mark.parametrize("name", [*COMMANDS, *(f"{group} {name}" for group in GROUPS for name in GROUPS[group])])
def test_the_help_has_no_word_of_the_list(name: str) -> None:
    group, _, own = name.rpartition(" ")
    entry = GROUPS[group][own] if group else COMMANDS[own]
    wrong = {text: found for text in helps(entry.load(own)) if (found := found_in(text))}
    assert not wrong


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """The documentation of a module, its classes, functions and values."""
    for statement in within(tree):
        value = statement.value if isinstance(statement, ast.Expr) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield value.lineno, value.value.replace("``", "`")


def comments(source: str) -> Iterator[tuple[int, str]]:
    """The comments of a module, by line."""
    for match in _COMMENT.finditer(source):
        if match[1]:
            yield source.count("\n", 0, match.start()) + 1, match[1].replace("``", "`")


def names(module: str, source: str) -> Iterator[str]:
    """The names of a module, its functions, classes and constants, as words."""
    for name in (module, *_DEFINED.findall(source)):
        yield re.sub(r"(?<=[a-z0-9])(?=[A-Z])|_", " ", name).strip().lower()


class Texts(NamedTuple):
    """What the modules of a package contain, messages and notes with their places. ``notes``: docstrings and comments."""

    messages: list[tuple[str, str]]
    notes: list[tuple[str, str]]


def texts_of(package: str) -> Texts:
    """The texts of a package without its tests."""
    found = Texts([], [])
    for path in sorted((ROOT / package).rglob("*.py")):
        if path.name.startswith("test_"):
            continue
        source = path.read_text("utf-8")
        tree, place = ast.parse(source), path.relative_to(ROOT)
        found.messages.extend((f"{place}:{line}", text) for line, text in literals(tree))
        found.notes.extend((f"{place}:{line}", text) for line, text in (*docstrings(tree), *comments(source)))
    return found


def wrong_in(texts: Iterable[tuple[object, str]]) -> list[str]:
    """Place and beginning of each text with a word of the list."""
    return [f"{place}: {found}: {' '.join(text.split())[:90]}" for place, text in texts if (found := found_in(text))]


def test_names_have_no_word_of_the_list() -> None:
    paths = (path for package in (*PACKAGES, "tests") for path in (ROOT / package).rglob("*.py"))
    defined = {name for path in paths for name in names(path.stem, path.read_text("utf-8"))}
    found = {name: wrong for name in defined if (wrong := found_in(name))}
    assert {name: wrong for name, wrong in found.items() if name not in OLD_NAMES} == {}
    assert set(OLD_NAMES) - found.keys() == set(), "renamed: remove it from tests/language.toml"


def test_the_page_has_no_word_of_the_list() -> None:
    folder = ROOT / "tools/web/static"
    wrong = wrong_in(
        (f"{path.relative_to(ROOT)}:{line}", text)
        for path in sorted([*folder.glob("*.html"), *folder.glob("*.js"), *(folder / "views").glob("*.js")])
        for line, text in page_texts(path.read_text("utf-8"))
    )
    assert not wrong, "\n".join(wrong)


BESIDE: Final = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")
"""Documents beside those of ``docs/``."""
DOCUMENTS: Final = (*BESIDE, *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md")))


def test_neither_packages_nor_documents_have_a_word_of_the_list() -> None:
    """And every exception has a reason and is needed."""
    packages = [texts_of(package) for package in PACKAGES]
    messages = [
        *(item for texts in packages for item in texts.messages),
        *((f"{name}:{line}", text) for name in DOCUMENTS for line, text in prose((ROOT / name).read_text("utf-8"))),
    ]
    wrong = wrong_in([*messages, *(item for texts in packages for item in texts.notes)])
    assert not wrong, "\n".join(wrong)
    for item in EXCEPTIONS:
        pattern = re.compile(rf"\b(?:{item['pattern']})\b", re.IGNORECASE)
        assert item["reason"], item
        assert any(item["text"] in text and pattern.search(without_code(text)) for _, text in messages), item


def test_the_gate_finds_a_word_of_the_list_in_each_kind_of_text() -> None:
    assert found_in("the drive obeys the PLC")
    assert not found_in("set `stand_by` and {told}")
    assert [text for _, text in literals(ast.parse('x = f"the axis {told} stands there"'))] == [
        "the axis x stands there"
    ]
    assert [text for _, text in page_texts("html`<p>Nobody is here.</p>`")] == ["Nobody is here."]
    assert [text for _, text in docstrings(ast.parse('x = 1\n"""Told ``so``."""\n'))] == ["Told `so`."]
    assert [text for _, text in comments("x = 1  # told `so`\n")] == ["# told `so`"]
    source = "class OldStory:\n    def tell_all(self): ...\n\n\n_SO_FAR = 1\nlocal = 2\n"
    assert [*names("a", source)] == ["a", "old story", "tell all", "so far"]
    assert [text for _, text in prose("a\n```\ntold\n```\n[b](told.md)")] == ["a", "[b]"]
