"""What the web site has beside ``docs/``: the README as its first page, changelog, contributing, examples, and the API reference.

Hooks of mkdocs (``make site``). Pages that only list what is elsewhere are generated, so that nothing is written twice.
Each table of ``docs/tables.md`` is a page.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import pdgw

_ROOT = Path(__file__).parent.parent
_ROOMS = sorted(file.parent.name for file in _ROOT.glob("*/__init__.py") if file.parent.name not in {"pdgw", "tests"})
"""Packages with a page of the API reference."""
_FOLDERS = {"docs/examples": "python", "tools/scenarios": "yaml", "docs/measured": "text"}
"""Folders the documents link to, each a page with its files."""
_BESIDE = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
"""Documents of the repository outside ``docs/``."""
_RENAMED = {"README.md": "index.md", "LICENSE": "LICENSE.md"}
_TABLES = "tables.md"
_TABLE_LINE = f"For engineers who search for one row of this table, one of the [reference tables]({_TABLES})."
_DIAGRAM = re.compile(r"^```mermaid\n.*?^```\n", re.MULTILINE | re.DOTALL)
"""Source of a diagram of what the table before it says; no script of another host draws it."""
_API_IN_SEARCH = "---\nsearch: {boost: 0.01}\n---\n\n"
"""A search finds the documents before the names of the library."""
_LINK = re.compile(r"\[(?P<text>[^\]]*)\]\((?P<target>[^):#\s]+)(?P<rest>(?:#[^)\s]*)?)\)")


def _front_door() -> str:
    """Each name of ``import pdgw`` with its documentation."""
    lines = [
        f"{_API_IN_SEARCH}# Front door",
        "",
        "`import pdgw` has these names; each is loaded when it is first used.",
        "",
    ]
    for name in pdgw.__all__:
        if name != "__version__":
            thing = getattr(pdgw, name)
            # Links lead to the page of its room.
            shown = f"heading: pdgw.{name}, toc_label: {name}"
            lines += [f"::: {thing.__module__}.{name}", f"    options: {{skip_local_inventory: true, {shown}}}", ""]
    return "\n".join(lines)


def _room(room: str) -> str:
    options = "    options: {show_submodules: true, show_root_heading: false, show_root_toc_entry: false}"
    return f"{_API_IN_SEARCH}# pdgw.{room}\n\n::: pdgw.{room}\n{options}\n"


def _folder(folder: str, language: str) -> str:
    lines = [f"# {folder}", ""]
    for path in sorted((_ROOT / folder).glob("*.*")):
        lines += [f"## {path.name}", "", f"```{language}", path.read_text().rstrip(), "```", ""]
    return "\n".join(lines)


def _slug(title: str) -> str:
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", title.lower()).strip())


def _tables() -> tuple[str, dict[str, str]]:
    """The introduction of the tables, and the text of each by its title."""
    introduction, *parts = re.split(r"^## ", (_ROOT / "docs" / _TABLES).read_text(), flags=re.MULTILINE)
    return introduction, {title: text for title, _, text in (part.partition("\n") for part in parts)}


def _table_place(anchor: str) -> str:
    """The page of a heading of the tables, with the heading where it is not the page's own."""
    for title, text in _tables()[1].items():
        if _slug(title) == anchor:
            return f"tables/{anchor}.md"
        if anchor in map(_slug, re.findall(r"^### (.*)$", text, re.MULTILINE)):
            return f"tables/{_slug(title)}.md#{anchor}"
    return _TABLES


def _generated() -> Iterator[tuple[str, str]]:
    yield "index.md", (_ROOT / "README.md").read_text()
    for name in _BESIDE:
        yield name, (_ROOT / name).read_text()
    yield "LICENSE.md", f"# License\n\n```\n{(_ROOT / 'LICENSE').read_text()}```\n"
    for folder, language in _FOLDERS.items():
        yield f"{folder.removeprefix('docs/')}.md", _folder(folder, language)
    introduction, tables = _tables()
    yield _TABLES, introduction + "\n".join(f"* [{title}](tables.md#{_slug(title)})" for title in tables) + "\n"
    for title, text in tables.items():
        shown = re.sub(r"^###", "##", _DIAGRAM.sub("", text), flags=re.MULTILINE)
        yield f"tables/{_slug(title)}.md", f"# {title}\n\n{_TABLE_LINE}\n{shown}"
    yield "api.md", _front_door()
    for room in _ROOMS:
        yield f"api/{room}.md", _room(room)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """The pages of the tables are in the navigation after their list."""
    pages = [_TABLES, *(f"tables/{_slug(title)}.md" for title in _tables()[1])]
    for section in filter(lambda item: isinstance(item, dict), config.nav or []):
        for items in section.values():
            if _TABLES in items:
                items[items.index(_TABLES)] = {"Tables": pages}
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    for uri, text in _generated():
        if found := files.get_file_from_path(uri):
            files.remove(found)
        files.append(File.generated(config, uri, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links into the repository become links of the site, whose root is ``docs/``; those to what it does not have, their text."""
    here = page.file.src_uri
    folder = Path() if here in ("index.md", *_BESIDE) else Path("docs") / Path(here).parent
    if folder == Path("docs/tables"):
        folder = Path("docs")

    def moved(link: re.Match[str]) -> str:
        target = (_ROOT / folder / link["target"]).resolve().relative_to(_ROOT).as_posix()
        for outside in _FOLDERS:
            if target == outside or target.startswith(f"{outside}/"):
                target = f"{outside.removeprefix('docs/')}.md"
        target = _RENAMED.get(target, target.removeprefix("docs/"))
        if files.get_file_from_path(target) is None:
            return link["text"]
        if target == _TABLES and link["rest"]:
            return f"[{link['text']}]({'../' * here.count('/')}{_table_place(link['rest'].removeprefix('#'))})"
        return f"[{link['text']}]({'../' * here.count('/')}{target}{link['rest']})"

    return _LINK.sub(moved, markdown)
