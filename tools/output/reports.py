"""Files that a command writes: results of a run as JUnit XML for CI and as one HTML page. Tables for terminals."""

from __future__ import annotations

import errno
import html
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.table import Table

from pdgw.base.version import package_version
from pdgw.gateway.base.errors import GatewayError, writing


def to_be_written(option: typer.CallbackParam, file: Path | None) -> Path | None:
    """Callback of an option that names an output file. GatewayError before the work if the file cannot be written."""
    if file is not None:
        wrong = errno.EISDIR if file.is_dir() else 0 if file.parent.is_dir() else errno.ENOENT
        if wrong:
            raise GatewayError(f"{option.opts[0]} {file}: cannot be written ({os.strerror(wrong)})")
    return file


JUnitFile = Annotated[
    Path | None, typer.Option("--junit", callback=to_be_written, help="Write the results as JUnit XML.")
]
HtmlFile = Annotated[
    Path | None, typer.Option("--html", callback=to_be_written, help="Write the results as an HTML page.")
]

_NOT_XML = "[^\\t\\n\\r\\x20-\\ud7ff\\ue000-\\ufffd\\U00010000-\\U0010ffff]"
"""Characters that XML 1.0 does not allow."""
_STYLE = (
    ":root{color-scheme:light dark}body{background:Canvas;color:CanvasText}"
    "body{font:14px/1.4 system-ui,sans-serif;margin:1.5rem;max-width:75rem}"
    "table{border-collapse:collapse}td,th{border-bottom:1px solid #8885;padding:.2rem .6rem;text-align:left;vertical-align:top}"
    ".bad{color:#ad1820;font-weight:bold}.good{color:#12633a}pre{background:#8881;padding:.6rem;overflow:auto}"
    "@media(prefers-color-scheme:dark){.bad{color:#ff948c}.good{color:#6bd49b}}"
)


@dataclass(frozen=True, slots=True)
class Check:
    """The result of one check.

    ``detail``: what was measured. ``failures``: what is wrong, empty when it passed. ``seconds``: its duration.
    """

    group: str
    name: str
    detail: str = ""
    failures: tuple[str, ...] = ()
    seconds: float = 0.0

    @property
    def passed(self) -> bool:
        return not self.failures


@dataclass(frozen=True)
class Report:
    """``configuration``: what was tested, as text. ``measured``: figures by name."""

    title: str
    checks: tuple[Check, ...] = ()
    configuration: str = ""
    measured: Mapping[str, str] = field(default_factory=dict)
    when: datetime = field(default_factory=lambda: datetime.now().astimezone())

    @property
    def failed(self) -> int:
        return sum(not check.passed for check in self.checks)

    @property
    def _facts(self) -> dict[str, str]:
        return {
            "date": self.when.isoformat(timespec="seconds"),
            "version": f"pdgw {package_version()}",
            **self.measured,
        }

    def junit(self) -> str:
        """Format JUnit XML: one suite, a test case for each check, facts and figures as properties."""
        from xml.etree import ElementTree  # noqa: PLC0415 (the help of a command needs none)

        suite = ElementTree.Element(
            "testsuite",
            name=_plain(self.title),
            tests=str(len(self.checks)),
            failures=str(self.failed),
            errors="0",
            timestamp=self.when.isoformat(timespec="seconds"),
            time=f"{sum(check.seconds for check in self.checks):.3f}",
        )
        properties = ElementTree.SubElement(suite, "properties")
        facts = self._facts | ({"configuration": self.configuration} if self.configuration else {})
        for name, value in facts.items():
            ElementTree.SubElement(properties, "property", name=_plain(name), value=_plain(value))
        for check in self.checks:
            case = ElementTree.SubElement(
                suite, "testcase", classname=_plain(check.group), name=_plain(check.name), time=f"{check.seconds:.3f}"
            )
            if check.failures:
                text = _plain("\n".join(check.failures))
                ElementTree.SubElement(case, "failure", message=text.splitlines()[0]).text = text
            if check.detail:
                ElementTree.SubElement(case, "system-out").text = _plain(check.detail)
        root = ElementTree.Element("testsuites")
        root.append(suite)
        ElementTree.indent(root)
        return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"

    def page(self) -> str:
        """Format one self-contained HTML page; failures first."""
        return "\n".join(self._page()) + "\n"

    def _page(self) -> Iterator[str]:
        title = html.escape(self.title)
        yield '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        yield f"<title>{title}</title><style>{_STYLE}</style></head><body><main><h1>{title}</h1>"
        if self.checks:
            kind = "bad" if self.failed else "good"
            good = len(self.checks) - self.failed
            yield f'<p class="{kind}">{good} of {len(self.checks)} passed</p>'
        yield from _table(("fact", "value"), [(name, value) for name, value in self._facts.items()])
        for heading, chosen in (
            ("Failed", [check for check in self.checks if not check.passed]),
            ("Passed", [check for check in self.checks if check.passed]),
        ):
            if chosen:
                yield f"<h2>{heading}</h2>"
                rows = [(c.group, c.name, "; ".join(c.failures) or c.detail, f"{c.seconds:.3f} s") for c in chosen]
                yield from _table(("of", "check", "seen", "took"), rows)
        if self.configuration:
            yield f'<h2>Configuration</h2><pre tabindex="0">{html.escape(self.configuration)}</pre>'
        yield "</main></body></html>"

    def write(self, junit: Path | None, page: Path | None) -> None:
        """Write the requested files. GatewayError when one cannot be written."""
        for option, path, text in (("--junit", junit, self.junit), ("--html", page, self.page)):
            if path is None:
                continue
            with writing(f"{option} {path}"):
                path.write_text(text(), encoding="utf-8")


def _plain(text: str) -> str:
    return re.sub(_NOT_XML, "?", text)


def _table(titles: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    yield "<table><tr>" + "".join(f"<th>{html.escape(title)}</th>" for title in titles) + "</tr>"
    for row in rows:
        yield "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
    yield "</table>"


def plain_table(*titles: str, title: str | None = None, narrow: tuple[str, ...] = ()) -> Table:
    """A table without borders that folds long texts and never cuts them. Columns in ``narrow`` are folded last."""
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", pad_edge=False)
    for name in titles:
        table.add_column(name, overflow="fold", no_wrap=name in narrow)
    return table
