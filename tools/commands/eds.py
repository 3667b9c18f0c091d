"""``pdgw eds``: data sheets (EDS, DCF) and what has to be repaired in them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pdgw.ds301.connection_set import NODE_IDS
from pdgw.ds301.eds_import import EdsImport, import_eds
from pdgw.ds301.eds_text import EdsError
from pdgw.gateway.errors import GatewayError

app = typer.Typer(help="Data sheets (EDS, DCF).", no_args_is_help=True)


@app.callback()
def eds() -> None:
    """Data sheets (EDS, DCF)."""


@app.command()
def check(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="EDS or DCF files.")],
    node_id: Annotated[
        int, typer.Option(min=NODE_IDS[0], max=NODE_IDS[-1], help="Node-ID for values that depend on it.")
    ] = 1,
    write: Annotated[Path | None, typer.Option(metavar="OUT", help="Write the repaired file; one FILE only.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="A JSON list, one object per file.")] = False,
) -> None:
    """Tell what an import repairs in each file, and what it refuses; exit status 1 when a file cannot be used."""
    if write is not None and len(files) != 1:
        raise GatewayError(f"--write: {len(files)} files, allowed is one")
    results = [(file, _imported(file, node_id)) for file in files]
    if as_json:
        typer.echo(json.dumps([_document(file, result) for file, result in results], indent=2))
    else:
        console = Console()
        for file, result in results:
            _print(console, file, result)
    if any(isinstance(result, EdsError) for _, result in results):
        raise typer.Exit(1)
    for _, result in results:
        if write is not None and isinstance(result, EdsImport):
            _write(write, result.text)


def _imported(file: Path, node_id: int) -> EdsImport | EdsError:
    try:
        return import_eds(file, node_id)
    except EdsError as error:
        return error


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise GatewayError(f"--write: {path}: {error.strerror}") from error


def _document(file: Path, result: EdsImport | EdsError) -> dict[str, Any]:
    if isinstance(result, EdsError):
        problems = [asdict(problem) for problem in result.problems]
        return {"file": str(file), "usable": False, "objects": 0, "repairs": [], "problems": problems}
    repairs = [asdict(repair) for repair in result.repairs]
    return {"file": str(file), "usable": True, "objects": len(result.dictionary), "repairs": repairs, "problems": []}


def _print(console: Console, file: Path, result: EdsImport | EdsError) -> None:
    name = escape(str(file))
    if isinstance(result, EdsError):
        console.print(f"[red]{name}: refused[/red], {len(result.problems)} lines to correct", highlight=False)
        rows = [(item.line, item.section, item.key, item.found, item.reason) for item in result.problems]
        console.print(_table("reason", rows))
        return
    console.print(
        f"[green]{name}: usable[/green], {len(result.dictionary)} objects, {len(result.repairs)} repairs",
        highlight=False,
    )
    if result.repairs:
        rows = [(item.line, item.section, item.key, item.found, item.used or "(left out)") for item in result.repairs]
        console.print(_table("used", rows))


def _table(last: str, rows: list[tuple[int, str, str, str, str]]) -> Table:
    table = Table("line", "section", "key", "found", last, box=None)
    for line, *texts in rows:
        table.add_row(str(line or "-"), *(escape(text) for text in texts))
    return table
