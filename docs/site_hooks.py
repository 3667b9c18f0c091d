"""What the web site has beside ``docs/``: the README as its first page, changelog, contributing, examples, and the API reference.

Hooks of mkdocs (``make site``). Pages that only list what stands elsewhere are generated, so that nothing is written twice.
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
_BESIDE = ("CHANGELOG.md", "CONTRIBUTING.md")
"""Documents of the repository outside ``docs/``."""
_RENAMED = {"README.md": "index.md", "LICENSE": "LICENSE.md"}
_LINK = re.compile(r"\[(?P<text>[^\]]*)\]\((?P<target>[^):#\s]+)(?P<rest>(?:#[^)\s]*)?)\)")


def _front_door() -> str:
    """Each name of ``import pdgw`` with its documentation."""
    lines = ["# Front door", "", "`import pdgw` has these names; each is loaded when it is first used.", ""]
    for name in pdgw.__all__:
        if name != "__version__":
            thing = getattr(pdgw, name)
            # Links lead to the page of its room.
            shown = f"heading: pdgw.{name}, toc_label: {name}"
            lines += [f"::: {thing.__module__}.{name}", f"    options: {{skip_local_inventory: true, {shown}}}", ""]
    return "\n".join(lines)


def _room(room: str) -> str:
    options = "    options: {show_submodules: true, show_root_heading: false, show_root_toc_entry: false}"
    return f"# pdgw.{room}\n\n::: pdgw.{room}\n{options}\n"


def _folder(folder: str, language: str) -> str:
    lines = [f"# {folder}", ""]
    for path in sorted((_ROOT / folder).glob("*.*")):
        lines += [f"## {path.name}", "", f"```{language}", path.read_text().rstrip(), "```", ""]
    return "\n".join(lines)


def _generated() -> Iterator[tuple[str, str]]:
    yield "index.md", (_ROOT / "README.md").read_text()
    for name in _BESIDE:
        yield name, (_ROOT / name).read_text()
    yield "LICENSE.md", f"# License\n\n```\n{(_ROOT / 'LICENSE').read_text()}```\n"
    for folder, language in _FOLDERS.items():
        yield f"{folder.removeprefix('docs/')}.md", _folder(folder, language)
    yield "api.md", _front_door()
    for room in _ROOMS:
        yield f"api/{room}.md", _room(room)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    for uri, text in _generated():
        files.append(File.generated(config, uri, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links into the repository become links of the site, whose root is ``docs/``; those to what it does not have, their text."""
    here = page.file.src_uri
    folder = Path() if here in ("index.md", *_BESIDE) else Path("docs") / Path(here).parent

    def moved(link: re.Match[str]) -> str:
        target = (_ROOT / folder / link["target"]).resolve().relative_to(_ROOT).as_posix()
        for outside in _FOLDERS:
            if target == outside or target.startswith(f"{outside}/"):
                target = f"{outside.removeprefix('docs/')}.md"
        target = _RENAMED.get(target, target.removeprefix("docs/"))
        if files.get_file_from_path(target) is None:
            return link["text"]
        return f"[{link['text']}]({'../' * here.count('/')}{target}{link['rest']})"

    return _LINK.sub(moved, markdown)
