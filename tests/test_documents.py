"""The documents: every command in them exists with its options, every file they name is there."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from pdgw.tools.cli import app

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
INLINE = re.compile(r"`(pdgw [^`]+)`")
BLOCK = re.compile(r"^(?: {4,}| *\$ )(pdgw .+)$", re.MULTILINE)
_LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
_ANCHOR = re.compile(r"\]\(([^)#\s:]*\.md)?#([^)\s]+)\)")
_WORD = re.compile(r"[a-z][a-z-]*")


def commands(text: str) -> Iterator[str]:
    """The commands without comments; a command may continue in the next line of prose."""
    for pattern in (INLINE, BLOCK):
        for match in pattern.finditer(text):
            yield " ".join(re.split(r"  #| # | > | &(?:$| )", match[1])[0].split())


def resolve(words: list[str]) -> tuple[Any, list[str]]:
    """The command of the first words, and the remaining words."""
    command: Any = get_command(app)
    context = command.make_context("pdgw", [], resilient_parsing=True)
    while hasattr(command, "commands") and words:
        if words[0] in {option for item in command.params if getattr(item, "is_flag", False) for option in item.opts}:
            words = words[1:]  # a switch of the group, before its command
            continue
        if not _WORD.fullmatch(words[0]):
            break
        name, command, rest = command.resolve_command(context, words)
        assert command is not None, name
        context = command.make_context(name, [], parent=context, resilient_parsing=True)
        words = list(rest)
    return command, words


ALL = sorted({(path.name, command) for path in DOCUMENTS for command in commands(path.read_text())})


@pytest.mark.parametrize(("document", "text"), ALL)
def test_every_command_exists_with_its_options(document: str, text: str) -> None:
    rest_of_line = text.removeprefix("pdgw").replace("...", "").replace("|", " ")
    words = [word.strip(",;.") for word in shlex.split(rest_of_line)]
    if words and not _WORD.fullmatch(words[0]) and not words[0].startswith("-"):
        pytest.skip("a placeholder")
    command, rest = resolve(words)
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    known |= {"-h", "--help"}
    for word in rest:
        if re.match(r"--?[a-z]", word):
            assert word.partition("=")[0] in known, f"{document}: {text}: {word}"


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_leads_to_a_file(path: Path) -> None:
    for target in _LINK.findall(path.read_text()):
        if "://" not in target:
            assert (path.parent / target).exists(), target


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_into_a_document_leads_to_a_heading(path: Path) -> None:
    for target, anchor in _ANCHOR.findall(path.read_text()):
        text = (path.parent / target if target else path).read_text()
        slugs = {
            re.sub(r"[^\w -]", "", title.lower()).strip().replace(" ", "-")
            for title in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
        }
        assert anchor in slugs, f"{target}#{anchor}"


def test_files_named_in_architecture_exist() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.*) \| (`.*`) \|$", text.partition("## Where is")[2].partition("\n## ")[0], re.MULTILINE)
    assert len(rows) >= 20
    files = [file for _, named in rows for file in re.findall(r"`([^`]+)`", named)]
    assert [file for file in files if not (ROOT / file).is_file()] == []
